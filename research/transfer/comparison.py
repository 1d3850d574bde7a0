"""Run the same policies in the plane and in six degrees of freedom, and compare: `python -m research transfer`.

Each row is a policy on a vehicle; the page compares the growth of errors and the ranks of the policies. Rows in space
compare the vehicle with five degrees of freedom with that of six.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.presets import as_scenario
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.policy import preview_of
from baselines.evaluation.cells import Cell, drawn
from baselines.evaluation.fingerprints import code_fingerprint
from baselines.evaluation.metrics import resamplings
from baselines.evaluation.plants import moved_by
from baselines.evaluation.rollout import EpisodeLog, beginning, play
from baselines.evaluation.score import cap_of, capped, count_failures
from baselines.policies import make_policy
from research.seeds import TRANSFER
from research.study import Study, stamp
from research.transfer.remus100 import FIN_LAG, SpaceRemus100
from research.transfer.simulators import IN_SPACE, SIX_DOF_MODELS, SixDofSimulator
from research.transfer.six_dof import SpatialMotion
from research.transfer.trials import steady_motion

PLANE = "plane"  # the simulator with three degrees of freedom
SPACE = "space"  # the simulator with six degrees of freedom
FIVE, SIX = "5-DOF", "6-DOF"  # simulators of motion in space
QUICK = "6-DOF, quick propeller"  # with the lag of the fins, as the lag of 5-DOF is that of all actuators


class Part(NamedTuple):
    """A comparison of simulators; its cases have the same disturbances in all, but other lags of actuators."""

    policies: tuple[str, ...]
    cases: tuple[str, ...]
    simulators: Mapping[str, Mapping[str, Any] | None]  # models of `SixDofSimulator` by name; None: that of the project


_LAWS = ("backstepping", "backstepping-normalised", "los-pid", "lqi")  # in the plane and in space
_IN_PLANE = "cruise"  # the only speed range of vehicles with fins
_IN_SPACE = "space"
_PARTS = {
    _IN_PLANE: Part(
        (*_LAWS[:2], "integral-normalised", "ilos", *_LAWS[2:], "ekf", "nmpc", "helm", "helm-any"),
        ("calm", "noise", "current", "waves", "mismatch", "storm"),
        {PLANE: None, SPACE: SIX_DOF_MODELS},
    ),
    _IN_SPACE: Part(
        (*_LAWS, "ekf", "nmpc", "helm-3d"),
        ("calm", "current", "waves", "storm"),
        {FIVE: None, SIX: IN_SPACE, QUICK: {"remus100": SpaceRemus100(propeller_lag=FIN_LAG)}},
    ),
}
"""The comparisons by the speed range of their scenarios."""
_EPISODES = 64  # of each case
_TRIALS = "trials"  # the row of a vehicle with its steady motion in both simulators
GROWTH = 1.5  # criterion: largest ratio of the errors
TAU = 0.8  # criterion: smallest rank correlation


def _measure(vehicle: str, policy: str, speed_range: str = _IN_PLANE, quick: bool = False) -> dict[str, Any]:
    """Return capped steady-state errors [m] and failures of a policy, by case and simulator, or the steady motion.

    In space it returns the largest roll [deg] in the steady part of each episode too.
    """
    if policy == _TRIALS:
        return steady_motion(vehicle)
    part = _PARTS[speed_range]
    n = 2 if quick else _EPISODES
    cells = transfer_cells(vehicle, n, speed_range)
    scenario, count = cells[0].scenario, n * len(cells)
    made = make_policy(policy, scenario.bare)
    rows: dict[str, dict[str, Any]] = {case: {} for case in part.cases}
    for place, models in part.simulators.items():
        space: Any = models and SixDofSimulator(vehicle, count, models)
        simulator: Any = space and moved_by(lambda _, space=space: space)  # type: ignore[misc]
        log, roll = EpisodeLog(scenario.steps, count, len(scenario.parts.model.channels)), np.zeros(count)
        begun = beginning([(cell.scenario, cell.episodes) for cell in cells], preview_of(made), simulator=simulator)
        for k, moment in enumerate(play(made, begun, scenario.steps)):
            log.add(k, moment)
            if space and k >= scenario.steps // 3:
                roll = np.where(log.running, np.fmax(roll, np.abs(SpatialMotion(*space.rows[:12]).phi)), roll)
        measures = log.measures(scenario)
        for i, (case, cell) in enumerate(zip(part.cases, cells, strict=True)):
            own = slice(i * n, (i + 1) * n)
            of_case, cap = measures[own], cap_of(cell.scenario)
            errors = [float(f"{x:.6g}") for x in capped(of_case, cap)]
            rows[case][place] = {"steady_rmse": errors, "failed": count_failures(of_case, cap)}
            if place == SIX:
                rows[case][place]["roll_deg"] = [float(f"{x:.3g}") for x in np.degrees(roll[own])]
    return rows


def _scenarios(vehicle: str, speed_range: str) -> list[Scenario]:
    return [as_scenario(f"{speed_range}-{case}@{vehicle}") for case in _PARTS[speed_range].cases]


def transfer_cells(vehicle: str, episodes: int, speed_range: str = _IN_PLANE) -> list[Cell]:
    """Return the cell of each case, all with the largest number of integration steps that a case needs."""
    scenarios = _scenarios(vehicle, speed_range)
    substeps = max(scenario.substeps for scenario in scenarios)
    return [drawn(replace(scenario, substeps=substeps), episodes, TRANSFER.first) for scenario in scenarios]


def _stamp(vehicle: str, policy: str, speed_range: str = _IN_PLANE) -> str:
    code = code_fingerprint(Path(__file__).parent, "evaluation/plants.py")
    if policy == _TRIALS:
        return code
    return stamp(policy, _scenarios(vehicle, speed_range), code, _EPISODES)


STUDY = Study(
    "transfer",
    [
        *((vehicle, row) for vehicle in SIX_DOF_MODELS for row in (*_PARTS[_IN_PLANE].policies, _TRIALS)),
        *((vehicle, policy, _IN_SPACE) for vehicle in IN_SPACE for policy in _PARTS[_IN_SPACE].policies),
    ],
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


def summary(
    results: Mapping[str, Mapping[str, Mapping[str, Any]]], places: tuple[str, str] = (PLANE, SPACE)
) -> dict[str, Any]:
    """Return the summary of a vehicle's results: errors and growth by policy, and rank correlations.

    Intervals are the 2.5th and 97.5th percentile over resampled episodes, the same ones in both simulators and for all
    policies.

    Args:
        results: results of `_measure`, by policy and case.
        places: names of the simulators.
    """
    names, cases, (plain, full) = list(results), list(next(iter(results.values()))), places
    steady_rmses = {
        place: [np.array([results[name][case][place]["steady_rmse"] for name in names]) for case in cases]
        for place in places
    }
    means = {place: pooled(errors) for place, errors in steady_rmses.items()}
    by_case = {place: np.array([e.mean(axis=1) for e in errors]) for place, errors in steady_rmses.items()}
    growth, growth_by_case = means[full] / means[plain], by_case[full] / by_case[plain]
    taus = concordance(means[plain], means[full])
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
        "episodes": steady_rmses[plain][0].shape[1],
        "cases": cases,
        "policies": policies,
        "best": {place: _best(names, means[place]) for place in means},
        "tau": float(taus[0]),
        "tau_ci95": _ends(taus[1:]),
        "tau_by_case": concordance(by_case[plain], by_case[full]).tolist(),
    }


def context(_: str = "") -> dict[str, Any]:
    """Return the values of the template of docs/transfer.md."""
    values, vehicles = STUDY.values(), []
    for vehicle in SIX_DOF_MODELS:
        record, rows = summary({policy: values[vehicle, policy] for policy in _PARTS[_IN_PLANE].policies}), []
        for policy, row in sorted(record["policies"].items(), key=lambda item: item[1]["error_m"][PLANE]):
            errors = (f"{row['error_m'][place]:.3g}" for place in (PLANE, SPACE))
            ratios = (f"{x:.2g}" for x in row["growth_by_case"])
            rows.append([f"`{policy}`", *errors, *_compared(row), *ratios])
        vehicles.append({
            "name": vehicle,
            "verdict": verdict(record),
            "cases": record["cases"],
            "policies": rows,
            "ranks": _ranks(record),
            "trials": _trials(values[vehicle, _TRIALS]),
        })  # fmt: skip
    return {"vehicles": vehicles, "tau": f"{TAU:g}", "growth": f"{GROWTH:g}", "in_space": space_section("remus100")}


def space_summary(vehicle: str) -> dict[str, Any]:
    """Return the `summary` in space, with medians of the errors, and median and largest roll [deg] of each policy."""
    values, part = STUDY.values(), _PARTS[_IN_SPACE]
    results = {policy: values[vehicle, policy, _IN_SPACE] for policy in part.policies}
    record, quick = (summary(results, (FIVE, place)) for place in (SIX, QUICK))
    record["quick"] = quick
    for policy, row in record["policies"].items():
        own = results[policy]
        rolls = np.concatenate([own[case][SIX]["roll_deg"] for case in part.cases])
        errors = np.array([[own[case][place]["steady_rmse"] for case in part.cases] for place in (FIVE, SIX)])
        row["roll_deg"] = float(np.median(rolls)), float(rolls.max())
        row["median_m"] = dict(zip((FIVE, SIX), np.median(errors, axis=(1, 2)).tolist(), strict=True))
        row["median_growth_by_case"] = np.divide(*np.median(errors, axis=2)[::-1]).tolist()
    return record


def space_section(vehicle: str) -> dict[str, Any]:
    """Return the values of the template for the comparison in space."""
    record, rows = space_summary(vehicle), []
    for policy, row in sorted(record["policies"].items(), key=lambda item: item[1]["error_m"][FIVE]):
        errors = (f"{row[kind][place]:.3g}" for kind in ("median_m", "error_m") for place in (FIVE, SIX))
        roll, ratios = "{:.2g} / {:.2g}".format(*row["roll_deg"]), (f"{x:.2g}" for x in row["median_growth_by_case"])
        rows.append([f"`{policy}`", *errors, *_compared(row), roll, *ratios])
    rolls = [row["roll_deg"][1] for row in record["policies"].values()]
    verdict = (
        f"With 5-DOF {_smallest(record['best'][FIVE])}; with 6-DOF {_smallest(record['best'][SIX])}. "
        f"{_ratios(record)} The largest roll is {max(rolls):.1f} degrees."
    )
    return {
        "verdict": verdict,
        "quick": _ratios(record["quick"]),
        "lag": f"{FIN_LAG:g} s",
        "cases": record["cases"],
        "rows": rows,
        "ranks": _ranks(record),
    }


def _ratios(record: Mapping[str, Any]) -> str:
    """Return sentences with the ratios of mean errors and the rank correlation in space."""
    growths = [row["growth"] for row in record["policies"].values()]
    return (
        f"The mean errors with 6-DOF are {min(growths):.2f} to {max(growths):.2f} times those with 5-DOF. Kendall's "
        f"tau is {record['tau']:.2f} ({_between(record['tau_ci95'])})."
    )


def _compared(row: Mapping[str, Any]) -> tuple[str, str]:
    """Return the ratio of the errors with its interval, and the failures in both simulators."""
    failures = " / ".join(map(str, row["failed"].values()))
    return "{:.2g} ({:.2g} ... {:.2g})".format(row["growth"], *row["ci95"]), failures


def _ranks(record: Mapping[str, Any]) -> list[str]:
    """Return the rank correlations by case, and over all of them with its interval."""
    of_all = f"{record['tau']:.2f} ({_between(record['tau_ci95'])})"
    return ["tau", *(f"{x:.2f}" for x in record["tau_by_case"]), of_all]


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
