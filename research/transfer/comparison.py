"""Run the same policies in the plane and in six degrees of freedom, and compare: `python -m research transfer`.

Each row is a policy on a vehicle; the page compares the growth of errors and the ranks of the policies.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.presets import as_scenario
from auv_gym.scenarios.vehicles import vehicle_model
from auv_gym.task.policy import preview_of
from baselines.evaluation.cells import Cell, drawn
from baselines.evaluation.fingerprints import code_fingerprint
from baselines.evaluation.metrics import resamplings
from baselines.evaluation.rollout import EpisodeLog, beginning, play
from baselines.evaluation.score import cap_of, capped, count_failures
from baselines.policies import make_policy
from research.seeds import TRANSFER
from research.study import Study, stamp
from research.transfer.simulators import SIX_DOF_MODELS, SixDofSimulator, bodies
from research.transfer.trials import steady_motion

_POLICIES = (
    "backstepping",
    "backstepping-normalised",
    "integral-normalised",
    "ilos",
    "los-pid",
    "lqi",
    "ekf",
    "nmpc",
    "helm",
    "helm-any",
)
_CASES = ("calm", "noise", "current", "waves", "mismatch", "storm")
"""Cases with the same disturbances in both simulators, which have different actuator lags."""
_EPISODES = 64  # of each case
_SPEED_RANGE = "cruise"  # the only speed range of vehicles with fins
PLANE = "plane"  # the simulator with three degrees of freedom
SPACE = "space"  # the simulator with six degrees of freedom
_TRIALS = "trials"  # the row of a vehicle with its steady motion in both simulators
GROWTH = 1.5  # criterion: largest ratio of the errors
TAU = 0.8  # criterion: smallest rank correlation


def _measure(vehicle: str, policy: str, quick: bool = False) -> dict[str, Any]:
    """Return capped steady-state errors [m] and failures of a policy, by case and simulator, or the steady motion."""
    if policy == _TRIALS:
        return steady_motion(vehicle)
    known, n = vehicle_model(vehicle).vehicle, 2 if quick else _EPISODES
    cells, made = transfer_cells(vehicle, n), make_policy(policy, known)
    simulators = {PLANE: None, SPACE: bodies(lambda count: SixDofSimulator(vehicle, count), known)}
    rows: dict[str, dict[str, Any]] = {case: {} for case in _CASES}
    for place, simulator in simulators.items():
        scenario, log = cells[0].scenario, EpisodeLog(cells[0].scenario.steps, n * len(cells), 2)
        begun = beginning([(cell.scenario, cell.episodes) for cell in cells], preview_of(made), simulator=simulator)
        for k, moment in enumerate(play(made, begun, scenario.steps)):
            log.add(k, moment)
        measures = log.measures(scenario)
        for i, (case, cell) in enumerate(zip(_CASES, cells, strict=True)):
            of_case, cap = measures[i * n : (i + 1) * n], cap_of(cell.scenario)
            errors = [float(f"{x:.6g}") for x in capped(of_case, cap)]
            rows[case][place] = {"steady_rmse": errors, "failed": count_failures(of_case, cap)}
    return rows


def transfer_cells(vehicle: str, episodes: int) -> list[Cell]:
    """Return the cell of each case, all with the largest number of integration steps that a case needs."""
    scenarios = [as_scenario(f"{_SPEED_RANGE}-{case}@{vehicle}") for case in _CASES]
    substeps = max(scenario.substeps for scenario in scenarios)
    return [drawn(replace(scenario, substeps=substeps), episodes, TRANSFER.first) for scenario in scenarios]


def _stamp(vehicle: str, policy: str) -> str:
    code = code_fingerprint(Path(__file__).parent)
    if policy == _TRIALS:
        return code
    return stamp(policy, [as_scenario(f"{_SPEED_RANGE}-{case}@{vehicle}") for case in _CASES], code, _EPISODES)


STUDY = Study(
    "transfer",
    [(vehicle, row) for vehicle in SIX_DOF_MODELS for row in (*_POLICIES, _TRIALS)],
    _measure,
    _stamp,
)
main = STUDY.main


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
    counts = resamplings(tuple(errors.shape[1] for errors in steady_rmses))
    means = [count @ errors.T / errors.shape[1] for count, errors in zip(counts, steady_rmses, strict=True)]
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
        results: results of `_measure`, by policy and case.
    """
    names, cases = list(results), list(next(iter(results.values())))
    steady_rmses = {
        place: [np.array([results[name][case][place]["steady_rmse"] for name in names]) for case in cases]
        for place in (PLANE, SPACE)
    }
    means = {place: pooled(errors) for place, errors in steady_rmses.items()}
    by_case = {place: np.array([e.mean(axis=1) for e in errors]) for place, errors in steady_rmses.items()}
    growth, growth_by_case = means[SPACE] / means[PLANE], by_case[SPACE] / by_case[PLANE]
    taus = concordance(means[PLANE], means[SPACE])
    policies = {
        name: {
            "error_m": {place: float(means[place][0, i]) for place in means},
            "growth": float(growth[0, i]),
            "ci95": _ends(growth[1:, i]),
            "failed": {place: sum(results[name][case][place]["failed"] for case in cases) for place in means},
            "growth_by_case": growth_by_case[:, i].tolist(),
        }
        for i, name in enumerate(names)
    }
    return {
        "episodes": steady_rmses[PLANE][0].shape[1],
        "cases": cases,
        "policies": policies,
        "best": {place: _best(names, means[place]) for place in means},
        "tau": float(taus[0]),
        "tau_ci95": _ends(taus[1:]),
        "tau_by_case": concordance(by_case[PLANE], by_case[SPACE]).tolist(),
    }


