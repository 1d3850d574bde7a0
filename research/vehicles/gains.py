"""Compare gains from the vehicle's parameters with searched gains: `python -m research vehicle-gains`.

For a controller the row of a vehicle compares the gains from the parameters with those of a search for the vehicle, and
with the gains of the paper's vehicle in the vehicle's units, on episodes that the search has not seen. For an agent it
compares the agent with predictive control with the first two. Errors are capped as in the score.
"""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Mapping
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np

from auv_gym.physics.namespaces import ARRAYS
from auv_gym.physics.units import Units
from auv_gym.planning.feasibility import InfeasibleReferenceError
from auv_gym.scenarios.names import SPEED_RANGES
from auv_gym.scenarios.vehicles import PAPER, PAPER_LAG, VehicleModel, vehicle_model, vehicle_names
from baselines.control.backstepping import Backstepping
from baselines.evaluation.score import RIVAL, Score, relative_error
from baselines.gains.loading import adapted_gains, load_gains, recorded_gains
from baselines.policies import make_policy
from baselines.scaling import ScaledLaw
from baselines.tuning.objective import TUNABLES, TuningEpisodes, tuning_scenarios
from baselines.tuning.search import VALIDATION_SEED, Budget, tune
from research.pages import table, with_interval
from research.paper.stability import loop_eigenvalues
from research.study import Study, stamp

_SPEED_RANGE = "cruise"  # that is searched for; vehicles with fins have no other
SEARCHED = ("los-pid", "lqi", "ekf")
"""Controllers whose gains are searched for `_VEHICLES`; those of `RIVAL` are searched for all vehicles."""
_VEHICLES = ("otter", "lauv", "remus100")
MEASURED_AGENT = "helm-any"  # the agent of the comparison
KINDS = ("units", "parameters", "searched")
"""Gains: those of the paper's vehicle in the vehicle's units, those adapted to its ratios too, and searched ones."""
SIDES = ("parameters", "searched", MEASURED_AGENT)
"""The compared policies: predictive control with gains from the parameters and with searched ones, and the agent."""
NEAR_SEARCHED = 1.2
"""Largest error of gains from parameters over that of searched gains that counts as near."""
_BUDGET, _HELD_OUT = Budget(60, 16), 128  # of a search, and number of episodes of the comparison
_SHARES = (1 / 30, 1 / 15, 0.1, 0.2, 0.25, 0.3, 1 / 3, 0.5, 2 / 3, 5 / 6, 1.0)
"""Path speeds at which the expert is examined, as shares of the design speed."""
_SLOW = 1 / 3
"""Share of the design speed below which turns are those of slow motion, a third as fast."""
LOBES = 1.75  # times as fast as a path's turn rate that the lobes of a figure-eight turn at most


def _measure(vehicle: str, policy: str, quick: bool = False) -> dict[str, Any]:
    """Return the row of a controller or of the agent on a vehicle."""
    own, held_out = vehicle_model(vehicle).in_paper_units, 8 if quick else _HELD_OUT
    if policy == MEASURED_AGENT:
        return beside(own, STUDY.values()[vehicle, RIVAL]["gains"], held_out)
    return searched(own, policy, Budget(1, 8) if quick else _BUDGET, held_out)


def searched(own: VehicleModel, name: str, budget: Budget, held_out: int) -> dict[str, Any]:
    """Return the result of a search for the gains of a controller, and the errors with gains from parameters.

    Args:
        own: the vehicle in the paper's units.
        name: of the controller.
        budget: of the search.
        held_out: number of episodes of the comparison, a multiple of 8.
    """
    tunable = TUNABLES[name]
    factory = partial(tunable.factory, vehicle=own.vehicle)
    plain, adapted = from_parameters(name, own)

    def course(episodes: int, seed: int) -> TuningEpisodes:
        return TuningEpisodes(_SPEED_RANGE, episodes, seed, tunable.world, own)

    gains, comparison = tune(factory, course, adapted, budget), course(held_out, VALIDATION_SEED)
    ended = [comparison.steady_rmses(factory(dict(g))) for g in (plain, adapted, gains)]
    ratio = relative_error([ended[2][0]], [ended[1][0]])
    return {
        "budget": [budget.evaluations, budget.episodes],
        "episodes": held_out,
        "error": {kind: e.mean() / own.vehicle.length for kind, (e, _, _) in zip(KINDS, ended, strict=True)},
        "failed": {kind: int(failed.sum()) for kind, (_, failed, _) in zip(KINDS, ended, strict=True)},
        "ratio": ratio.mean,
        "interval": list(ratio.ci95),
        "gains": gains,
    }


