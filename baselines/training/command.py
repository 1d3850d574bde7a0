"""Run the trainings of a request: progress, learning curve, agent."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from datetime import timedelta
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

from baselines.agents.agent import Agent
from baselines.agents.model_card import CURVE_FILE
from baselines.agents.names import AGENT_FOLDER
from baselines.tools.command_line import DONE, FAILED, WRONG_USAGE, UsageError, WorkerError, checked
from baselines.tools.figure_style import COLOURS, REFERENCE_STYLE, panels, styled, to_png
from baselines.tools.files import versions, write_atomically
from baselines.training.config import ALGORITHMS, Config
from baselines.training.request import Request
from baselines.training.run_folder import RunFolder, TrainerState, TrainingError, locked, read_progress


def train(request: Request) -> int:
    """Run the trainings of a request, write their folders and return the exit status.

    Progress is printed to stderr: a progress bar on a terminal, else a line for each validation.
    """
    several = len(request.folders) > 1
    processes = request.workers.each_of(len(request.folders))
    tasks = [
        (config, folder, request.command, several, processes)
        for config, folder in zip(request.configs, request.folders, strict=True)
    ]
    status = DONE
    try:
        for each, line in request.workers.results(train_one, tasks):
            print(line, file=sys.stderr if each else sys.stdout)
            status = max(status, each)
    except (WorkerError, KeyboardInterrupt) as error:
        reason = str(error) or "interrupted"
        print(f"{reason}; repeat the command with --resume to continue", file=sys.stderr)
        return FAILED
    if several and status == DONE:
        rows = [checked(partial(read_progress, folder)) for folder in request.folders]
        write_atomically(request.out / CURVE_FILE, learning_curve(rows, [folder.name for folder in request.folders]))
    return status


def train_one(
    config: Config, folder: Path, command: str, one_of_several: bool = False, processes: int = 1
) -> tuple[int, str]:
    """Train one agent in its folder; return the exit status and a message.

    Raises:
        WorkerError: a worker process has died.
    """
    label = f"{folder.name}: " if one_of_several else ""
    if (folder / AGENT_FOLDER).exists():
        return DONE, f"{label}{folder} holds the finished agent: auv-gym evaluate --policy {folder / AGENT_FOLDER}"
    try:
        with locked(folder), nullcontext(_plain(label)) if one_of_several else _live(config) as show:
            run = RunFolder(config, folder, show, processes)
            agent = importlib.import_module(ALGORITHMS[config.algo]).train(run)
            score = _finish(run, agent, command)
    except UsageError as error:
        return WRONG_USAGE, f"{label}{error}"
    except TrainingError as error:
        return FAILED, f"{label}{' '.join(str(error).split())}"
    except OSError as error:
        return FAILED, f"{label}cannot write to {folder}: {error.strerror or error}"
    return DONE, f"{label}validation score {score:.3f} after {run.seconds:.0f} s; agent: {folder / AGENT_FOLDER}"


def _finish(run: RunFolder, agent: Agent, command: str) -> float:
    """Write the learning curve, then the agent; return the agent's score on the validation episodes."""
    run.close()
    kept, curve = run.validated, learning_curve([read_progress(run.folder)])
    write_atomically(run.folder / CURVE_FILE, curve)
    training: dict[str, Any] = {
        "command": command,
        "config": run.config.to_dict(),
        "seconds": round(run.seconds, 1),
        "versions": {**versions(), **{name: version(name) for name in ("stable-baselines3", "torch")}},
        "scores": {"validation episodes": round(kept["score"], 3)},
        "validation": {name: kept[name] for name in ("timesteps", "score", "error_m", "failed")},
    }
    region = run.validation.run(agent.policy(vehicle=run.config.vehicle)).region
    replace(agent, region=region, training={**training, **agent.training}).save(run.folder / AGENT_FOLDER, curve)
    return kept["score"]


@contextmanager
def _live(config: Config) -> Iterator[Callable[[TrainerState], None]]:
    """Yield a function that displays the state of a run on stderr."""
    console = Console(stderr=True, highlight=False)
    if not console.is_terminal:
        yield _plain("")
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TextColumn("{task.fields[text]}"))
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(config.algo, total=config.timesteps, text="")
        yield lambda state: bar.update(task, completed=state.timesteps, text=_text(state))


def _plain(label: str) -> Callable[[TrainerState], None]:
    """Return a function that prints a line to stderr for each validation; `label` begins each line."""
    printed = 0

    def show(state: TrainerState) -> None:
        nonlocal printed
        if len(state.scores) != printed:
            printed = len(state.scores)
            print(f"{label}{min(1.0, state.timesteps / state.total):4.0%} {_text(state)}", file=sys.stderr, flush=True)

    return show


def _text(state: TrainerState) -> str:
    score = "validating the expert" if state.kept is None else f"score {state.scores[-1]:.3f}, kept {state.kept:.3f}"
    left = "" if state.seconds_left is None else f", {timedelta(seconds=round(state.seconds_left))} left"
    return f"{state.timesteps:,} steps, {score}{left}"


def learning_curve(seeds: Sequence[Sequence[Mapping[str, float]]], names: Sequence[str] = ()) -> bytes:
    """Return a PNG image of the score on the validation episodes over control steps and over wall time.

    Args:
        seeds: for each training the rows of its progress.csv.
        names: of the trainings, for the legend; empty for a single training.
    """
    figure, [axes] = panels(1, 2, (7.0, 2.8), sharey=True)
    axes[0].set_ylabel("score (0: expert, 1: oracle)")
    with styled():
        for ax, key, unit, label in zip(
            axes, ("timesteps", "seconds"), (1e6, 60.0), ("control steps [million]", "wall time [min]"), strict=True
        ):
            ax.set_xlabel(label)
            ax.axhline(0.0, **REFERENCE_STYLE)
            for i, rows in enumerate(seeds):
                points = [row for row in rows if "score" in row]
                ax.plot(
                    [row[key] / unit for row in points],
                    [row["score"] for row in points],
                    color=COLOURS[i % len(COLOURS)],
                    marker=".",
                    label=names[i] if names else None,
                )
        if names:
            axes[0].legend()
    return to_png(figure)
