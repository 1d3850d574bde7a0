"""Validate agents during a training, on episodes that are not used for training."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.policy import Policy
from baselines.evaluation.cells import Cell, SideBySide, drawn
from baselines.evaluation.metrics import Ended, Measures
from baselines.evaluation.rollout import rollout
from baselines.evaluation.score import capped, error_cap, expert_of, has_failed, speed_range_of
from baselines.evaluation.suites import load_suite
from baselines.policies import make_policy
from baselines.tools.seeds import VALIDATION

_SUITE = "benchmark-v3-validation"  # suite with the validation episodes of its scenarios
VALIDATED_EPISODES = 64  # of each scenario that is not in the suite
_FEW = 12  # the same for a short training
VALIDATION_PRECISION = "float32"  # of agents' networks: a fifth of the time; the score differs by 1e-6


@dataclass(frozen=True)
class Verdict:
    """The results of a policy on the validation episodes."""

    score: float  # 0: the expert, 1: no error
    error_m: float  # mean capped steady-state RMSE [m]
    failed: float  # share of failed episodes


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

    Attributes:
        expert_m: mean capped steady-state RMSE [m] of the expert, by speed range; None: scenarios without one.
    """

    def __init__(self, cells: Sequence[Cell]) -> None:
        self.cells = cells
        self._episodes = SideBySide(cells)
        experts = []
        for cell in cells:
            policy = make_policy(expert_of([cell.scenario]), cell.scenario.known)
            experts.append(rollout(policy, cell.scenario, cell.episodes, math.inf).measures)
        self.expert_m = self._means(self._capped(experts))

    def run(self, policy: Policy) -> Verdict:
        """Return the results of a policy: means over scenarios, and the mean of the scores of the speed ranges.

        Raises:
            PolicyError: its actions are not finite.
        """
        ended = self._episodes.run(policy)
        steady_rmses = self._capped(ended)
        failed = [has_failed(own, _cap(cell.scenario)) for own, cell in zip(ended, self.cells, strict=True)]
        scores = [self.score(error_m, speed_range) for speed_range, error_m in self._means(steady_rmses).items()]
        return Verdict(float(np.mean(scores)), _mean(steady_rmses), _mean(failed))

    def score(self, error_m: float, speed_range: str | None) -> float:
        """Return the score of a mean capped steady-state RMSE [m] in the scenarios of a speed range."""
        expert_m = self.expert_m[speed_range]
        return 1 - error_m / expert_m if expert_m > 0 else math.nan

    def _capped(self, ended: Sequence[Measures | Ended]) -> list[Any]:
        return [capped(own, _cap(cell.scenario)) for own, cell in zip(ended, self.cells, strict=True)]

    def _means(self, steady_rmses: Sequence[Any]) -> dict[str | None, float]:
        """Return the mean over the cells of each speed range."""
        groups: dict[str | None, list[Any]] = {}
        for cell, errors in zip(self.cells, steady_rmses, strict=True):
            groups.setdefault(speed_range_of(cell.scenario.name), []).append(errors)
        return {speed_range: _mean(cells) for speed_range, cells in groups.items()}


def _cap(scenario: Scenario) -> float:
    cap = error_cap(scenario.name)
    return cap if math.isfinite(cap) else scenario.lost_distance


def _mean(cells: Sequence[Any]) -> float:
    return float(np.mean([np.mean(cell) for cell in cells]))