def from_parameters(name: str, own: VehicleModel) -> tuple[dict[str, float], dict[str, float]]:
    """Return a controller's gains for a vehicle in the paper's units: those of the paper's vehicle, and the adapted."""
    names = TUNABLES[name].names
    return load_gains(name, _SPEED_RANGE, names), adapted_gains(name, _SPEED_RANGE, names, own)


def beside(own: VehicleModel, gains: Mapping[str, float], episodes: int) -> dict[str, Any]:
    """Return the capped errors [m of the paper's vehicle] of each of `SIDES`, by case, and the failures of each.

    Args:
        own: the vehicle in the paper's units.
        gains: those of a search for predictive control.
        episodes: number of episodes, those of the comparison of searches.
    """
    tunable, rows = TUNABLES[RIVAL], dict[str, dict[str, list[float]]]()
    course = TuningEpisodes(_SPEED_RANGE, episodes, VALIDATION_SEED, tunable.world, own)
    controllers = (tunable.factory(dict(g), vehicle=own.vehicle) for g in (from_parameters(RIVAL, own)[1], gains))
    policies, failures = (*controllers, make_policy(MEASURED_AGENT, vehicle=own.vehicle)), {}
    for side, policy in zip(SIDES, policies, strict=True):
        steady_rmses, failed, _ = course.steady_rmses(policy)
        rows[side] = {case: np.round(errors, 6).tolist() for case, errors in course.by_case(steady_rmses).items()}
        failures[side] = int(failed.sum())
    return {"steady_rmses": rows, "failed": failures}


def _stamp(vehicle: str, policy: str) -> str:
    world = TUNABLES[RIVAL if policy == MEASURED_AGENT else policy].world
    scenarios = tuning_scenarios(_SPEED_RANGE, world, vehicle_model(vehicle))
    return stamp(policy, scenarios, _BUDGET.evaluations, _BUDGET.episodes, _HELD_OUT)


STUDY = Study(
    "vehicle-gains",
    [(vehicle, policy) for vehicle in _VEHICLES for policy in SEARCHED]
    + [(vehicle, policy) for policy in (RIVAL, MEASURED_AGENT) for vehicle in vehicle_names()],
    _measure,
    _stamp,
)
main = STUDY.main


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
            values = loop_eigenvalues(vehicle.vehicle, lambda o: law.forces(o, ARRAYS), U, w)
            growths.append(float(values[0].real))
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


def exponents_section() -> str:
    """Return how the errors on random vehicles change with the exponents of gains, as a table in Markdown."""
    checks = {name: entry["check"] for name, entry in recorded_gains()["exponents"].items()}
    rows = [
        [f"`{name}`", f"{check['ratio']:.2f}", f"{100 * check['worse']:.0f} %", f"{check['largest']:.1f}"]
        for name, check in checks.items()
    ]
    return table(["controller", "geometric mean", "share of vehicles above 1.02", "largest"], rows, right=False)


def gains_section() -> str:
    """Return the measured part of docs/vehicle-gains.md."""
    stable = (
        "### Stability\n\nThe expert is locally stable on each vehicle in still water, on straight lines and in turns "
        "as fast as those of the presets:"
    )
    values = STUDY.values()
    searches = {row: value for row, value in values.items() if row[1] != MEASURED_AGENT}
    agent = {vehicle: value for (vehicle, policy), value in values.items() if policy == MEASURED_AGENT}
    return "\n\n".join((stable, stability_table(), *_search(searches), *agent_comparison(agent, searches)))


def _search(record: Mapping[tuple[str, ...], Any]) -> tuple[str, str]:
    rows = list(record.values())
    ratios = {kind: [row["error"][kind] / row["error"]["searched"] for row in rows] for kind in KINDS}
    near = {kind: sum(ratio <= NEAR_SEARCHED for ratio in ratios[kind]) for kind in KINDS}
    mean = {kind: statistics.geometric_mean(ratios[kind]) for kind in KINDS}
    (evaluations, episodes), held_out = rows[0]["budget"], rows[0]["episodes"]
    says = (
        f"### Gains from a search\n\nA search for one vehicle has {evaluations} evaluations of {episodes} "
        "cruise episodes, with the objective of [auv-gym tune](policies.md#how-the-gains-are-tuned), and begins at the "
        f"gains from the parameters. All run {held_out} other episodes. In "
        f"{near['parameters']} of {len(rows)} pairs of vehicle and controller the gains from the parameters are within "
        f"{100 * (NEAR_SEARCHED - 1):.0f} % of the searched ones. The geometric mean of the ratios is "
        f"{mean['parameters']:.2f}. With the gains of the paper's vehicle in the vehicle's units these are "
        f"{near['units']} pairs and {mean['units']:.2f}. A longer search could find better gains. Errors are in per "
        "cent of L, with failures in parentheses:"
    )
    heads = ["vehicle", "controller", "scaled by units", "from parameters", "searched", "ratio"]
    lines = [
        [
            *(f"`{word}`" for word in words),
            *(_percent(row["error"][kind], row["failed"][kind]) for kind in KINDS),
            with_interval(Score(row["ratio"], tuple(row["interval"]))),
        ]
        for words, row in sorted(record.items())
    ]
    return says, table(heads, lines, right=False)


