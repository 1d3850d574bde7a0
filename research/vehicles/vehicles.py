"""What gains from the vehicle's parameters are worth: `python -m research vehicle-gains`, docs/vehicle-gains.md.

`scaling` compares policies that are made for a vehicle in its own units with policies that have the vehicle model and
the gains of the paper's vehicle. `search` compares the gains from the parameters with those of a search for the
vehicle, on episodes that the search has not seen. `agent` runs an agent and predictive control with either gains.
Errors are mean steady-state errors, capped as in the score, as a share of the vehicle's length scale.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from scipy import stats
from tyro.conf import Positional, UseAppendAction, arg

from auv_gym.physics.namespaces import Array
from auv_gym.physics.units import Units
from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.vehicles import PAPER, VehicleModel, vehicle_names
from auv_gym.task.policy import Policy
from baselines.control import POLICIES, make_controller
from baselines.evaluation.metrics import RESAMPLES
from baselines.evaluation.rollout import rollout
from baselines.evaluation.runner import drawn
from baselines.evaluation.score import ERROR_CAPS, RIVAL, capped, count_failures
from baselines.gains.loading import load_gains
from baselines.policies import make_policy
from baselines.tools.command_line import DONE, UsageError, parse
from baselines.tools.files import json_text, read_json, write_atomically
from baselines.tuning.command import known_vehicle_model
from baselines.tuning.objective import TuningEpisodes
from baselines.tuning.search import VALIDATION_SEED, Budget, tune
from baselines.tuning.tunables import TUNABLES
from research import DOCS

PROGRAM = "python -m research vehicle-gains"
VEHICLES_FILE = "vehicles.json"  # of what was measured, in docs/
SEARCHED_SCENARIO = "cruise-storm"  # that `scaling` runs
_SPEED_RANGE = "cruise"  # that `search` tunes for; vehicles with fins have no other
_SCALED = ("integral-normalised", "los-pid", "ekf", "nmpc")
"""Policies that `scaling` compares, if none are named."""
SEARCHED = ("backstepping-tuned", "los-pid", "lqi", "ekf", "nmpc")
"""Controllers whose gains `search` searches, if none are named."""
MEASURED_AGENT = "helm-any"  # the agent that `agent` runs
SIDES = ("parameters", "searched", MEASURED_AGENT)
"""The compared policies: predictive control with gains from the parameters and with searched ones, and the agent."""
NEAR_SEARCHED = 1.2
"""How many times the error of searched gains that of gains from parameters may be, to be called near."""


@dataclass(frozen=True)
class Options:
    """Measure what gains from a vehicle's parameters are worth, and keep it beside what has been measured before.

    Exit status: 0 done, 2 wrong usage.
    """

    what: Annotated[Positional[Literal["scaling", "search", "agent"]], arg(metavar="scaling|search|agent")]
    """Against the gains of the paper's vehicle, or against a search for the vehicle; or an agent against what a search
    found for nmpc."""
    vehicle: UseAppendAction[tuple[str, ...]] = ()
    """A vehicle's name; may be given again. None: all published vehicles."""
    policy: UseAppendAction[tuple[str, ...]] = ()
    """A controller's name; may be given again."""
    held_out: int = 64
    """Episodes on which is compared; of a search a multiple of 8."""
    evaluations: int = 108
    """How often episodes are run to find gains."""
    episodes: int = 16
    """Episodes of each such evaluation, a multiple of 8."""
    out: Path = DOCS / VEHICLES_FILE
    """File for what is found."""


def scaling(vehicle_model: VehicleModel, names: Sequence[str], episodes: int) -> dict[str, Any]:
    """Return the errors of each policy in the storm, given the vehicle model only (before) and made for it (after)."""
    scenario = changed(PRESETS[SEARCHED_SCENARIO], None if vehicle_model == PAPER else vehicle_model)
    cell, length = drawn(scenario, episodes, VALIDATION_SEED), Units.of(vehicle_model.vehicle).length
    cap = ERROR_CAPS[_SPEED_RANGE] * length

    def done(make: Callable[[str, Vehicle], Policy], name: str) -> dict[str, float]:
        measures = rollout(make(name, vehicle_model.vehicle), scenario, cell.episodes).measures
        steady_rmse = capped(measures, cap)
        spread = stats.bootstrap(
            (steady_rmse,), np.mean, n_resamples=RESAMPLES, rng=np.random.default_rng(0), batch=256
        )
        ends = (end / vehicle_model.vehicle.length for end in spread.confidence_interval)
        return {
            "error": steady_rmse.mean() / vehicle_model.vehicle.length,
            "interval": list(ends),
            "failed": count_failures(measures, cap),
        }

    made = {name: {"after": done(make_policy, name), "before": done(make_controller, name)} for name in names}
    return {"episodes": episodes, "policies": made}


