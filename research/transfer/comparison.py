"""What two simulators say about the same policies on the same episodes: how much errors grow, and who leads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.presets import as_scenario
from auv_gym.scenarios.vehicles import vehicle_model
from auv_gym.task.kernels import MadeBodies
from auv_gym.task.policy import preview_of
from baselines.evaluation.metrics import Measures, resamplings
from baselines.evaluation.rollout import EpisodeLog, beginning, play
from baselines.evaluation.runner import Cell, drawn
from baselines.policies import make_policy
from research import DATA
from research.seeds import TRANSFER
from research.transfer.bodies import bodies
from research.transfer.worlds import WORLD_VARIANTS, Own

TRANSFER_FILE = DATA / "transfer.json"  # what came out
_SPEED_RANGE = "cruise"  # vehicles that fins steer have no other
PLANE = "plane"  # the simulator of three degrees of freedom
SPACE = "space"  # the one of six
GROWTH = 1.5  # most growth of an error that is asked for
TAU = 0.8  # least rank correlation that is asked for


@dataclass(frozen=True)
class TransferTask:
    """One policy on one vehicle, in both simulators; the episodes of all cases run side by side."""

    policy: str
    vehicle: str
    cases: tuple[str, ...]
    episodes: int  # of each case
    lacking: str = ""  # one of the `WORLD_VARIANTS` of the vehicle, in place of the published one

    def run(self) -> tuple[TransferTask, dict[str, Any]]:
        """Return the task, and by case what came out: tail errors [m] and lost episodes in each simulator."""
        found: dict[str, dict[str, Any]] = {case: {} for case in self.cases}
        for place in (PLANE, SPACE):
            measures = self.played(place)
            for i, case in enumerate(self.cases):
                own = measures[i * self.episodes : (i + 1) * self.episodes]
                steady_rmses = [float(f"{steady_rmse:.4g}") for steady_rmse in own.steady_rmse]
                found[case][place] = {"steady_rmse": steady_rmses, "failed": int(own.failed.sum())}
        return self, found

    @property
    def cells(self) -> list[Cell]:
        """Scenario and episodes of each case, all with the number of integration steps that the stiffest one needs."""
        scenarios = [as_scenario(f"{_SPEED_RANGE}-{case}@{self.vehicle}") for case in self.cases]
        substeps = max(scenario.substeps for scenario in scenarios)
        return [drawn(replace(scenario, substeps=substeps), self.episodes, TRANSFER.first) for scenario in scenarios]

    def bodies(self, place: str) -> MadeBodies | None:
        """Return what makes the vehicles of a simulator; None for the plane."""
        vehicle: Any = WORLD_VARIANTS[self.vehicle][self.lacking] if self.lacking else self.vehicle
        return bodies(lambda n: Own(vehicle, n), vehicle_model(self.vehicle).vehicle) if place == SPACE else None

    def played(self, place: str) -> Measures:
        """Return what the policy does in one of the simulators, `PLANE` or `SPACE`, case by case."""
        cells = self.cells
        scenario, policy = cells[0].scenario, make_policy(self.policy, vehicle_model(self.vehicle).vehicle)
        given = [(cell.scenario, cell.episodes) for cell in cells]
        begun = beginning(given, preview_of(policy), bodies=self.bodies(place))
        log = EpisodeLog(scenario.steps, self.episodes * len(cells))
        for k, moment in enumerate(play(policy, begun, scenario.steps)):
            log.add(k, moment)
        return log.measures(scenario)


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
    growth: dict[str, dict[str, float]] = {what: {} for what in WORLD_VARIANTS[vehicle]}
    for policy in CAUSED_POLICIES:
        plane = TransferTask(policy, vehicle, (CAUSED,), episodes).played(PLANE).steady_rmse.mean()
        for what, found in growth.items():
            space = TransferTask(policy, vehicle, (CAUSED,), episodes, lacking=what).played(SPACE).steady_rmse.mean()
            found[policy] = float(space / plane)
    return {"case": CAUSED, "policies": list(CAUSED_POLICIES), "episodes": episodes, "growth": growth}


def concordance(a: Array, b: Array) -> NDArray[np.float64]:
    """Return Kendall's tau of rows without ties, shapes (..., P): the mean over pairs of the signs' product."""
    first, second = np.triu_indices(a.shape[-1], 1)
    signs = np.sign(a[..., first] - a[..., second]) * np.sign(b[..., first] - b[..., second])
    return np.asarray(signs.mean(axis=-1))


def pooled(steady_rmses: Sequence[Array]) -> Array:
    """Return the mean over cases of policies' mean tails, shape (1 + resamples, P); the first as measured.

    Args:
        steady_rmses: of each case [m], shape (P, episodes).
    """
    counts = resamplings(tuple(own.shape[1] for own in steady_rmses))
    means = [count @ own.T / own.shape[1] for count, own in zip(counts, steady_rmses, strict=True)]
    return np.asarray(np.mean(means, axis=0))


def _ends(values: Array) -> list[float]:
    """Return the 2.5th and 97.5th percentile of resampled values."""
    return [float(x) for x in np.quantile(values, (0.025, 0.975))]


def summarised(results: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> dict[str, Any]:
    """Return what a vehicle's results say: by policy in all, by case, and the rank correlation.

    Intervals are the 2.5th and 97.5th percentile over resampled episodes, the same ones in both simulators and for all
    policies.

    Args:
        results: by policy and case what `TransferTask.run` gives.
    """
    names, cases = list(results), list(next(iter(results.values())))
    steady_rmses = {
        place: [np.array([results[name][case][place]["steady_rmse"] for name in names]) for case in cases]
        for place in (PLANE, SPACE)
    }
    plane, space = pooled(steady_rmses[PLANE]), pooled(steady_rmses[SPACE])
    growth, taus = space / plane, concordance(plane, space)
    policies = {
        name: {
            "plane_m": float(plane[0, i]),
            "space_m": float(space[0, i]),
            "growth": float(growth[0, i]),
            "ci95": _ends(growth[1:, i]),
            "worst_plane_m": max(float(own[i].max()) for own in steady_rmses[PLANE]),
            "worst_space_m": max(float(own[i].max()) for own in steady_rmses[SPACE]),
            "lost_plane": sum(results[name][case][PLANE]["failed"] for case in cases),
            "lost_space": sum(results[name][case][SPACE]["failed"] for case in cases),
            "growth_by_case": {
                case: float(steady_rmses[SPACE][j][i].mean() / steady_rmses[PLANE][j][i].mean())
                for j, case in enumerate(cases)
            },
        }
        for i, name in enumerate(names)
    }
    middle = [np.mean([np.median(own, axis=1) for own in steady_rmses[place]], axis=0) for place in (PLANE, SPACE)]
    by_case = {
        case: float(concordance(*(steady_rmses[p][j].mean(axis=1) for p in steady_rmses)))
        for j, case in enumerate(cases)
    }
    return {
        "episodes": steady_rmses[PLANE][0].shape[1],
        "cases": cases,
        "policies": policies,
        "tau": {
            "all": float(taus[0]),
            "ci95": _ends(taus[1:]),
            "medians": float(concordance(*middle)),
            "by_case": by_case,
        },
    }
