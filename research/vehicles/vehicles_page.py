"""The measured part of docs/vehicle-gains.md: stability and gains on the published vehicles."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import numpy as np

from auv_gym.physics.namespaces import ARRAYS
from auv_gym.physics.units import Units
from auv_gym.planning.feasibility import InfeasibleReferenceError
from auv_gym.scenarios.vehicles import PAPER, VehicleModel, vehicle_model, vehicle_names
from baselines.control.backstepping import Backstepping
from baselines.control.linearisation import linearise
from baselines.evaluation.score import RIVAL, Score, relative_error
from baselines.gains.loading import EXPONENTS
from baselines.policies import make_policy
from baselines.scaling import ScaledLaw
from baselines.tools.files import read_json
from research.pages import table
from research.vehicles.vehicles import KINDS, MEASURED_AGENT, NEAR_SEARCHED, SIDES, VEHICLES_FILE

_SHARES = (1 / 30, 1 / 15, 0.1, 0.2, 0.25, 0.3, 1 / 3, 0.5, 2 / 3, 5 / 6, 1.0)
"""Path speeds at which the expert is examined, as shares of the design speed."""
_SLOW = 1 / 3
"""Share of the design speed below which turns are those of slow motion, a third as fast."""
LOBES = 1.75  # times as fast as a path's turn rate that the lobes of a figure-eight turn at most


def worst_growth(vehicle: VehicleModel, policy: str = "backstepping") -> float:
    """Return the largest real part [1/s] of the eigenvalues of a law on a vehicle: negative if it is locally stable.

    The motions are straight lines and turns as fast as those of the presets, at speeds from the slowest at which the
    fins steer up to the design speed. Turns that the vehicle cannot follow are left out.
    """
    law, top = make_policy(policy, vehicle=vehicle.vehicle), vehicle.vehicle.speed
    time = Units.of(vehicle.vehicle).time
    turn_rate = LOBES * (0.12 / time if vehicle.turn_rate is None else vehicle.turn_rate)
    motions = [
        (share * top, turn * (turn_rate if share > _SLOW else _SLOW * turn_rate))
        for share in _SHARES
        for turn in (0.0, 0.5, 1.0)
        if share * top >= vehicle.slowest
    ]
    assert isinstance(law, Backstepping | ScaledLaw)
    growths = []
    for U, w in motions:
        with suppress(InfeasibleReferenceError):
            loop = linearise(vehicle.vehicle, lambda o: law.forces(o, ARRAYS), U, w)
            growths.append(float(loop.eigenvalues[0].real))
    return max(growths)


def stability_table() -> str:
    """Return the speeds at which the expert was examined on each vehicle, and the half-life of the slowest error."""
    rows = []
    for c in (PAPER, *map(vehicle_model, vehicle_names())):
        growth, top = worst_growth(c), c.vehicle.speed
        word = f"{math.log(2) / -growth:.3g}" if growth < 0 else "unstable"
        rows.append([f"`{c.name}`", f"{max(_SHARES[0] * top, c.slowest):.2g} ... {top:.3g}", word])
    return table(["vehicle", "speeds [m/s]", "half-life of the slowest error [s]"], rows, right=False)


def _percent(error: float, failed: int) -> str:
    return f"{100 * error:.3g}" + (f" ({failed})" if failed else "")


def search_table(record: Mapping[str, Any]) -> str:
    """Return the ratio of the errors with gains from parameters to those with searched gains, with its interval."""
    rows = [
        [
            f"`{vehicle}`",
            f"`{name}`",
            *(_percent(found["error"][kind], found["failed"][kind]) for kind in KINDS),
            _ratio(Score(found["ratio"], tuple(found["interval"]))),
        ]
        for vehicle, entry in record.items()
        for name, found in entry.items()
    ]
    heads = ["vehicle", "controller", "scaled by units", "from parameters", "searched", "ratio"]
    return table(heads, rows, right=False)


def exponents_section() -> str:
    """Return how the errors on random vehicles change with the exponents of gains, as a table in Markdown."""
    rows = []
    for name, entry in read_json(EXPONENTS).items():
        check = entry["check"]
        ratios = f"{check['ratio']:.2f}", f"{100 * check['worse']:.0f} %", f"{check['largest']:.1f}"
        rows.append([f"`{name}`", *ratios])
    return table(["controller", "geometric mean", "share of vehicles above 1.02", "largest"], rows, right=False)


def gains_section() -> str:
    """Return the part of docs/vehicle-gains.md that `research.vehicles.vehicles` measured."""
    record = read_json(VEHICLES_FILE)
    stable = (
        "### Stability\n\nThe expert is locally stable on each vehicle in still water, on straight lines and in turns "
        "as fast as those of the presets:"
    )
    parts = (stable, stability_table(), *_search(record["search"]), *_agent(record))
    return "\n\n".join(parts)


def _search(record: Mapping[str, Any]) -> tuple[str, str]:
    found = [x for entry in record.values() for x in entry.values()]
    near, near_units = (sum(_over_searched(x, kind) <= NEAR_SEARCHED for x in found) for kind in KINDS[1::-1])
    mean, mean_units = (statistics.geometric_mean([_over_searched(x, kind) for x in found]) for kind in KINDS[1::-1])
    (evaluations, episodes), held_out = found[0]["budget"], found[0]["episodes"]
    within = f"{100 * (NEAR_SEARCHED - 1):.0f} %"
    says = (
        f"### Gains from a search\n\nA search for one vehicle has {evaluations} evaluations of {episodes} episodes in "
        f"all cruise cases and begins at the gains from the parameters. All run {held_out} other episodes. In {near} "
        f"of {len(found)} pairs of vehicle and controller the gains from the parameters are within {within} of the "
        f"searched ones. The geometric mean of the ratios is {mean:.2f}. With the gains of the paper's vehicle in the "
        f"vehicle's units these are {near_units} pairs and {mean_units:.2f}. A longer search could find better gains. "
        "Errors are in per cent of L, with failures in parentheses:"
    )
    return says, search_table(record)


def _over_searched(found: Mapping[str, Any], kind: str) -> float:
    """Return the ratio of the error with gains of a kind to that with searched gains."""
    return float(found["error"][kind] / found["error"][KINDS[-1]])


def _agent(record: Mapping[str, Any]) -> tuple[str, str]:
    """Return how an agent compares with predictive control whose gains were searched for each vehicle."""
    found, cells = record["agent"], {side: list[Any]() for side in SIDES}
    rows = []
    for vehicle, entry in found.items():
        own = {
            side: [np.array(steady_rmses) for steady_rmses in entry["steady_rmses"][side].values()] for side in SIDES
        }
        percent = [_percent(float(np.mean(own[side])) / PAPER.vehicle.length, entry["failed"][side]) for side in SIDES]
        ratios = [_ratio(relative_error(own[side], own[MEASURED_AGENT])) for side in SIDES[:2]]
        rows.append([f"`{vehicle}`", *percent, *ratios])
        for side in SIDES:
            cells[side] += own[side]
    over = [_ratio(relative_error(cells[side], cells[MEASURED_AGENT])) for side in SIDES[:2]]
    budgets = {tuple(record["search"][vehicle][RIVAL]["budget"]) for vehicle in found}
    ((evaluations, episodes),) = budgets
    (held_out,) = {sum(map(len, entry["steady_rmses"][MEASURED_AGENT].values())) for entry in found.values()}
    says = (
        f"### `{MEASURED_AGENT}` and `{RIVAL}` with searched gains\n\nThe gains of `{RIVAL}` are searched for each "
        f"vehicle ({evaluations} evaluations of {episodes} episodes). All run the same {held_out} held-out episodes in "
        "all cruise cases. The ratio is the geometric mean over cases of the ratios of mean errors. Over all "
        f"{len(found)} vehicles the error of the agent is {over[0]} times that of `{RIVAL}` with gains from the "
        f"parameters, and {over[1]} times that with searched gains. The agent has one set of weights for all vehicles."
    )
    names = [
        "vehicle",
        f"`{RIVAL}`, from parameters",
        "searched",
        f"`{MEASURED_AGENT}`",
        "ratio to parameters",
        "ratio to searched",
    ]
    return says, table(names, rows, right=False)


def _ratio(value: Score) -> str:
    return f"{value.mean:.2f} ({value.ci95[0]:.2f} ... {value.ci95[1]:.2f})"
