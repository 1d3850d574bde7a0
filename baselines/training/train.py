"""Run trainings: progress, learning curve, agent."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn

from baselines.agents.agent import Agent
from baselines.agents.model_card import CURVE_FILE
from baselines.agents.names import AGENT_FOLDER
from baselines.tools.command_line import DONE, FAILED, WRONG_USAGE, UsageError, WorkerError, checked
from baselines.tools.figure_style import COLOURS, REFERENCE_STYLE, panels, styled, to_png
from baselines.tools.files import versions, write_atomically
from baselines.tools.workers import Workers
from baselines.training.comparison import RESULT, Comparison, compare
from baselines.training.config import ALGORITHMS, Config
from baselines.training.run_folder import RunFolder, Show, TrainingError, locked, read_progress


@dataclass(frozen=True)
class TrainingRequest:
    """Checked trainings: configurations that differ in the seed, and a folder for each."""

    configs: tuple[Config, ...]
    folders: tuple[Path, ...]
    out: Path  # folder of all
    workers: Workers
    command: str = ""  # command line of the user
    comparison: Comparison | None = None  # at the end


def train(config: Config, folder: Path, show: Show = lambda *_: None, processes: int = 1, command: str = "") -> Agent:
    """Train an agent, or continue the training in a folder; return the agent, which is also saved in `folder`/agent.

    Args:
        config: of the training.
        folder: of the run; it is empty, or holds a run with this configuration.
        show: displays the progress.
        processes: number of processes of a training of apg, including this one; the agent does not depend on it.
        command: the command line, for the description of the agent.

    Raises:
        OSError: the folder cannot be written to.
        TrainingError: the training cannot continue, or the folder holds another run.
        UsageError: another process trains in the folder.
        ValueError: the configuration cannot be trained, or a file of the folder is damaged.
        WorkerError: a worker process has died.
    """
    with locked(folder):
        run = RunFolder(config, folder, show, processes)
        agent: Agent = importlib.import_module(ALGORITHMS[config.algo]).train(run)
        run.close()
        selected, curve = run.validated, learning_curves({"": folder})
        write_atomically(folder / CURVE_FILE, curve)
        record = {
            "command": command,
            "config": config.to_dict(),
            "seconds": round(run.seconds, 1),
            "versions": {**versions(), **{name: version(name) for name in ("stable-baselines3", "torch")}},
            "scores": {"validation episodes": round(selected["score"], 3)},
            "validation": {name: selected[name] for name in ("timesteps", "score", "error_m", "failed")},
        }
        agent = replace(agent, training={**record, **agent.training})
        agent.save(folder / AGENT_FOLDER, curve)
    return agent


def train_all(request: TrainingRequest) -> int:
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
        for one, line in request.workers.results(_trained, tasks):
            print(line, file=sys.stderr if one else sys.stdout)
            status = max(status, one)
        if request.comparison and status == DONE and not (request.out / RESULT).exists():
            agents = [folder / AGENT_FOLDER for folder in request.folders]
            print(compare(request.comparison, agents, request.out, request.workers))
    except (WorkerError, KeyboardInterrupt) as error:
        reason = str(error) or "interrupted"
        print(f"{reason}; repeat the command with --resume to continue", file=sys.stderr)
        return FAILED
    except TrainingError as error:
        print(error, file=sys.stderr)
        return FAILED
    if several and status == DONE:
        curves = checked(partial(learning_curves, {folder.name: folder for folder in request.folders}))
        write_atomically(request.out / CURVE_FILE, curves)
    return status


def _trained(config: Config, folder: Path, command: str, several: bool, processes: int) -> tuple[int, str]:
    """Train an agent, perhaps one of several; return the exit status and a message.

    Raises:
        WorkerError: a worker process has died.
    """
    label = f"{folder.name}: " if several else ""
    if (folder / AGENT_FOLDER).exists():
        return DONE, f"{label}{folder} holds the finished agent: auv-gym evaluate --policy {folder / AGENT_FOLDER}"
    try:
        with nullcontext(_lines(config, label)) if several else _live(config) as show:
            training = train(config, folder, show, processes, command).training
    except UsageError as error:
        return WRONG_USAGE, f"{label}{error}"
    except TrainingError as error:
        return FAILED, f"{label}{' '.join(str(error).split())}"
    except OSError as error:
        return FAILED, f"{label}cannot write to {folder}: {error.strerror or error}"
    best, seconds = training["validation"], training["seconds"]
    kept = f"validation score {best['score']:.3f} (0: expert, 1: no error), that after {best['timesteps']:,} steps"
    return DONE, f"{label}{kept}; {seconds:.0f} s; agent: {folder / AGENT_FOLDER}"


@contextmanager
def _live(config: Config) -> Iterator[Show]:
    """Yield a function that displays the progress on stderr."""
    console = Console(stderr=True, highlight=False)
    if not console.is_terminal:
        yield _lines(config)
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TextColumn("{task.fields[text]}"))
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(config.algo, total=config.timesteps, text="")
        yield lambda timesteps, text, _: bar.update(task, completed=timesteps, text=text)


def _lines(config: Config, label: str = "") -> Show:
    """Return a function that prints a line to stderr for each validation; `label` begins each line."""

    def show(timesteps: int, text: str, validated: bool) -> None:
        if validated:
            print(f"{label}{min(1.0, timesteps / config.timesteps):4.0%} {text}", file=sys.stderr, flush=True)

    return show


def learning_curves(runs: Mapping[str, str | Path]) -> bytes:
    """Return a PNG image of the score on the validation episodes over control steps and over wall time.

    A run with several seeds is a line of their mean, with a band from the worst to the best at that time.

    Args:
        runs: folders of runs, or of runs with several seeds, by their names in the legend; one alone has no legend.

    Raises:
        OSError: a file cannot be read.
        ValueError: a file is damaged, or a folder holds no validated run.
    """
    if not isinstance(runs, Mapping) or not runs:
        raise ValueError(f"runs is {runs!r}; it must be a dict of folders by their names in the legend")
    validated = [_validated(Path(folder)) for folder in runs.values()]
    figure, [axes] = panels(1, 2, (7.0, 2.8), sharey=True)
    axes[0].set_ylabel("score (0: expert, 1: no error)")
    with styled():
        for ax, key, unit, label in zip(
            axes, ("timesteps", "seconds"), (1e6, 60.0), ("control steps [million]", "wall time [min]"), strict=True
        ):
            ax.set_xlabel(label)
            ax.axhline(0.0, **REFERENCE_STYLE)
            for i, (name, seeds) in enumerate(zip(runs, validated, strict=True)):
                points = [np.array([(row[key] / unit, row["score"]) for row in rows]) for rows in seeds]
                times = points[0][: min(map(len, points)), 0]
                scores = np.array([np.interp(times, *one.T) for one in points])
                colour = COLOURS[i % len(COLOURS)]
                ax.plot(times, scores.mean(axis=0), color=colour, marker=".", label=name)
                if len(scores) > 1:
                    ax.fill_between(times, scores.min(axis=0), scores.max(axis=0), color=colour, alpha=0.2, lw=0)
        if len(runs) > 1:
            axes[0].legend()
    return to_png(figure)


def _validated(folder: Path) -> list[list[dict[str, float]]]:
    """Return the rows with a score of a run, or of each seed of a run; raise ValueError if there are none."""
    every = (read_progress(seed) for seed in (folder, *sorted(folder.glob("seed-*"))))
    seeds = [[row for row in rows if "score" in row] for rows in every if rows]
    if not seeds or not all(seeds):
        raise ValueError(f"{folder} holds no run that was validated")
    return seeds