def agent_comparison(record: Mapping[str, Any], searches: Mapping[tuple[str, ...], Any]) -> tuple[str, str]:
    """Return how the agent compares with predictive control whose gains were searched for each vehicle."""
    cells, rows = {side: list[Any]() for side in SIDES}, []
    for vehicle, entry in record.items():
        errors = {side: list(map(np.array, entry["steady_rmses"][side].values())) for side in SIDES}
        means = {side: float(np.mean(np.concatenate(errors[side]))) / PAPER.vehicle.length for side in SIDES}
        ratios = [with_interval(relative_error(errors[side], errors[MEASURED_AGENT])) for side in SIDES[:2]]
        rows.append([f"`{vehicle}`", *(_percent(means[side], entry["failed"][side]) for side in SIDES), *ratios])
        for side in SIDES:
            cells[side] += errors[side]
    over = [with_interval(relative_error(cells[side], cells[MEASURED_AGENT])) for side in SIDES[:2]]
    ((evaluations, episodes),) = {tuple(searches[vehicle, RIVAL]["budget"]) for vehicle in record}
    (held_out,) = {sum(map(len, entry["steady_rmses"][MEASURED_AGENT].values())) for entry in record.values()}
    says = (
        f"### `{MEASURED_AGENT}` and `{RIVAL}` with searched gains\n\nThe gains of `{RIVAL}` are searched for each "
        f"vehicle ({evaluations} evaluations of {episodes} episodes). All run the same {held_out} held-out episodes in "
        "all cruise cases. The ratio is the geometric mean over cases of the ratios of mean errors. Over all "
        f"{len(record)} vehicles the error of the agent is {over[0]} times that of `{RIVAL}` with gains from the "
        f"parameters, and {over[1]} times that with searched gains. The agent has one set of weights for all vehicles."
    )
    heads = [
        "vehicle", f"`{RIVAL}`, from parameters", "searched", f"`{MEASURED_AGENT}`", "ratio to parameters",
        "ratio to searched",
    ]  # fmt: skip
    return says, table(heads, rows, right=False)


def published_vehicles() -> str:
    """Return the vehicles with their numbers and the sources of these, for docs/vehicles.md."""
    models = [PAPER, *map(vehicle_model, vehicle_names())]
    sources = [(f"`{m.name}`", m.source, m.left_out, m.assumed) for m in models[1:]]
    heads = (
        "name", "what", "L [m]", "speed [m/s]", "thrust [N]", "yaw moment at that speed [N m]", "lag [s]", "m22/m11",
        "sway drag", "yaw drag", "yaw moment / (m11 U^2)",
    )  # fmt: skip
    rows = []
    for model in models:
        v, act, U = model.vehicle, model.actuators, model.vehicle.speed
        torque = min(act.F_r_max, act.fin * U * U) if act.fin else act.F_r_max
        lag = PAPER_LAG * v.time / PAPER.vehicle.time if model.lag is None else model.lag
        _, sway, yaw = model.drag(U)
        shares = v.m22 / v.m11, sway / v.m22, yaw / v.m33, torque / v.m11 / U**2
        numbers = (f"{number:.3g}" for number in (v.length, U, act.F_u_max, torque, lag, *shares))
        rows.append((f"`{model.name}`", model.about, *numbers))
    numbers_table = table(heads, rows, right=False)
    return f"{numbers_table}\n\n{table(('name', 'source', 'left out', 'assumed'), sources, right=False)}"


def tuned_gains() -> str:
    """Return what each controller's tuned gains gave on the validation episodes, for docs/policies.md."""
    rows = []
    for name, speed_range in itertools.product(TUNABLES, SPEED_RANGES):
        record = recorded_gains()["tuned"][name][speed_range]
        v = record["validation"]
        errors = f"{1e3 * v['error_m']:.3g}", f"{100 * v['failed']:.1f} %"
        gained = f"{100 * (1 - v['cost_m'] / v['start_cost_m']):.1f} %"
        rows.append((f"`{name}`", speed_range, len(record["gains"]), *errors, gained))
    return table(("controller", "speed range", "gains", "error [mm]", "failures", "last search"), rows)
