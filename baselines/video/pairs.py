"""Policies in pairs: what they keep in the same episodes, and which of these shows it best."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.metrics import bootstrap_interval

SteadyRmses = Mapping[str, Array]
"""Tail RMSE [m] of policies by name, an entry for each of N episodes that are the same for all."""


class Lead(NamedTuple):
    """How far one policy keeps nearer to the reference than another, in N paired episodes."""

    policy: str
    other: str
    kept: tuple[float, float]  # [m] mean tail of the policy and of the other one
    less: tuple[float, float]  # [m] 95 % interval of the other's mean tail less the policy's
    episodes: int
    scenario: str

    def __str__(self) -> str:
        (kept, others), (low, high) = self.kept, self.less
        said = f"; 95 % interval of the difference: {low:.3f} ... {high:.3f} m" if self.episodes > 1 else ""
        return (
            f"{self.policy} keeps {kept:.3f} m where {self.other} keeps {others:.3f} m "
            f"({self.episodes} paired {'episodes' if self.episodes > 1 else 'episode'} of {self.scenario}{said})"
        )


def leads(steady_rmses: SteadyRmses, scenario: Scenario) -> list[Lead]:
    """Return how far each policy but the first keeps nearer to the reference than the first does."""
    (first, others), *rest = steady_rmses.items()
    return [
        Lead(
            name,
            first,
            (float(own.mean()), float(others.mean())),
            bootstrap_interval(others - own),
            len(own),
            scenario.name,
        )
        for name, own in rest
    ]


def typical(steady_rmses: SteadyRmses) -> int:
    """Return the number of the episode whose errors relate to one another as they do in the median episode.

    Of each policy but the first, the logarithm of its tail over the first one's is compared with the median of that
    over all episodes; the typical episode has the smallest sum of absolute differences. With one policy it is the tail
    itself that is compared.
    """
    (_, first), *rest = steady_rmses.items()
    logs = [np.log(own / first) for _, own in rest] or [np.log(first)]
    return int(np.argmin(sum(np.abs(values - np.median(values)) for values in logs)))
