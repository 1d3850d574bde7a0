"""A training from request to agent: runs, progress, learning curve, files."""

from __future__ import annotations

import importlib
import sys
from contextlib import nullcontext
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import joblib

from baselines.agents.agent import Agent
from baselines.tools.command_line import DONE, FAILED
from baselines.tools.files import versions, write_atomically
from baselines.training.config import ALGORITHMS, Config
from baselines.training.learning_curve import learning_curve
from baselines.training.progress import live, plain
from baselines.training.request import Request
from baselines.training.run_folder import AGENT, Run, TrainingError, read_progress

CURVE = "learning_curve.png"


def train(request: Request) -> int:
    """Run the trainings of a request, write their folders and return the exit status.

    Progress goes to stderr: a live line on a terminal, else a line for each validation.
    """
    tasks = list(zip(request.configs, request.folders, strict=True))
    if len(tasks) == 1:
        statuses = [train_one(*tasks[0], request.command, "")]
    else:
        with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
            statuses = joblib.Parallel(n_jobs=min(request.jobs, len(tasks)))(
                joblib.delayed(train_one)(config, folder, request.command, f"{folder.name}: ")
                for config, folder in tasks
            )
        if not any(statuses):
            rows = [read_progress(folder) for folder in request.folders]
            write_atomically(request.out / CURVE, learning_curve(rows, [folder.name for folder in request.folders]))
    return max(statuses)


def train_one(config: Config, folder: Path, command: str, label: str) -> int:
    """Train one agent in its folder and return the exit status; what goes wrong is one line on stderr."""
    if (folder / AGENT).exists():
        print(f"{label}{folder} holds the finished agent: python evaluate.py --policy {folder / AGENT}")
        return DONE
    try:
        with live(config) if not label else nullcontext(plain(label)) as show:
            run = Run(config, folder, show)
            agent = importlib.import_module(ALGORITHMS[config.algo]).train(run)
            score = _finish(run, agent, command)
    except TrainingError as error:
        print(f"{label}{' '.join(str(error).split())}", file=sys.stderr)
        return FAILED
    except OSError as error:
        print(f"{label}cannot write to {folder}: {error.strerror or error}", file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        print(f"{label}interrupted; the same command with --resume goes on", file=sys.stderr)
        return FAILED
    print(f"{label}validation score {score:.3f} after {run.seconds:.0f} s; agent: {folder / AGENT}")
    return DONE


def _finish(run: Run, agent: Agent, command: str) -> float:
    """Write learning curve and agent, the latter last and at once; return its score on the validation episodes."""
    run.close()
    rows = read_progress(run.folder)
    best = max((row for row in rows if "score" in row), key=lambda row: row["score"])
    curve = learning_curve([rows])
    write_atomically(run.folder / CURVE, curve)
    training: dict[str, Any] = {
        "command": command,
        "config": run.config.to_dict(),
        "seconds": round(run.seconds, 1),
        "versions": {**versions(), **{name: version(name) for name in ("stable-baselines3", "torch")}},
        "scores": {"validation episodes": round(best["score"], 3)},
        "validation": {name: best[name] for name in ("timesteps", "score", "error_m", "lost")},
    }
    region = run.validation.run(agent.policy(vehicle=run.config.vehicle)).region
    replace(agent, region=region, training={**training, **agent.training}).save(run.folder / AGENT, curve)
    return best["score"]
