"""Train the agents that ship with the package: `python -m research train-all --help`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from auv_gym.installation import found
from baselines.agents.agent import Agent
from baselines.agents.model_card import CURVE_FILE
from baselines.agents.names import AGENT_FOLDER, SHIPPED_FOLDER
from baselines.tools.command_line import DONE, check_words, parse
from baselines.tools.workers import DEFAULT_JOBS
from baselines.training.command import train
from baselines.training.options import Options as Training
from research.trainings.trainings import FIRST_TRAININGS, SHIPPED_TRAININGS, request_of

PROGRAM = "python -m research train-all"
SHIPPED_RUNS = Path("runs/shipped")
"""Folder of the trainings of the shipped agents."""


@dataclass(frozen=True)
class Options:
    """Train the agents that ship with the package, one after the other, each in a folder DIR/NAME.

    A second call resumes interrupted trainings. Exit status: 0 done, 1 a training failed, 2 wrong usage.
    """

    name: Annotated[Positional[tuple[str, ...]], arg(metavar="[NAME ...]")] = ()
    """Names of agents. Default: all."""
    out: Path = SHIPPED_RUNS
    """Folder of the runs."""
    timesteps: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Control steps of each training, for a trial run. Default: those of the shipped agents."""
    install: bool = False
    """Replace the agents in baselines/agents/shipped by the trained ones."""


def main(arguments: Sequence[str]) -> int:
    """Train the agents and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options = parse(Options, arguments, PROGRAM)
    check_words("agent", options.name, SHIPPED_TRAININGS)
    for name in options.name or SHIPPED_TRAININGS:
        if (status := trained(name, options.out, options.timesteps)) != DONE:
            return status
        if options.install:
            install_agent(name, options.out / name)
    return DONE


def trained(name: str, out: Path, timesteps: int | None = None) -> int:
    """Train an agent in a folder `out`/NAME, after the agent of `FIRST_TRAININGS` that it starts from.

    Args:
        name: of `SHIPPED_TRAININGS` or `FIRST_TRAININGS`.
        out: folder of the runs.
        timesteps: control steps of each training; None: those of the trainings.

    Returns:
        The exit status.
    """
    training = (FIRST_TRAININGS | SHIPPED_TRAININGS)[name]
    if training.from_ in FIRST_TRAININGS and (status := trained(training.from_, out, timesteps)) != DONE:
        return status
    print(f"{name}:", flush=True)
    training = replace(with_start(training, out), timesteps=timesteps or training.timesteps)
    return train(request_of(training, out / name, DEFAULT_JOBS))


def with_start(training: Training, out: Path) -> Training:
    """Return a training that starts from the agent in `out`/NAME if it starts from NAME of `FIRST_TRAININGS`."""
    first = training.from_
    return replace(training, from_=str(out / first / AGENT_FOLDER)) if first in FIRST_TRAININGS else training


def install_agent(name: str, run_folder: Path) -> None:
    """Replace an agent in baselines/agents/shipped by the trained agent of a run."""
    Agent.load(run_folder / AGENT_FOLDER).save(found(SHIPPED_FOLDER, name), (run_folder / CURVE_FILE).read_bytes())
