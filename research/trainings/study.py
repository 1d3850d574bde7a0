"""Train agents with several seeds, with and without one thing or another: `python -m research study --help`.

Every agent of `VARIANTS` is trained with several seeds and run on the frozen suites; the tail errors of every episode
are kept in `research/data/studies/` for the page of results.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from auv_gym.scenarios.presets import SPEED_RANGES
from baselines.control.open_loop import NO_EXPERT
from baselines.evaluation import suites
from baselines.evaluation.progress import run_and_show
from baselines.evaluation.recorded import RECORDED_SUITES
from baselines.evaluation.runner import Cell, Run
from baselines.tools.command_line import DONE, check_words, parse
from baselines.tools.workers import Workers
from baselines.training.command import train
from baselines.training.options import Options as TrainOptions
from baselines.training.request import Request
from baselines.training.run_folder import AGENT_FOLDER, read_progress
from research.results.study_files import STUDIES_FOLDER, Study, save_study
from research.trainings.shipped import install_agent
from research.trainings.trainings import (
    ERROR_ONLY,
    PPO_AUTHORITY,
    SHIPPED_TRAININGS,
    SPINS,
    request_of,
    training,
    weighted,
)

PROGRAM = "python -m research study"


OF_ALL_VEHICLES = "helm-any"
"""The agent that is run on other vehicles too."""
OF_THE_PAPER = tuple(
    name for name in RECORDED_SUITES if name != "vehicles-v1"
)  # suites of the vehicle that the others know


@dataclass(frozen=True)
class Variant:
    """Agents that differ in the seed alone."""

    about: str  # one line for the results page
    speed_range: str  # in which they are run
    training: TrainOptions  # the number of seeds included
    suites: tuple[str, ...] = OF_THE_PAPER
    runs: str = ""  # folder of the runs, where it is not that of the variant's name


_SEEDS = 5  # of each agent that ships with the package
_SHORT = 3_000_000  # control steps of the trainings that differ from `short-cruise` in one thing
_FEW = 2  # seeds of the trainings that differ from `short-cruise` in one thing


def _short(about: str, expert: str | None = None, authority: tuple[float, ...] = (), **changes: Any) -> Variant:
    each = training("apg", "cruise", authority, expert, _SHORT, changes)
    return Variant(about, "cruise", replace(each, seeds=_FEW), ("benchmark-v1",))


_FAMILIES: Mapping[str, str] = {
    "apg": "The expert corrected by the analytic gradient, from measurements alone.",
    "apg-preview": "A larger network, which sees the reference ahead and pays nearly nothing for its commands.",
    "apg-adverse": "Trained also where sensors, commands, actuators and current are not as told.",
    "helm": "One agent for both regimes: small errors seen as well as large ones, filters, and slewing thrusters.",
    "helm-blind": "`helm` without sight of the path ahead.",
    "helm-small": "`helm` with a network of 2,004 weights.",
    "helm-any": "`helm`, trained further on drawn vehicles and told which one it steers.",
    "apg-scratch": "Without an expert: the network commands alone.",
    "ppo": "The expert corrected by a network without memory, which learns from rewards until it gets no better.",
    "ppo-lstm": "The same with long short-term memory.",
    "sac": "The same from fewer steps, each of which is learned from many times.",
    "td3": "The same from fewer steps, each of which is learned from many times.",
}
"""What the agents that ship with the package are, by their names without the regime."""
BRIEF: Mapping[str, Variant] = {
    f"ppo-3m-{speed_range}": Variant(
        "The expert corrected by a network without memory, which learns from rewards.",
        speed_range,
        replace(training("ppo", weighted(speed_range, **SPINS), PPO_AUTHORITY[speed_range]), seeds=_SEEDS),
    )
    for speed_range in ("cruise", "slow")
}
"""PPO with a quarter of the steps of those that ship."""
SHORT_TRAININGS: Mapping[str, Variant] = {
    "short-cruise": _short("As `apg-cruise`, fewer steps: what the following ones differ from in one thing."),
    "short-preview": _short("The network sees the reference .5, 1, 2 and 4 s ahead.", preview=ERROR_ONLY["preview"]),
    "short-no-memory": _short("Two tanh layers in place of the recurrent units.", memory=False),
    "short-no-integrals": _short("The network does not see the integrals of the error.", integrals=False),
    "short-little-authority": _short("Half the authority.", authority=(0.3, 0.3)),
    "short-scratch": _short("Without an expert: the network commands alone.", NO_EXPERT, (1.0, 1.0)),
    "short-ekf": _short("The law on an extended Kalman filter as the expert.", "ekf"),
    "short-free": _short("Commands cost next to nothing.", effort_weight=0.002, rate_weight=0.001),
    "short-horizon": _short("The gradient goes back over 10 steps (1 s) in place of 50.", n_steps=10),
    "short-adam": _short("Every weight follows Adam, at its learning rate.", matrix_learning_rate=0.0),
}
"""Trainings that show what one thing is worth."""


def _shipped(name: str, each: TrainOptions) -> dict[str, Variant]:
    """Return the variants of an agent that ships: one, or one for each regime of an agent for both."""
    family, _, speed_range = name.rpartition("-")
    if speed_range in SPEED_RANGES:
        return {name: Variant(_FAMILIES[family], speed_range, replace(each, seeds=_SEEDS))}
    own = replace(each, seeds=_SEEDS)
    where = RECORDED_SUITES if name == OF_ALL_VEHICLES else OF_THE_PAPER
    return {
        f"{name}-{speed_range}": Variant(_FAMILIES[name], speed_range, own, where, name) for speed_range in SPEED_RANGES
    }


VARIANTS: Mapping[str, Variant] = {
    **{variant: own for name, each in SHIPPED_TRAININGS.items() for variant, own in _shipped(name, each).items()},
    **BRIEF,
    **SHORT_TRAININGS,
}
"""The agents of the study, by name."""


@dataclass(frozen=True)
class Options:
    """Train the agents of the study with several seeds, run them on the frozen suites and keep what they did.

    A second call goes on where the first was interrupted. Exit status: 0 done, 1 a training failed, 2 wrong usage.
    """

    name: Annotated[Positional[tuple[str, ...]], arg(metavar="[NAME ...]")] = ()
    """Which of them; without any, all."""
    out: Path = Path("runs/study")
    """Folder of the runs."""
    jobs: int = 2
    """Trainings at the same time."""
    install: bool = False
    """Put the first seed's agent into baselines/agents/shipped, where one of the name ships with the package."""


