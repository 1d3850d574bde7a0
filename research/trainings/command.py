"""Train the shipped agents, or the agents of the study with several seeds: `python -m research train-all --help`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from baselines.agents.agent import Agent
from baselines.agents.model_card import CURVE_FILE
from baselines.agents.names import AGENT_FOLDER, SHIPPED_FOLDER
from baselines.evaluation.report.terminal import run_and_show
from baselines.evaluation.suites import load_suite
from baselines.tools.command_line import DONE, check_words, parse
from baselines.tools.workers import DEFAULT_JOBS, Workers
from baselines.training.train import train_all
from research.trainings.seed_runs import keep_seed_runs
from research.trainings.trainings import SEED_TRAININGS, SHIPPED_TRAININGS, request_of

PROGRAM = "python -m research train-all"
SHIPPED_RUNS, STUDY_RUNS = Path("runs/shipped"), Path("runs/study")
"""Folders of the trainings."""


@dataclass(frozen=True)
class Options:
    """Train the agents that ship with the package, one after the other, in runs/shipped.

    A second call resumes interrupted trainings. Exit status: 0 done, 1 a training failed, 2 wrong usage.
    """

    name: Annotated[Positional[tuple[str, ...]], arg(metavar="[NAME ...]")] = ()
    """Names of agents. Default: all."""
    timesteps: int | None = None
    """Control steps of each training, for a trial. Default: those of the shipped agents."""
    install: bool = False
    """Replace the agents in baselines/agents/shipped by the trained ones."""
    study: bool = False
    """Train the agents of the study instead, with several seeds in runs/study. They run on the frozen suites, and their
    results are recorded in research/data/trainings."""
    jobs: int = DEFAULT_JOBS
    """Worker processes."""


def main(arguments: Sequence[str]) -> int:
    """Train agents and return the exit status."""
    options = parse(Options, arguments, PROGRAM)
    trainings = SEED_TRAININGS if options.study else SHIPPED_TRAININGS
    check_words("agent", options.name, trainings)
    for name in options.name or trainings:
        status = _studied(name, options.jobs) if options.study else _shipped(name, options)
        if status != DONE:
            return status
    return DONE


def _shipped(name: str, options: Options) -> int:
    """Train an agent and return the exit status."""
    training = SHIPPED_TRAININGS[name]
    print(f"{name}:", flush=True)
    folder, steps = SHIPPED_RUNS / name, options.timesteps or training.timesteps
    status = train_all(request_of(replace(training, timesteps=steps), folder, options.jobs))
    if status == DONE and options.install:
        Agent.load(folder / AGENT_FOLDER).save(SHIPPED_FOLDER / name, (folder / CURVE_FILE).read_bytes())
    return status


def _studied(name: str, jobs: int) -> int:
    """Train agents with several seeds, run them on the suites, record the results, and return the exit status."""
    study = SEED_TRAININGS[name]
    request = request_of(replace(study.training, seeds=study.seeds), STUDY_RUNS / name, jobs)
    if (status := train_all(request)) != DONE:
        return status
    agents = [str(folder / AGENT_FOLDER) for folder in request.folders]
    for suite in map(load_suite, study.suites):
        runs = run_and_show([(agent, cell) for cell in suite.cells for agent in agents], Workers(jobs))
        by_agent = [[run for run in runs if run.policy == agent] for agent in agents]
        keep_seed_runs(suite, name, by_agent, request.command)
    return DONE
