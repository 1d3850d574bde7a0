"""A training from request to agent: runs, progress, learning curve, files."""

from __future__ import annotations

import importlib
import sys
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from baselines.agents.agent import Agent
from baselines.agents.model_card import CURVE
from baselines.evaluation.request import checked
from baselines.tools.command_line import DONE, FAILED, WRONG_USAGE, UsageError, WorkerError
from baselines.tools.files import versions, write_atomically
from baselines.training.config import ALGORITHMS, Config
from baselines.training.learning_curve import learning_curve
from baselines.training.progress import live, plain
from baselines.training.request import Request
from baselines.training.run_folder import AGENT, Run, TrainingError, locked, read_progress


def train(request: Request) -> int:
    """Run the trainings of a request, write their folders and return the exit status.

    Progress goes to stderr: a live line on a terminal, else a line for each validation.
    """
    several = len(request.folders) > 1
    processes = request.workers.each_of(len(request.folders))
    tasks = [
        (config, folder.absolute() if request.workers.on_cluster else folder, request.command, several, processes)
        for config, folder in zip(request.configs, request.folders, strict=True)
    ]
    status = DONE
    try:
        for each, line in request.workers.results(train_one, tasks):
            print(line, file=sys.stderr if each else sys.stdout)
            status = max(status, each)
    except (WorkerError, KeyboardInterrupt) as error:
        reason = str(error) or "interrupted"
        print(f"{reason}; the same command with --resume goes on", file=sys.stderr)
        return FAILED
    if several and status == DONE:
        rows = [checked(partial(read_progress, folder)) for folder in request.folders]
        write_atomically(request.out / CURVE, learning_curve(rows, [folder.name for folder in request.folders]))
    return status


def train_one(
    config: Config, folder: Path, command: str, one_of_several: bool = False, processes: int = 1
) -> tuple[int, str]:
    """Train one agent in its folder; return the exit status, and the line that says what has come of it.

    A worker that is lost raises WorkerError.
    """
    label = f"{folder.name}: " if one_of_several else ""
    if (folder / AGENT).exists():
        return DONE, f"{label}{folder} holds the finished agent: python evaluate.py --policy {folder / AGENT}"
    try:
        with locked(folder), nullcontext(plain(label)) if one_of_several else live(config) as show:
            run = Run(config, folder, show, processes)
            agent = importlib.import_module(ALGORITHMS[config.algo]).train(run)
            score = _finish(run, agent, command)
    except UsageError as error:
        return WRONG_USAGE, f"{label}{error}"
    except TrainingError as error:
        return FAILED, f"{label}{' '.join(str(error).split())}"
    except OSError as error:
        return FAILED, f"{label}cannot write to {folder}: {error.strerror or error}"
    return DONE, f"{label}validation score {score:.3f} after {run.seconds:.0f} s; agent: {folder / AGENT}"


def _finish(run: Run, agent: Agent, command: str) -> float:
    """Write learning curve and agent, the latter last and at once; return its score on the validation episodes."""
    run.close()
    kept, curve = run.validated, learning_curve([read_progress(run.folder)])
    write_atomically(run.folder / CURVE, curve)
    training: dict[str, Any] = {
        "command": command,
        "config": run.config.to_dict(),
        "seconds": round(run.seconds, 1),
        "versions": {**versions(), **{name: version(name) for name in ("stable-baselines3", "torch")}},
        "scores": {"validation episodes": round(kept["score"], 3)},
        "validation": {name: kept[name] for name in ("timesteps", "score", "error_m", "lost")},
    }
    region = run.validation.run(agent.policy(vehicle=run.config.vehicle)).region
    replace(agent, region=region, training={**training, **agent.training}).save(run.folder / AGENT, curve)
    return kept["score"]
