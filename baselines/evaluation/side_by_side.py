"""Runs policies one after the other in the same parallel episodes of several scenarios."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from auv_gym.task.policy import Policy
from baselines.evaluation.metrics import Ended, steady_rmse
from baselines.evaluation.rollout import ControlStep, Repeatable, beginning
from baselines.evaluation.runner import Cell


class SideBySide:
    """All episodes of some cells in parallel; the results are those of `rollout` for each cell.

    Args:
        cells: cells whose scenarios have the same number of substeps.
    """

    def __init__(self, cells: Sequence[Cell]) -> None:
        self.cells = tuple(cells)
        self.of = np.repeat(np.arange(len(cells)), [len(cell.episodes) for cell in cells])
        self.steps = max(cell.scenario.steps for cell in cells)
        self._episodes = Repeatable(partial(beginning, [(cell.scenario, cell.episodes) for cell in cells]))

    def run(self, policy: Policy, watch: Callable[[int, ControlStep], None] = lambda *_: None) -> list[Ended]:
        """Run a policy and return the outcome of the episodes of each cell, arrays of shape (M,).

        Args:
            policy: a policy that is not `Privileged`.
            watch: called after each control step with its number and its results.

        Raises:
            PolicyError: the actions are not finite.
        """
        errors, failed = np.zeros((self.steps, len(self.of))), np.zeros(len(self.of), dtype=bool)
        for k, moment in enumerate(self._episodes.play(policy, self.steps)):
            watch(k, moment)
            errors[k] = moment.error
            failed |= moment.failed
        own = (self.of == i for i in range(len(self.cells)))
        steps = (cell.scenario.steps for cell in self.cells)
        return [Ended(steady_rmse(errors[:n, mine]), failed[mine]) for n, mine in zip(steps, own, strict=True)]
