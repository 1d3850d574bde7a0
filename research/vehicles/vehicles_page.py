"""The measured part of docs/vehicle-gains.md: stability and gains on the published vehicles."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
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
from baselines.policies import make_policy
from baselines.similar import SimilarLaw
from baselines.tools.files import read_json
from research import DOCS
from research.vehicles.vehicles import MEASURED_AGENT, NEAR_SEARCHED, SEARCHED_SCENARIO, SIDES, VEHICLES_FILE

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
    assert isinstance(law, Backstepping | SimilarLaw)
    growths = []
    for U, w in motions:
        with suppress(InfeasibleReferenceError):
            loop = linearise(vehicle.vehicle, lambda o: law.forces(o, ARRAYS), U, w)
            growths.append(float(loop.eigenvalues[0].real))
    return max(growths)


def _table(names: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (names, ["---"] * len(names), *rows))


def stability_table() -> str:
    """Return the speeds at which the expert was examined on each vehicle, and the half-life of the slowest error."""
    rows = []
    for c in (PAPER, *map(vehicle_model, vehicle_names())):
        growth, top = worst_growth(c), c.vehicle.speed
        word = f"{math.log(2) / -growth:.3g}" if growth < 0 else "unstable"
        rows.append([f"`{c.name}`", f"{max(_SHARES[0] * top, c.slowest):.2g} ... {top:.3g}", word])
    return _table(["vehicle", "speeds [m/s]", "half-life of the slowest error [s]"], rows)


def scaling_table(record: Mapping[str, Any]) -> str:
    """Return the errors [% of L] with the gains of the paper's vehicle and with gains for the vehicle."""
    names = list(next(iter(record.values()))["policies"])
    rows = [
        [f"`{vehicle}`", *(_change(entry["policies"][name]) for name in names)]
        for vehicle, entry in sorted(record.items(), key=lambda item: item[0] != "paper")
    ]
    return _table(["vehicle", *(f"`{name}`" for name in names)], rows)


def _change(entry: Mapping[str, Any]) -> str:
    before, after = (_percent(entry[key]["error"], entry[key]["failed"]) for key in ("before", "after"))
    return after if before == after else f"{before} → **{after}**"


def _percent(error: float, failed: int) -> str:
    return f"{100 * error:.3g}" + (f" ({failed})" if failed else "")


def search_table(record: Mapping[str, Any]) -> str:
    """Return the ratio of the errors with gains from parameters to those with searched gains, with its interval."""
    rows = [
        [
            f"`{vehicle}`",
            f"`{name}`",
            _percent(found["error"], found["failed"]),
            _percent(found["searched_error"], found["searched_failed"]),
            _ratio(Score(found["ratio"], tuple(found["interval"]))),
        ]
        for vehicle, entry in sorted(record.items(), key=lambda item: item[0] != "paper")
        for name, found in entry.items()
    ]
    return _table(["vehicle", "controller", "from parameters", "searched", "ratio"], rows)


def gains_section() -> str:
    """Return the part of docs/vehicle-gains.md that `research.vehicles.vehicles` measured."""
    record = read_json(DOCS / VEHICLES_FILE)
    stable = (
        "### Stability\n\nThe expert is locally stable on each vehicle in still water, on straight lines and in turns "
        "as fast as those of the presets:"
    )
    parts = (stable, stability_table(), *_scaling(record["scaling"]), *_search(record["search"]), *_agent(record))
    return "\n\n".join(parts)


def _scaling(record: Mapping[str, Any]) -> tuple[str, str]:
    first = next(iter(record.values()))
    errors = [p[key] for e in record.values() for p in e["policies"].values() for key in ("before", "after")]
    widest = max((e["interval"][1] - e["interval"][0]) / 2 / e["error"] for e in errors)
    says = (
        f"### Gains of the paper's vehicle\n\n`{SEARCHED_SCENARIO}`, {first['episodes']} episodes on each of "
        f"{len(record)} vehicles: mean steady-state error in per cent of L, with failures at the error cap, and in "
        "parentheses the number of failures. Left of the arrow the policy has the vehicle model and the gains of the "
        "paper's vehicle, right of it the gains follow the vehicle. 95 % intervals (bootstrap over episodes) reach "
        f"up to {100 * widest:.0f} % of the mean on each side."
    )
    return says, scaling_table(record)


def _search(record: Mapping[str, Any]) -> tuple[str, str]:
    found = [x for name, entry in record.items() if name != "paper" for x in entry.values()]
    near = sum(x["ratio"] <= NEAR_SEARCHED for x in found)
    middle = math.exp(sum(math.log(x["ratio"]) for x in found) / len(found))
    (evaluations, episodes), held_out = found[0]["budget"], found[0]["episodes"]
    within = f"{100 * (NEAR_SEARCHED - 1):.0f} %"
    says = (
        f"### Gains from a search\n\nA search for one vehicle has {evaluations} evaluations of {episodes} episodes in "
        f"all cruise cases and begins at the gains from the parameters. Both then run {held_out} other episodes. In "
        f"{near} of {len(found)} pairs of vehicle and controller the gains from the parameters are within {within} of "
        f"the searched ones. The geometric mean of the ratios is {middle:.2f}. A longer search could find better "
        "gains. Errors are in per cent of L, with failures in parentheses:"
    )
    return says, search_table(record)


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
    return says, _table(names, rows)


def _ratio(value: Score) -> str:
    return f"{value.mean:.2f} ({value.ci95[0]:.2f} ... {value.ci95[1]:.2f})"
