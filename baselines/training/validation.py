"""Episodes that no agent is trained on, run again and again while one is trained."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from auv_gym import __version__
from auv_gym.namespaces import ARRAYS
from auv_gym.policy import Policy
from auv_gym.scenario import Scenario
from auv_gym.task import decode_observation
from baselines.agents.features import ERRORS, scaled_errors
from baselines.evaluation.metrics import Array
from baselines.evaluation.rollout import Moment
from baselines.evaluation.runner import Cell, drawn
from baselines.evaluation.score import cut, is_lost, largest_tail, waters_of
from baselines.evaluation.side_by_side import SideBySide
from baselines.evaluation.suites import load
from baselines.evaluation.suites.yardsticks import Yardstick, kept, measured
from baselines.tools.files import guarded, json_text, read_json, write_atomically
from baselines.tools.seeds import VALIDATION

SUITE = "benchmark-v1-validation"  # whose episodes agents are validated in
EPISODES = 64  # of each scenario that the suite does not hold
SEEN = 0.999
"""Share of the control steps of the validation episodes whose errors an agent's region holds."""
YARDSTICKS = "validation.json"  # file of a run folder that keeps what expert and oracle do where no suite does
PRECISION = "float32"  # of agents' networks here: a fifth of the time, and a score that differs by 1e-6


@dataclass(frozen=True)
class Verdict:
    """What a policy does on the validation episodes."""

    score: float  # 0: the expert, 1: the oracle; from tails of at most the cap
    error_m: float  # mean capped tail RMSE [m]
    lost: float  # share of the episodes that were lost, or whose tail reaches the cap
    region: tuple[float, ...]  # what `SEEN` of the scaled errors stay below, see `features.scaled_errors`


def validation_cell(scenario: Scenario) -> Cell:
    """Return the validation episodes of a scenario: those of the frozen suite for its scenarios, else drawn ones."""
    frozen = next((cell for cell in load(SUITE).cells if cell.scenario == scenario), None)
    return frozen or drawn(scenario, EPISODES, VALIDATION.first)


class Validation:
    """Validation episodes of some scenarios, all side by side.

    Args:
        cells: episodes of scenarios with the same number of substeps.
        folder: where what expert and oracle do is kept, for the next time; None: nowhere.
    """

    def __init__(self, cells: Sequence[Cell], folder: Path | None = None) -> None:
        self.cells = cells
        self._caps = [_cap(cell.scenario) for cell in cells]
        self._episodes = SideBySide(cells)
        self.expert_m, self.oracle_m = _yardsticks(cells, folder)

    def run(self, policy: Policy) -> Verdict:
        """Return what a policy does, the mean over scenarios.

        Raises:
            PolicyError: its actions are not finite.
        """
        scaled = np.full((self._episodes.steps, ERRORS, len(self._episodes.of)), math.nan)

        def watch(k: int, moment: Moment) -> None:
            seen = scaled_errors(decode_observation(moment.observation), ARRAYS)
            scaled[k] = np.where(moment.running, seen, math.nan)

        found = list(zip(self._caps, self._episodes.run(policy, watch), strict=True))
        tails = [cut(ended.tail, ended.lost, cap) for cap, ended in found]
        gone = [is_lost(ended.tail, ended.lost, cap) for cap, ended in found]
        error = _mean(tails)
        return Verdict(self.score(error), error, _mean(gone), _seen(scaled))

    def score(self, error_m: float) -> float:
        """Return the score of a mean capped tail [m]; where the oracle is no better than the expert, 1 is no error."""
        best = self.oracle_m if self.oracle_m < self.expert_m else 0.0
        return (self.expert_m - error_m) / (self.expert_m - best) if self.expert_m > 0 else math.nan


def _seen(scaled: Array) -> tuple[float, ...]:
    """Return what `SEEN` of each error's magnitudes stay below; shape (K, ERRORS, N), nan where an episode is over."""
    found: list[float] = np.nanquantile(np.abs(scaled), SEEN, axis=(0, 2)).tolist()
    return tuple(found)


def _cap(scenario: Scenario) -> float:
    cap = largest_tail(waters_of(scenario.name))
    return cap if math.isfinite(cap) else scenario.lost_distance


def _mean(cells: Sequence[Any]) -> float:
    return float(np.mean([np.mean(cell) for cell in cells]))


def _yardsticks(cells: Sequence[Cell], folder: Path | None) -> tuple[float, float]:
    """Return the mean capped tails [m] of expert and oracle: the suite's where it has them, else the folder's."""
    known = [kept(cell) for cell in cells]
    if all(known):
        return _means(filter(None, known))
    file = folder / YARDSTICKS if folder else None
    key = hashlib.sha256(" ".join([__version__, *(cell.hash for cell in cells)]).encode()).hexdigest()
    if file and (found := _read(file, key)):
        return found
    expert_m, oracle_m = _means(its or measured(cell) for its, cell in zip(known, cells, strict=True))
    if file:
        write_atomically(file, json_text({"hash": key, "expert_m": expert_m, "oracle_m": oracle_m}))
    return expert_m, oracle_m


def _means(yardsticks: Iterable[Yardstick]) -> tuple[float, float]:
    """Return the means over cells, of the expert and of the oracle."""
    expert_m, oracle_m = (_mean(its) for its in zip(*yardsticks, strict=True))
    return expert_m, oracle_m


def _read(file: Path, key: str) -> tuple[float, float] | None:
    """Return what a file has kept for the episodes of a key; None where it is missing, damaged or of others."""
    with suppress(OSError, ValueError), guarded(str(file)):
        record = read_json(file)
        return (float(record["expert_m"]), float(record["oracle_m"])) if record["hash"] == key else None
    return None
