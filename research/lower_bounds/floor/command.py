"""Compute the floor that measurement noise lays under everybody's errors: `python -m research estimation-bound`.

For each episode of benchmark-v1 whose measurements are noisy it computes how well the vehicle can be located by whom
everything is told but the numbers that were drawn, see `model` and `filter`, and keeps the means over the episodes of
each case in `research/data/floor.json`, from which `make pages` writes what is left to gain.
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
from research.lower_bounds.floor.filter import Located, located
from research.lower_bounds.floor.model import FloorModel, has_floor

PROGRAM = "python -m research estimation-bound"
_SUITE = "benchmark-v1"  # whose episodes have a floor
_FILE = DATA / "floor.json"  # what is kept
_AT_ONCE = 52  # episodes that are looked at together: few enough for the memory
_FIRST = 2
"""Episodes of each case, the first ones, of which the floor is kept one by one, to be compared with."""


@dataclass(frozen=True)
class Options:
    """Compute the floor of measurement noise in the noisy cases of benchmark-v1; it takes two minutes.

    Exit status: 0 done, 2 wrong usage.
    """

    episodes: int | None = None
    """Of each case, the first ones. Default: all."""
    out: Path = _FILE
    """File for what is found."""


@dataclass(frozen=True)
class Floor:
    """What no policy's error can be below in a case, means over its episodes."""

    episodes: int
    rms_m: float  # [m] root of the mean squared error of the position in tails
    steady_rmse_m: float  # [m] mean of the root mean square over a tail, as scores have it; see `filter.Located`
    first_m: tuple[float, ...]  # [m] that of the first episodes

    @classmethod
    def of(cls, scenario: Scenario, episodes: Sequence[Episode]) -> Floor:
        """Return the floor in some episodes of a scenario; raises as `FloorModel.of`."""
        parts = [episodes[first : first + _AT_ONCE] for first in range(0, len(episodes), _AT_ONCE)]
        found = [floor_of(scenario, part) for part in parts]
        square, steady_rmse = (np.concatenate(column) for column in zip(*found, strict=True))
        first = tuple(steady_rmse[:_FIRST].tolist())
        return cls(len(steady_rmse), float(np.sqrt(square.mean())), float(steady_rmse.mean()), first)


def floor_of(scenario: Scenario, episodes: Sequence[Episode]) -> Located:
    """Return how well the vehicles can be located in episodes of a scenario; raises as `FloorModel.of`."""
    return located(FloorModel.of(scenario, episodes), [episode.noise_seed for episode in episodes])


def main(arguments: Sequence[str]) -> int:
    """Compute and keep as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    if options.episodes is not None and options.episodes < 1:
        raise UsageError(f"--episodes is {options.episodes}; it must be 1 or more")
    suite, found = suites.load_suite(_SUITE), {}
    for cell in suite.cells:
        if has_floor(cell.scenario):
            floor = found[cell.scenario.name] = Floor.of(cell.scenario, cell.episodes[: options.episodes])
            print(f"{cell.scenario.name}: {1e3 * floor.steady_rmse_m:.2f} mm, {floor.episodes} episodes", flush=True)
    record = {"suite": suite.name, "hash": suite.hash, "cases": {name: asdict(floor) for name, floor in found.items()}}
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(options.out, json_text(record))
    return DONE


def recorded_floors(suite_hash: str, file: Path = _FILE) -> Mapping[str, Floor]:
    """Return the floors of the cases of a suite of episodes of that hash, by case; {} where none are kept."""
    record: dict[str, Any] = read_json(file) if file.exists() else {"hash": None}
    if record["hash"] != suite_hash:
        return {}
    return {name: Floor(**{**of, "first_m": tuple(of["first_m"])}) for name, of in record["cases"].items()}
