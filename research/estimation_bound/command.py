"""Compute the estimation lower bound of the position error: `python -m research estimation-bound`.

For each episode of benchmark-v1 with noisy measurements, the command computes how accurately the position can be
estimated if everything is known except the random numbers of the episode; see `model` and `filter`. The means over the
episodes of each case are kept in `research/data/estimation_bound.json`. `make pages` shows them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation import suites
from baselines.tools.command_line import DONE, UsageError, parse
from baselines.tools.files import json_text, read_json, write_atomically
from research import DATA
from research.estimation_bound.filter import PositionErrors, position_errors
from research.estimation_bound.model import EstimationModel, has_bound

PROGRAM = "python -m research estimation-bound"
_SUITE = "benchmark-v1"  # suite of the episodes
_FILE = DATA / "estimation_bound.json"  # record of the bounds
_BATCH = 52  # episodes that are computed together, limited by the memory
_FIRST = 2
"""Number of episodes of each case, the first ones, whose bounds are recorded one by one for comparison."""


@dataclass(frozen=True)
class Options:
    """Compute the estimation lower bound in the noisy cases of benchmark-v1. It takes two minutes.

    Exit status: 0 done, 2 wrong usage.
    """

    episodes: int | None = None
    """Number of episodes of each case, the first ones. Default: all."""
    out: Path = _FILE
    """File for the results."""


@dataclass(frozen=True)
class EstimationBound:
    """Lower bound of the error of every policy that measures the position, as means over the episodes of a case."""

    episodes: int
    rms_m: float  # [m] root of the mean squared position error after the first third of the episodes
    steady_rmse_m: float  # [m] mean of the steady-state errors, as in scores; see `filter.PositionErrors`
    first_m: tuple[float, ...]  # [m] steady-state errors of the first episodes

    @classmethod
    def of(cls, scenario: Scenario, episodes: Sequence[Episode]) -> EstimationBound:
        """Return the bound in episodes of a scenario; raises as `EstimationModel.of`."""
        parts = [episodes[first : first + _BATCH] for first in range(0, len(episodes), _BATCH)]
        found = [episode_errors(scenario, part) for part in parts]
        square, steady_rmse = (np.concatenate(column) for column in zip(*found, strict=True))
        first = tuple(steady_rmse[:_FIRST].tolist())
        return cls(len(steady_rmse), float(np.sqrt(square.mean())), float(steady_rmse.mean()), first)


def episode_errors(scenario: Scenario, episodes: Sequence[Episode]) -> PositionErrors:
    """Return the errors of the estimated position in episodes of a scenario; raises as `EstimationModel.of`."""
    return position_errors(EstimationModel.of(scenario, episodes), [episode.noise_seed for episode in episodes])


def main(arguments: Sequence[str]) -> int:
    """Compute and record the bounds and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options = parse(Options, arguments, PROGRAM)
    if options.episodes is not None and options.episodes < 1:
        raise UsageError(f"--episodes is {options.episodes}; it must be 1 or more")
    suite, found = suites.load_suite(_SUITE), {}
    for cell in suite.cells:
        if has_bound(cell.scenario):
            bound = found[cell.scenario.name] = EstimationBound.of(cell.scenario, cell.episodes[: options.episodes])
            print(f"{cell.scenario.name}: {1e3 * bound.steady_rmse_m:.2f} mm, {bound.episodes} episodes", flush=True)
    record = {"suite": suite.name, "hash": suite.hash, "cases": {name: asdict(bound) for name, bound in found.items()}}
    write_atomically(options.out, json_text(record))
    return DONE


def recorded_bounds(suite_hash: str, file: Path = _FILE) -> Mapping[str, EstimationBound]:
    """Return the recorded bounds of the suite with a hash, by case; {} without a record of it."""
    record: dict[str, Any] = read_json(file) if file.exists() else {"hash": None}
    if record["hash"] != suite_hash:
        return {}
    return {name: EstimationBound(**{**of, "first_m": tuple(of["first_m"])}) for name, of in record["cases"].items()}