def main(arguments: Sequence[str]) -> int:
    """Train and evaluate as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    check_words("training", options.name, VARIANTS)
    for name in options.name or VARIANTS:
        variant = VARIANTS[name]
        agent = variant.runs or name
        request = request_of(variant.training, options.out / agent, options.jobs)
        if (status := train(request)) != DONE:
            return status
        if options.install and agent in SHIPPED_TRAININGS:
            install_agent(agent, request.folders[0])
        save_study(name, studied(variant, request, options.jobs), STUDIES_FOLDER)
    return DONE


def studied(variant: Variant, request: Request, jobs: int) -> Study:
    """Return what the trained agents of a request do on the suites of a variant."""
    agents = [str(folder / AGENT_FOLDER) for folder in request.folders]
    results = {name: _rolled_out(agents, suite_cells(name, variant.speed_range), jobs) for name in variant.suites}
    curves = [[row for row in read_progress(folder) if "score" in row] for folder in request.folders]
    return Study.of(variant.about, variant.speed_range, request.command, results, curves)


def suite_cells(suite: str, speed_range: str) -> list[Cell]:
    """Return the cells of a frozen suite in a regime."""
    return suites.load_suite(suite).cells_in((speed_range,))


def _rolled_out(agents: Sequence[str], cells: Sequence[Cell], jobs: int) -> list[list[Run]]:
    """Return the runs of each agent in the cells."""
    every = run_and_show([(agent, cell) for cell in cells for agent in agents], Workers(jobs))
    found = {(run.policy, run.scenario.name): run for run in every}
    return [[found[agent, cell.scenario.name] for cell in cells] for agent in agents]
