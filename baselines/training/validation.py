"""Validate agents during a training, on episodes that are not used for training."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.observation import decode_observation
from auv_gym.task.policy import Policy
from baselines.agents.features import ERROR_FEATURES, scaled_errors
from baselines.evaluation.rollout import ControlStep
from baselines.evaluation.runner import Cell, drawn
from baselines.evaluation.score import capped, error_cap, has_failed, speed_range_of
from baselines.evaluation.side_by_side import SideBySide
from baselines.evaluation.suites import load_suite
from baselines.evaluation.suites.anchor_errors import AnchorErrors, measured_anchor_errors, recorded_anchor_errors
from baselines.tools.seeds import VALIDATION

_SUITE = "benchmark-v1-validation"  # suite with the validation episodes of its scenarios
VALIDATED_EPISODES = 64  # of each scenario that is not in the suite
_FEW = 12  # the same for a short training
_QUANTILE = 0.999
"""Quantile of the errors in the validation episodes that an agent's region contains."""
VALIDATION_PRECISION = "float32"  # of agents' networks: a fifth of the time; the score differs by 1e-6


@dataclass(frozen=True)
class Verdict:
    """The results of a policy on the validation episodes."""

    score: float  # 0: the expert, 1: the oracle
    error_m: float  # mean capped steady-state RMSE [m]
    failed: float  # share of failed episodes
    region: tuple[float, ...]  # `_QUANTILE` of the magnitudes of the scaled errors, see `features.scaled_errors`


def validation_cell(scenario: Scenario, brief: bool = False) -> Cell:
    """Return the validation episodes of a scenario: those of the suite if it has the scenario, else drawn ones.

    With `brief` there are only `_FEW`, all of them drawn.
    """
    if brief:
        return drawn(scenario, min(_FEW, VALIDATED_EPISODES), VALIDATION.first)
    frozen = next((cell for cell in load_suite(_SUITE).cells if cell.scenario == scenario), None)
    return frozen or drawn(scenario, VALIDATED_EPISODES, VALIDATION.first)


class Validation:
    """Validation episodes of several scenarios, run in parallel.

    Args:
        cells: episodes of scenarios with the same number of substeps.
        brief: omit the oracle; a score of 1 is then zero error.
    """

    def __init__(self, cells: Sequence[Cell], brief: bool = False) -> None:
        self.cells = cells
        self._caps = [_cap(cell.scenario) for cell in cells]
        self._episodes = SideBySide(cells)
        errors = [recorded_anchor_errors(cell) or measured_anchor_errors(cell, brief) for cell in cells]
        self.anchor_errors = {speed_range: _means(own) for speed_range, own in self._by_speed_range(errors).items()}

    def run(self, policy: Policy) -> Verdict:
        """Return the results of a policy: means over scenarios, and the mean of the scores of the speed ranges.

        Raises:
            PolicyError: its actions are not finite.
        """
        scaled = np.full((self._episodes.steps, ERROR_FEATURES, len(self._episodes.of)), math.nan)

        def watch(k: int, moment: ControlStep) -> None:
            seen = scaled_errors(decode_observation(moment.observation), ARRAYS)
            scaled[k] = np.where(moment.running, seen, math.nan)

        found = list(zip(self._caps, self._episodes.run(policy, watch), strict=True))
        steady_rmses = [capped(ended, cap) for cap, ended in found]
        failed = [has_failed(ended, cap) for cap, ended in found]
        scores = [
            self.score(_mean(own), speed_range) for speed_range, own in self._by_speed_range(steady_rmses).items()
        ]
        return Verdict(float(np.mean(scores)), _mean(steady_rmses), _mean(failed), _region(scaled))

    def score(self, error_m: float, speed_range: str | None) -> float:
        """Return the score of a mean capped steady-state RMSE [m] in the scenarios of a speed range.

        `speed_range` is None for scenarios without one. If the oracle is not better than the expert, a score of 1 is
        zero error.
        """
        expert_m, oracle_m = self.anchor_errors[speed_range]
        best = oracle_m if oracle_m < expert_m else 0.0
        return (expert_m - error_m) / (expert_m - best) if expert_m > 0 else math.nan

    def _by_speed_range(self, values: Sequence[Any]) -> dict[str | None, list[Any]]:
        """Return the values of the cells, grouped by speed range."""
        found: dict[str | None, list[Any]] = {}
        for cell, value in zip(self.cells, values, strict=True):
            found.setdefault(speed_range_of(cell.scenario.name), []).append(value)
        return found


def _region(scaled: Array) -> tuple[float, ...]:
    """Return the `_QUANTILE` of the magnitude of each of `ERROR_FEATURES`; `scaled` is nan after an episode's end."""
    quantiles: list[float] = np.nanquantile(np.abs(scaled), _QUANTILE, axis=(0, 2)).tolist()
    return tuple(quantiles)


def _cap(scenario: Scenario) -> float:
    cap = error_cap(scenario.name)
    return cap if math.isfinite(cap) else scenario.lost_distance


def _mean(cells: Sequence[Any]) -> float:
    return float(np.mean([np.mean(cell) for cell in cells]))


def _means(anchor_errors: Iterable[AnchorErrors]) -> AnchorErrors:
    """Return the means over cells, of the expert and of the oracle."""
    return AnchorErrors(*(_mean(errors) for errors in zip(*anchor_errors, strict=True)))
