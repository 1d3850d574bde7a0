"""What two simulators say about the same policies on the same episodes: how much errors grow, and who leads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from auv_gym.presets import as_scenario
from baselines import make_policy
from baselines.elsewhere.bodies import bodies
from baselines.elsewhere.installed import Installed
from baselines.elsewhere.worlds import VARIANTS, Own
from baselines.evaluation.metrics import Array, resamplings
from baselines.evaluation.rollout import Rollout, rollout
from baselines.evaluation.runner import drawn
from baselines.tools.seeds import ELSEWHERE

REGIME = "cruise"  # vehicles that fins steer have no other
SIMULATORS = {"own": Own, "installed": Installed}
"""What moves the vehicles in six degrees of freedom: the equations here, or the user's PythonVehicleSimulator."""
PLANE, SPACE = "plane", "space"
"""The two simulators: the plane's three degrees of freedom, and six."""
GROWTH, TAU = 1.5, 0.8
"""What is asked for: no error larger by more, and a rank correlation of at least this."""


@dataclass(frozen=True)
class Task:
    """One policy in one case on one vehicle, in both simulators."""

    policy: str
    vehicle: str
    case: str
    episodes: int
    simulator: str = "own"
    lacking: str = ""  # one of the `VARIANTS` of the vehicle, in place of the published one

    def run(self) -> tuple[Task, dict[str, Any]]:
        """Return the task, and what came out: tail errors [m] and lost episodes in each simulator."""
        found = {}
        for place in (PLANE, SPACE):
            measures = self.played(place).measures
            tails = [float(f"{tail:.4g}") for tail in measures.tail]
            found[place] = {"tail": tails, "lost": int(measures.lost.sum())}
        return self, found

    def played(self, place: str) -> Rollout:
        """Return what the policy does in one of the simulators, `PLANE` or `SPACE`."""
        scenario = as_scenario(f"{REGIME}-{self.case}@{self.vehicle}")
        cell, made = drawn(scenario, self.episodes, ELSEWHERE.first), SIMULATORS[self.simulator]
        vehicle: Any = VARIANTS[self.vehicle][self.lacking] if self.lacking else self.vehicle
        moved = bodies(lambda n: made(vehicle, n), scenario.vehicle) if place == SPACE else None
        return rollout(make_policy(self.policy, scenario.vehicle), scenario, cell.episodes, bodies=moved)


CAUSED = "current"
"""The case in which causes are looked for: a steady trouble, and one that growth is seen in."""
CAUSED_POLICIES = ("los-pid", "ekf")
"""Whose growth is looked at: one that feeds back alone, and one that believes in a model."""


def caused(vehicle: str, episodes: int) -> dict[str, Any]:
    """Return the growth of the mean tail error where the vehicle in space lacks what may make it.

    Args:
        vehicle: its name.
        episodes: how many are run.
    """
    growth: dict[str, dict[str, float]] = {what: {} for what in VARIANTS[vehicle]}
    for policy in CAUSED_POLICIES:
        plane = Task(policy, vehicle, CAUSED, episodes).played(PLANE).measures.tail.mean()
        for what, found in growth.items():
            space = Task(policy, vehicle, CAUSED, episodes, lacking=what).played(SPACE).measures.tail.mean()
            found[policy] = float(space / plane)
    return {"case": CAUSED, "policies": list(CAUSED_POLICIES), "episodes": episodes, "growth": growth}


def concordance(a: Array, b: Array) -> NDArray[np.float64]:
    """Return Kendall's tau of rows without ties, shapes (..., P): the mean over pairs of the signs' product."""
    first, second = np.triu_indices(a.shape[-1], 1)
    signs = np.sign(a[..., first] - a[..., second]) * np.sign(b[..., first] - b[..., second])
    return np.asarray(signs.mean(axis=-1))


def pooled(tails: Sequence[Array]) -> Array:
    """Return the geometric mean over cases of policies' mean tails, shape (1 + resamples, P); the first as measured.

    Args:
        tails: of each case [m], shape (P, episodes).
    """
    counts = resamplings(tuple(own.shape[1] for own in tails))
    logs = [np.log(count @ own.T / own.shape[1]) for count, own in zip(counts, tails, strict=True)]
    return np.asarray(np.exp(np.mean(logs, axis=0)))


def ends(values: Array) -> list[float]:
    """Return the 2.5th and 97.5th percentile of resampled values."""
    return [float(x) for x in np.quantile(values, (0.025, 0.975))]


def summarised(results: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> dict[str, Any]:
    """Return what a vehicle's results say: by policy in all, by case, and the rank correlation.

    Intervals are the 2.5th and 97.5th percentile over resampled episodes, the same ones in both simulators and for all
    policies.

    Args:
        results: by policy and case what `Task.run` gives.
    """
    names, cases = list(results), list(next(iter(results.values())))
    tails = {
        place: [np.array([results[name][case][place]["tail"] for name in names]) for case in cases]
        for place in (PLANE, SPACE)
    }
    plane, space = pooled(tails[PLANE]), pooled(tails[SPACE])
    growth, taus = space / plane, concordance(plane, space)
    policies = {
        name: {
            "plane_m": float(plane[0, i]),
            "space_m": float(space[0, i]),
            "growth": float(growth[0, i]),
            "ci95": ends(growth[1:, i]),
            "lost_plane": sum(results[name][case][PLANE]["lost"] for case in cases),
            "lost_space": sum(results[name][case][SPACE]["lost"] for case in cases),
            "growth_by_case": {
                case: float(tails[SPACE][j][i].mean() / tails[PLANE][j][i].mean()) for j, case in enumerate(cases)
            },
        }
        for i, name in enumerate(names)
    }
    by_case = {
        case: float(stats.kendalltau(tails[PLANE][j].mean(axis=1), tails[SPACE][j].mean(axis=1)).statistic)
        for j, case in enumerate(cases)
    }
    return {
        "episodes": tails[PLANE][0].shape[1],
        "cases": cases,
        "policies": policies,
        "tau": {"all": float(taus[0]), "ci95": ends(taus[1:]), "by_case": by_case},
    }
