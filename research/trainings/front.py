"""Measure Pareto fronts of error against effort and command rate: `python -m research front --help`.

A front is a controller, or a family of agents, at several prices of its commands. One point is what ships with the
package. The others of a controller have swept or priced gains (`research.vehicles.priced`); the other agents of a
family are trained with other weights of effort and rate, the same in both regimes. All run the same episodes, and what
they did is kept in `research/data/fronts/` for the page of results.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from tyro.conf import Positional, arg

from auv_gym.scenarios.presets import REGIMES
from auv_gym.task.policy import Policy
from baselines.evaluation.rollout import EpisodeLog, Repeatable, Watch, beginning
from baselines.evaluation.runner import Cell, Run
from baselines.policies import make_policy
from baselines.tools.command_line import DONE, UsageError, check_words, parse
from baselines.training.command import train
from baselines.training.hyperparameters import changes_of, hyperparameter_words
from baselines.training.options import Options as TrainOptions
from baselines.training.run_folder import AGENT_FOLDER
from baselines.tuning import command as tuning
from baselines.tuning.tunables import TUNABLES
from research.results.front_files import FRONT_SUITE, FRONTS_FOLDER, Front, Point, save_front
from research.trainings.study import suite_cells
from research.trainings.trainings import SHIPPED_TRAININGS, request_of
from research.vehicles.priced import FACTORS, priced_gains, priced_record, prices_of, swept_gains

PROGRAM = "python -m research front"
CONTROLLERS = ("lqi", "ekf", "nmpc")
"""Controllers that have a front, the slowest one last."""
FRONT_WEIGHTS = ((0.003, 0.002), (0.02, 0.005), (0.1, 0.01), (0.5, 0.03))
"""What agents pay for effort and rate in training, behind those that ship with the package."""
_STEPS = 3_200_000  # control steps of each of these trainings, far fewer than of an agent that ships
_EPISODES = 40  # of each case, eight of each family of paths


@dataclass(frozen=True)
class Options:
    """Run the points of fronts through the first episodes of each case of benchmark-v1 and keep what they did.

    Agents that are missing are trained first. Exit status: 0 done, 1 a training failed, 2 wrong usage.
    """

    name: Annotated[Positional[tuple[str, ...]], arg(metavar="[NAME ...]")] = CONTROLLERS
    """Controllers, and families of agents by their names without the regime, such as apg-preview."""
    regime: tuple[Literal["slow", "cruise"], ...] = ("slow", "cruise")
    """Regimes, a front for each."""
    case: Annotated[tuple[str, ...], arg(metavar="C [C ...]", help_behavior_hint="")] = ()
    """Cases by name, to try it out; without any, all of them."""
    episodes: int = _EPISODES
    """Episodes of each case."""
    timesteps: int = _STEPS
    """Control steps of each training."""
    runs: Path = Path("runs/front")
    """Folder of the trainings."""
    out: Path = FRONTS_FOLDER
    """Folder for what the points did, NAME-REGIME.npz."""


def main(arguments: Sequence[str]) -> int:
    """Make and measure as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    if options.episodes < 1:
        raise UsageError(f"--episodes is {options.episodes}; it must be 1 or more")
    cases = [cell.scenario.name for regime in options.regime for cell in suite_cells(FRONT_SUITE, regime)]
    check_words("case", options.case, cases)
    for name in options.name:
        if name not in CONTROLLERS:
            _check_family(name)
    for name in options.name:
        for regime in options.regime:
            if not (cells := _cells(regime, options)):
                continue
            points, rows, episodes = [], [], Episodes(cells)
            for point, policy in controllers(name, regime) if name in CONTROLLERS else agents(name, regime, options):
                if policy is None:
                    return 1
                points.append(point)
                rows.append(episodes.run(name, policy))
                print(f"{name}, {regime}: {point.label}", flush=True)
            save_front(Front.of(name, regime, points, rows), options.out)
    return DONE


