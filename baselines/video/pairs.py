"""Compares policies in paired episodes, and finds the most typical of these episodes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.metrics import bootstrap_interval

SteadyRmses = Mapping[str, Array]
"""Steady-state RMSE [m] by policy, an entry for each of N episodes, which are the same for all policies."""


class Comparison(NamedTuple):
    """The mean steady-state RMSE of a policy and of another one in paired episodes."""

    policy: str
    other: str
    means: tuple[float, float]  # [m] of the policy and of the other one
    difference: tuple[float, float]  # [m] 95 % interval of the other's mean minus the policy's
    episodes: int
    scenario: str

    def __str__(self) -> str:
        (own, others), (low, high) = self.means, self.difference
        interval = f"; 95 % interval of the difference: {low:.3f} ... {high:.3f} m" if self.episodes > 1 else ""
        return (
            f"steady-state RMSE of {self.policy}: {own:.3f} m, of {self.other}: {others:.3f} m "
            f"({self.episodes} paired {'episodes' if self.episodes > 1 else 'episode'} of {self.scenario}{interval})"
        )


def comparisons(steady_rmses: SteadyRmses, scenario: Scenario) -> list[Comparison]:
    """Return the comparison of each policy with the first one."""
    (first, others), *rest = steady_rmses.items()
    return [
        Comparison(
            name,
            first,
            (float(own.mean()), float(others.mean())),
            bootstrap_interval(others - own),
            len(own),
            scenario.name,
        )
        for name, own in rest
    ]


def typical_episode(steady_rmses: SteadyRmses) -> int:
    """Return the index of the episode in which the ratios of the policies' errors are closest to their medians.

    The ratio of a policy is its steady-state RMSE divided by that of the first policy. The typical episode minimises
    the sum, over policies, of the absolute differences between the logarithm of the ratio and its median over all
    episodes. With one policy, its RMSE takes the place of the ratio.
    """
    (_, first), *rest = steady_rmses.items()
    logs = [np.log(own / first) for _, own in rest] or [np.log(first)]
    return int(np.argmin(sum(np.abs(values - np.median(values)) for values in logs)))
