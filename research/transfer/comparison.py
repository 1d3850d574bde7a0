"""Errors of the same policies on the same episodes in two simulators: their growth and their ranks."""

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
from baselines.evaluation.score import cap_of, capped, count_failures
from baselines.policies import make_policy
from research import DATA
from research.seeds import TRANSFER
from research.transfer.bodies import bodies
from research.transfer.simulators import SixDofSimulator

TRANSFER_FILE = DATA / "transfer.json"  # record of the results
_SPEED_RANGE = "cruise"  # the only speed range of vehicles with fins
PLANE = "plane"  # the simulator with three degrees of freedom
SPACE = "space"  # the simulator with six degrees of freedom
GROWTH = 1.5  # criterion: largest ratio of the errors
TAU = 0.8  # criterion: smallest rank correlation


@dataclass(frozen=True)
class TransferTask:
    """One policy on one vehicle in both simulators; the episodes of all cases are simulated together."""

    policy: str
    vehicle: str
    cases: tuple[str, ...]
    episodes: int  # number of episodes of each case

    def run(self) -> tuple[TransferTask, dict[str, Any]]:
        """Return the task and its results by case: capped steady-state errors [m] and failures in each simulator."""
        found: dict[str, dict[str, Any]] = {case: {} for case in self.cases}
        cells = self.cells
        for place in (PLANE, SPACE):
            measures = self.measures(place, cells)
            for i, (case, cell) in enumerate(zip(self.cases, cells, strict=True)):
                own, cap = measures[i * self.episodes : (i + 1) * self.episodes], cap_of(cell.scenario)
                found[case][place] = {"steady_rmse": capped(own, cap), "failed": count_failures(own, cap)}
        return self, found

    @property
    def cells(self) -> list[Cell]:
        """Scenario and episodes of each case, all with the largest number of integration steps that a case needs."""
        scenarios = [as_scenario(f"{_SPEED_RANGE}-{case}@{self.vehicle}") for case in self.cases]
        substeps = max(scenario.substeps for scenario in scenarios)
        return [drawn(replace(scenario, substeps=substeps), self.episodes, TRANSFER.first) for scenario in scenarios]

    def bodies(self, place: str) -> MadeBodies | None:
        """Return the argument `bodies` of `beginning` for a simulator; None for the plane."""
        if place == PLANE:
            return None
        return bodies(lambda n: SixDofSimulator(self.vehicle, n), vehicle_model(self.vehicle).vehicle)

    def measures(self, place: str, cells: Sequence[Cell]) -> Measures:
        """Run the policy in a simulator, `PLANE` or `SPACE`, and return the measures of its episodes, case by case."""
        scenario, policy = cells[0].scenario, make_policy(self.policy, vehicle_model(self.vehicle).vehicle)
        given = [(cell.scenario, cell.episodes) for cell in cells]
        begun = beginning(given, preview_of(policy), bodies=self.bodies(place))
        log = EpisodeLog(scenario.steps, self.episodes * len(cells))
        for k, moment in enumerate(play(policy, begun, scenario.steps)):
            log.add(k, moment)
        return log.measures(scenario)


def concordance(a: Array, b: Array) -> NDArray[np.float64]:
    """Return Kendall's tau of rows without ties, shapes (..., P): the mean over pairs of the product of their signs."""
    first, second = np.triu_indices(a.shape[-1], 1)
    signs = np.sign(a[..., first] - a[..., second]) * np.sign(b[..., first] - b[..., second])
    return np.asarray(signs.mean(axis=-1))


def pooled(steady_rmses: Sequence[Array]) -> Array:
    """Return the mean errors over all cases of P policies, as measured and resampled, shape (1 + resamples, P).

    Args:
        steady_rmses: errors [m] in each case, shape (P, episodes).
    """
    counts = resamplings(tuple(own.shape[1] for own in steady_rmses))
    means = [count @ own.T / own.shape[1] for count, own in zip(counts, steady_rmses, strict=True)]
    return np.asarray(np.mean(means, axis=0))


def _ends(values: Array) -> list[float]:
    """Return the 2.5th and 97.5th percentile of resampled values."""
    return [float(x) for x in np.quantile(values, (0.025, 0.975))]


def _best(names: Sequence[str], means: Array) -> list[str]:
    """Return the policy with the smallest mean error, then those whose difference to it has an interval with zero.

    Args:
        names: of P policies.
        means: as measured and resampled, see `pooled`.
    """
    order = np.argsort(means[0])
    level = [i for i in order[1:] if _ends(means[1:, i] - means[1:, order[0]])[0] <= 0]
    return [names[i] for i in (order[0], *level)]


def summary(results: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> dict[str, Any]:
    """Return the summary of a vehicle's results: errors and growth by policy, and rank correlations.

    Intervals are the 2.5th and 97.5th percentile over resampled episodes, the same ones in both simulators and for all
    policies.

    Args:
        results: results of `TransferTask.run`, by policy and case.
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
            "failed_plane": sum(results[name][case][PLANE]["failed"] for case in cases),
            "failed_space": sum(results[name][case][SPACE]["failed"] for case in cases),
            "growth_by_case": {
                case: float(steady_rmses[SPACE][j][i].mean() / steady_rmses[PLANE][j][i].mean())
                for j, case in enumerate(cases)
            },
        }
        for i, name in enumerate(names)
    }
    medians = [np.mean([np.median(own, axis=1) for own in steady_rmses[place]], axis=0) for place in (PLANE, SPACE)]
    by_case = {
        case: float(concordance(*(steady_rmses[p][j].mean(axis=1) for p in steady_rmses)))
        for j, case in enumerate(cases)
    }
    return {
        "episodes": steady_rmses[PLANE][0].shape[1],
        "cases": cases,
        "policies": policies,
        "best": {place: _best(names, means) for place, means in ((PLANE, plane), (SPACE, space))},
        "tau": {
            "all": float(taus[0]),
            "ci95": _ends(taus[1:]),
            "medians": float(concordance(*medians)),
            "by_case": by_case,
        },
    }