def controllers(name: str, regime: str) -> Iterator[tuple[Point, Policy]]:
    """Yield the points of a controller's front: swept by `FACTORS`, then at all prices that there are gains for."""
    factory, command = TUNABLES[name].factory, f"{tuning.PROGRAM} {name} --regime {regime}"
    for factor in FACTORS:
        yield Point(f"x {factor:g}", command, factor == 1), factory(dict(swept_gains(name, regime, factor)))
    for price in prices_of(name, regime)[1:]:
        own = priced_record(name, regime, price)["command"]
        yield Point(f"price {price:g}", own), factory(dict(priced_gains(name, regime, price)))


def agents(family: str, regime: str, options: Options) -> Iterator[tuple[Point, Policy | None]]:
    """Yield the points of a family's front, None for an agent whose training failed; what is missing is trained."""
    name = shipped_name(family, regime)
    request = request_of(SHIPPED_TRAININGS[name], options.runs / f"{name}-shipped")
    yield Point("shipped", request.command, shipped=True), make_policy(name)
    for effort, rate in FRONT_WEIGHTS:
        training = priced_training(SHIPPED_TRAININGS[name], effort, rate, options.timesteps)
        request = request_of(training, options.runs / f"{name}-{effort:g}")
        done = train(request) == DONE
        point = Point(f"{effort:g}, {rate:g}", request.command)
        yield point, make_policy(str(request.folders[0] / AGENT_FOLDER)) if done else None


def shipped_name(family: str, regime: str) -> str:
    """Return the agent of a family that serves a regime: one of that name alone serves both."""
    return family if family in SHIPPED_TRAININGS else f"{family}-{regime}"


def priced_training(training: TrainOptions, effort: float, rate: float, timesteps: int) -> TrainOptions:
    """Return a training with other weights of effort and rate, in every regime, and another length."""
    changes = changes_of(training.set)
    for kind, weight in (("effort_weight", effort), ("rate_weight", rate)):
        changes |= {name: weight for name in (*changes, kind) if name == kind or name.endswith(f"_{kind}")}
    return replace(training, timesteps=timesteps, set=tuple(hyperparameter_words(changes)))


class Episodes:
    """The episodes of a regime's cells, all side by side, to be run again and again by different policies."""

    def __init__(self, cells: Sequence[Cell]) -> None:
        """Take the cells."""
        self.cells = cells
        pairs = [(cell.scenario, cell.episodes) for cell in cells]
        self._episodes = Repeatable(lambda preview: beginning(pairs, preview))

    def run(self, name: str, policy: Policy) -> list[Run]:
        """Return what a policy does in each cell."""
        scenario, watch = self.cells[0].scenario, Watch()
        bounds = np.cumsum([0, *(len(cell.episodes) for cell in self.cells)]).tolist()
        log = EpisodeLog(scenario.steps, bounds[-1])
        for k, moment in enumerate(self._episodes.play(policy, scenario.steps, watch)):
            log.add(k, moment)
        measures, seconds = log.measures(scenario), watch.decision_seconds
        return [
            Run(name, cell.scenario, cell.hash, measures[a:b], decision_seconds=seconds)
            for cell, (a, b) in zip(self.cells, itertools.pairwise(bounds), strict=True)
        ]


def _cells(regime: str, options: Options) -> list[Cell]:
    """Return what is run in a regime."""
    known = suite_cells(FRONT_SUITE, regime)
    chosen = [cell for cell in known if not options.case or cell.scenario.name in options.case]
    return [replace(cell, episodes=cell.episodes[: options.episodes]) for cell in chosen]


def _check_family(name: str) -> None:
    """Raise UsageError if there is no agent of a family in every regime that is trained by the gradient."""
    known = sorted(
        {
            each.removesuffix(f"-{regime}")
            for each, t in SHIPPED_TRAININGS.items()
            for regime in REGIMES
            if t.algo == "apg"
        }
    )
    known = [family for family in known if all(shipped_name(family, regime) in SHIPPED_TRAININGS for regime in REGIMES)]
    if name not in known:
        raise UsageError(f"{name!r} has no front; allowed are {', '.join((*CONTROLLERS, *known))}")