def searched(vehicle_model: VehicleModel, name: str, options: Options) -> dict[str, Any]:
    """Return what a search for the gains of a controller finds, and how the gains from parameters compare."""
    own, tunable = vehicle_model.in_paper_units, TUNABLES[name]
    factory = partial(tunable.factory, vehicle=own.vehicle)
    start, budget = load_gains(name, _SPEED_RANGE, tunable.names), Budget(options.evaluations, options.episodes)

    def courses(episodes: int, seed: int) -> TuningEpisodes:
        return TuningEpisodes(_SPEED_RANGE, episodes, seed, tunable.world, own)

    gains = tune(factory, courses, start, budget) if options.evaluations else dict(start)
    held_out = courses(options.held_out, VALIDATION_SEED)
    (mine, failed, _), (theirs, failed_there, _) = (held_out.steady_rmses(factory(dict(g))) for g in (start, gains))
    return {
        "budget": [options.evaluations, options.episodes],
        "episodes": options.held_out,
        "error": mine.mean() / own.vehicle.length,
        "failed": int(failed.sum()),
        "searched_error": theirs.mean() / own.vehicle.length,
        "searched_failed": int(failed_there.sum()),
        "ratio": mine.mean() / theirs.mean(),
        "interval": ratio_interval(mine, theirs),
        "gains": gains,
    }


def beside(vehicle_model: VehicleModel, gains: Mapping[str, float], episodes: int) -> dict[str, Any]:
    """Return the capped errors [m of the paper's vehicle] of each of `SIDES`, by case, and the failures of each.

    Args:
        vehicle_model: the vehicle.
        gains: what a search for it has found for predictive control.
        episodes: how many, those that searches are compared on.
    """
    own, tunable = vehicle_model.in_paper_units, TUNABLES[RIVAL]
    course = TuningEpisodes(_SPEED_RANGE, episodes, VALIDATION_SEED, tunable.world, own)
    start = load_gains(RIVAL, _SPEED_RANGE, tunable.names)
    controllers = (tunable.factory(dict(each), vehicle=own.vehicle) for each in (start, gains))
    ended = [course.steady_rmses(policy) for policy in (*controllers, make_policy(MEASURED_AGENT, vehicle=own.vehicle))]
    return {
        "steady_rmses": {
            side: {
                case: np.round(steady_rmses, 6).tolist() for case, steady_rmses in course.by_case(steady_rmse).items()
            }
            for side, (steady_rmse, _, _) in zip(SIDES, ended, strict=True)
        },
        "failed": {side: int(failed.sum()) for side, (_, failed, _) in zip(SIDES, ended, strict=True)},
    }


def ratio_interval(mine: Array, theirs: Array) -> list[float]:
    """Return the 95 % interval of the ratio of two means over the same episodes, by bootstrap over episodes."""

    def ratio(a: Array, b: Array, axis: int) -> Array:
        return np.asarray(a.mean(axis=axis) / b.mean(axis=axis))

    found = stats.bootstrap(
        (mine, theirs), ratio, paired=True, vectorized=True, n_resamples=RESAMPLES, batch=256,
        rng=np.random.default_rng(0), method="percentile",
    ).confidence_interval  # fmt: skip
    return [float(found.low), float(found.high)]


def main(arguments: Sequence[str]) -> int:
    """Measure as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    vehicle_models = [known_vehicle_model(name) for name in options.vehicle or (("paper", *vehicle_names()))]
    _check(options)
    record = read_json(options.out) if options.out.exists() else {}
    for vehicle_model in vehicle_models:
        if options.what == "scaling":
            found = {
                "scaling": {vehicle_model.name: scaling(vehicle_model, options.policy or _SCALED, options.held_out)}
            }
            record = _merged(record, found, options.out)
            continue
        if options.what == "agent":
            gains = _found(record, vehicle_model.name)["gains"]
            record = _merged(
                record, {"agent": {vehicle_model.name: beside(vehicle_model, gains, options.held_out)}}, options.out
            )
            continue
        for name in options.policy or SEARCHED:
            record = _merged(
                record, {"search": {vehicle_model.name: {name: searched(vehicle_model, name, options)}}}, options.out
            )
    return DONE


def _found(record: Mapping[str, Any], vehicle: str) -> Any:
    """Return what a search for predictive control on a vehicle has found.

    Raises:
        UsageError: there was none.
    """
    try:
        return record["search"][vehicle][RIVAL]
    except KeyError as error:
        words = f"search --policy {RIVAL} --vehicle {vehicle}"
        raise UsageError(f"no gains of {RIVAL} are searched for {vehicle}: run {PROGRAM} {words} first") from error


def _check(options: Options) -> None:
    """Raise UsageError if an option is wrong."""
    if options.what == "agent" and options.policy:
        raise UsageError(
            f"--policy {options.policy[0]} makes no sense here: {MEASURED_AGENT} runs, and {RIVAL}; leave it out"
        )
    allowed = POLICIES if options.what == "scaling" else TUNABLES
    for name in options.policy:
        if name not in allowed:
            raise UsageError(f"unknown controller {name!r}; allowed are {', '.join(allowed)}")
    turns = 1 if options.what == "scaling" else 8
    for word in ("held_out", "episodes"):
        if (number := getattr(options, word)) < 2 or number % turns:
            raise UsageError(f"--{word} is {number}; it must be a positive multiple of {turns}, 2 at least")
    if options.evaluations < 0 or Budget(options.evaluations, options.episodes).last_seed > VALIDATION_SEED:
        raise UsageError(
            f"--evaluations is {options.evaluations}; it must be at least 0, and less than use up the seeds"
        )


def _merged(old: Any, new: Any, out: Path) -> Any:
    """Return a record with new entries in it, and write it to a file; print what is new."""

    def joined(a: Any, b: Any, depth: int) -> Any:
        if depth == 0 or not isinstance(a, Mapping):
            return b
        return {**a, **{key: joined(a.get(key), value, depth - 1) for key, value in b.items()}}

    record = joined(old, new, 3)
    out.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(out, json_text(record))
    print(json_text(new), flush=True)
    return record
