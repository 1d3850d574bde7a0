"""Train agents with several seeds and with single settings changed: `python -m research study --help`.

Every agent of `VARIANTS` is trained with several seeds and run on the frozen suites. The steady-state errors of every
episode are recorded in `research/data/studies/` for the pages of results.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from auv_gym.scenarios.presets import SPEED_RANGES
from baselines.agents.names import AGENT_FOLDER
from baselines.control.open_loop import NO_EXPERT
from baselines.evaluation import suites
from baselines.evaluation.progress import run_and_show
from baselines.evaluation.runner import Cell, Run
from baselines.tools.command_line import DONE, check_words, parse
from baselines.tools.workers import Workers
from baselines.training.command import train
from baselines.training.options import Options as TrainOptions
from baselines.training.request import Request
from research.trainings.shipped import SHIPPED_RUNS, with_start
from research.trainings.study_files import STUDIES_FOLDER, Study, save_study
from research.trainings.trainings import (
    ERROR_ONLY,
    FIRST_TRAININGS,
    PPO_AUTHORITY,
    SHIPPED_TRAININGS,
    SPINS,
    request_of,
    training,
    weighted,
)

PROGRAM = "python -m research study"
OF_ALL_VEHICLES = ("helm-any-first", "helm-any")
"""Agents that also run on the suite with other vehicles."""
OF_THE_PAPER = ("benchmark-v1", "unmodelled-v1")
"""Suites of the paper's vehicle that the pages of results show for several seeds."""


@dataclass(frozen=True)
class Variant:
    """A training with several seeds."""

    speed_range: str  # speed range in which the agents run
    training: TrainOptions  # contains the number of seeds
    suites: tuple[str, ...] = OF_THE_PAPER
    runs: str = ""  # name of the folder of the runs, if it differs from the name of the variant
    about: str = ""  # description for the results page, one line


_SEEDS = 5  # seeds of each shipped agent
_LONG_SEEDS = 3  # seeds of `OF_ALL_VEHICLES`, whose trainings are the longest
_SHORT = 3_000_000  # control steps of the trainings of `SHORT_TRAININGS`
_FEW = 2  # seeds of the trainings of `SHORT_TRAININGS`


def _short(about: str, expert: str | None = None, authority: tuple[float, ...] = (), **changes: Any) -> Variant:
    each = training("apg", "cruise", authority, expert, _SHORT, changes)
    return Variant("cruise", replace(each, seeds=_FEW), ("benchmark-v1",), about=about)


BRIEF: Mapping[str, Variant] = {
    f"ppo-3m-{speed_range}": Variant(
        speed_range,
        replace(training("ppo", weighted(speed_range, **SPINS), PPO_AUTHORITY[speed_range]), seeds=_SEEDS),
    )
    for speed_range in ("cruise", "slow")
}
"""PPO with a quarter of the steps of the shipped agents."""
SHORT_TRAININGS: Mapping[str, Variant] = {
    "short-cruise": _short("As `apg-cruise`, with fewer steps: the reference for the following trainings."),
    "short-preview": _short("A preview of the reference, 0.5, 1, 2 and 4 s ahead.", preview=ERROR_ONLY["preview"]),
    "short-no-memory": _short("Two tanh layers instead of the recurrent units.", memory=False),
    "short-no-integrals": _short("No integrals of the error as inputs.", integrals=False),
    "short-little-authority": _short("Half the authority.", authority=(0.3, 0.3)),
    "short-scratch": _short("Without an expert: the network gives the whole command.", NO_EXPERT, (1.0, 1.0)),
    "short-ekf": _short("The control law on an extended Kalman filter as the expert.", "ekf"),
    "short-free": _short("Nearly no cost of the commands.", effort_weight=0.002, rate_weight=0.001),
    "short-horizon": _short("Backpropagation through 10 steps (1 s) instead of 50.", n_steps=10),
    "short-adam": _short("Adam for all weights, also for the matrices.", matrix_learning_rate=0.0),
}
"""Trainings that differ from `short-cruise` in one setting each."""


def _shipped(name: str, each: TrainOptions) -> dict[str, Variant]:
    """Return the variants of a shipped agent: one for each of its speed ranges."""
    if (speed_range := name.rpartition("-")[2]) in SPEED_RANGES:
        return {name: Variant(speed_range, replace(each, seeds=_SEEDS))}
    own = replace(each, seeds=_LONG_SEEDS if name in OF_ALL_VEHICLES else _SEEDS)
    where = (*OF_THE_PAPER, "vehicles-v2") if name in OF_ALL_VEHICLES else OF_THE_PAPER
    return {f"{name}-{speed_range}": Variant(speed_range, own, where, name) for speed_range in SPEED_RANGES}


VARIANTS: Mapping[str, Variant] = {
    **{
        variant: own
        for name, each in (SHIPPED_TRAININGS | FIRST_TRAININGS).items()
        for variant, own in _shipped(name, each).items()
    },
    **BRIEF,
    **SHORT_TRAININGS,
}
"""The trainings of the study, by name."""


@dataclass(frozen=True)
class Options:
    """Train the agents of the study with several seeds, run them on the frozen suites and record the results.

    A second call resumes interrupted trainings. `helm-any` starts from the agent of its first training in runs/shipped.
    Exit status: 0 done, 1 a training failed, 2 wrong usage.
    """

    name: Annotated[Positional[tuple[str, ...]], arg(metavar="[NAME ...]")] = ()
    """Names of trainings. Default: all."""
    out: Path = Path("runs/study")
    """Folder of the runs."""
    jobs: int = 2
    """Number of trainings that run at the same time."""


def main(arguments: Sequence[str]) -> int:
    """Train and evaluate the agents, record the results, and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options = parse(Options, arguments, PROGRAM)
    check_words("training", options.name, VARIANTS)
    for name in options.name or VARIANTS:
        variant = VARIANTS[name]
        agent = variant.runs or name
        request = request_of(with_start(variant.training, SHIPPED_RUNS), options.out / agent, options.jobs)
        if (status := train(request)) != DONE:
            return status
        save_study(name, studied(variant, request, options.jobs), STUDIES_FOLDER)
    return DONE


def studied(variant: Variant, request: Request, jobs: int) -> Study:
    """Return the results of the trained agents of a request on the suites of a variant."""
    agents = [str(folder / AGENT_FOLDER) for folder in request.folders]
    results = {name: _rolled_out(agents, suite_cells(name, variant.speed_range), jobs) for name in variant.suites}
    return Study.of(variant.speed_range, request.command, results)


def suite_cells(suite: str, speed_range: str) -> list[Cell]:
    """Return the cells of a frozen suite in a speed range."""
    return suites.load_suite(suite).cells_in((speed_range,))


def _rolled_out(agents: Sequence[str], cells: Sequence[Cell], jobs: int) -> list[list[Run]]:
    """Return the runs of each agent in the cells."""
    every = run_and_show([(agent, cell) for cell in cells for agent in agents], Workers(jobs))
    found = {(run.policy, run.scenario.name): run for run in every}
    return [[found[agent, cell.scenario.name] for cell in cells] for agent in agents]