def context(_: str = "") -> dict[str, Any]:
    """Return the values of the template of docs/transfer.md."""
    values, vehicles = STUDY.values(), []
    for vehicle in SIX_DOF_MODELS:
        record, rows = summary({policy: values[vehicle, policy] for policy in _POLICIES}), []
        for policy, row in sorted(record["policies"].items(), key=lambda item: item[1]["error_m"][PLANE]):
            errors = (f"{row['error_m'][place]:.3g}" for place in (PLANE, SPACE))
            growth = "{:.2g} ({:.2g} ... {:.2g})".format(row["growth"], *row["ci95"])
            failed = f"{row['failed'][PLANE]} / {row['failed'][SPACE]}"
            rows.append([f"`{policy}`", *errors, growth, failed, *(f"{x:.2g}" for x in row["growth_by_case"])])
        tau = f"{record['tau']:.2f} ({_between(record['tau_ci95'])})"
        vehicles.append({
            "name": vehicle,
            "verdict": verdict(record),
            "cases": record["cases"],
            "policies": rows,
            "ranks": ["tau", *(f"{x:.2f}" for x in record["tau_by_case"]), tau],
            "trials": _trials(values[vehicle, _TRIALS]),
        })  # fmt: skip
    return {"vehicles": vehicles, "tau": f"{TAU:g}", "growth": f"{GROWTH:g}"}


def _between(interval: Sequence[float]) -> str:
    low, high = interval
    return f"{low:.2f} ... {high:.2f}"


def _trials(record: Mapping[str, Any]) -> str:
    """Return a sentence that compares the steady motion in both simulators."""
    speeds, diameters = ([r[SPACE] / r[PLANE] for r in record[kind]] for kind in ("straight", "turns"))
    return (
        f"Under the same surge force the steady speed in 6-DOF is {min(speeds):.2f} to {max(speeds):.2f} times that in "
        f"the plane. Under the same yaw torque the turning diameter is {min(diameters):.2f} to {max(diameters):.2f} "
        "times as large."
    )


def _smallest(names: Sequence[str]) -> str:
    """Return which policy has the smallest error, and which ones do not differ significantly from it."""
    first, *level = (f"`{name}`" for name in names)
    return f"{first} has the smallest error" + (f", level with {', '.join(level)}" if level else "")


def verdict(record: Mapping[str, Any]) -> str:
    """Return sentences that compare ranks and errors in both simulators."""
    policies = record["policies"]
    (least, best), *_, (most, worst) = sorted((row["growth"], name) for name, row in policies.items())
    grown = sum(row["growth"] > GROWTH for row in policies.values())
    failed = {place: sum(row["failed"][place] for row in policies.values()) for place in (PLANE, SPACE)}
    return (
        f"Kendall's tau is {record['tau']:.2f} ({_between(record['tau_ci95'])}). In the plane "
        f"{_smallest(record['best'][PLANE])}; in 6-DOF {_smallest(record['best'][SPACE])}. The errors in 6-DOF are "
        f"{least:.2f} (`{best}`) to {most:.2f} (`{worst}`) times those in the plane; the ratio of {grown} of "
        f"{len(policies)} policies exceeds {GROWTH:g}. Failures: {failed[SPACE]} of "
        f"{record['episodes'] * len(record['cases']) * len(policies)} episodes in 6-DOF, {failed[PLANE]} in the plane."
    )
