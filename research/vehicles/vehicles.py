"""Compare gains from the vehicle's parameters with searched gains: `python -m research vehicle-gains`.

`search` compares the gains from the parameters with those of a search for the vehicle, and with the gains of the
paper's vehicle in the vehicle's units, on episodes that the search has not seen. `agent` runs an agent and predictive
control with the first two. Errors are mean steady-state errors, capped as in the score, as a share of the vehicle's
length scale. docs/vehicle-gains.md shows the results.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from tyro.conf import Positional, UseAppendAction, arg

from auv_gym.scenarios.vehicles import VehicleModel, vehicle_names
from baselines.evaluation.score import RIVAL, relative_error
from baselines.gains.loading import adapted_gains, load_gains
from baselines.policies import make_policy
from baselines.tools.command_line import DONE, UsageError, check_words, parse
from baselines.tools.files import json_text, read_json, write_atomically
from baselines.tuning.command import known_vehicle_model
from baselines.tuning.objective import TuningEpisodes
from baselines.tuning.search import VALIDATION_SEED, Budget, tune
from baselines.tuning.tunables import TUNABLES
from research import DATA

PROGRAM = "python -m research vehicle-gains"
VEHICLES_FILE = DATA / "vehicle_gains.json"  # record of the results
_SPEED_RANGE = "cruise"  # that `search` tunes for; vehicles with fins have no other
SEARCHED = ("backstepping-tuned", "los-pid", "lqi", "ekf", "nmpc")
"""Controllers whose gains `search` searches, if none are named."""
MEASURED_AGENT = "helm-any"  # the agent that `agent` runs
KINDS = ("units", "parameters", "searched")
"""Gains: those of the paper's vehicle in the vehicle's units, those adapted to its ratios too, and searched ones."""
SIDES = ("parameters", "searched", MEASURED_AGENT)
"""The compared policies: predictive control with gains from the parameters and with searched ones, and the agent."""
NEAR_SEARCHED = 1.2
"""Largest error of gains from parameters over that of searched gains that counts as near."""


@dataclass(frozen=True)
class Options:
    """Compare gains from a vehicle's parameters with searched gains, and add the results to the file.

    Exit status: 0 done, 2 wrong usage.
    """

    what: Annotated[Positional[Literal["search", "agent"]], arg(metavar="search|agent")]
    """search: gains from parameters and from a search. agent: an agent and nmpc with the gains of a search."""
    vehicle: UseAppendAction[tuple[str, ...]] = ()
    """A vehicle's name; may be given again. None: all published vehicles."""
    policy: UseAppendAction[tuple[str, ...]] = ()
    """A controller's name; may be given again."""
    held_out: int = 128
    """Number of episodes of the comparison, a multiple of 8."""
    evaluations: int = 60
    """Number of evaluations of a search."""
    episodes: int = 16
    """Number of episodes of an evaluation, a multiple of 8."""
    out: Path = VEHICLES_FILE
    """File for the results."""


def searched(vehicle_model: VehicleModel, name: str, options: Options) -> dict[str, Any]:
    """Return the result of a search for the gains of a controller, and the errors with gains from parameters."""
    own, tunable = vehicle_model.in_paper_units, TUNABLES[name]
    factory = partial(tunable.factory, vehicle=own.vehicle)
    plain, start = from_parameters(name, own)
    budget = Budget(options.evaluations, options.episodes)

    def courses(episodes: int, seed: int) -> TuningEpisodes:
        return TuningEpisodes(_SPEED_RANGE, episodes, seed, tunable.world, own)

    gains = tune(factory, courses, start, budget) if options.evaluations else dict(start)
    held_out = courses(options.held_out, VALIDATION_SEED)
    ended = [held_out.steady_rmses(factory(dict(each))) for each in (plain, start, gains)]
    _, mine, theirs = (steady_rmse for steady_rmse, _, _ in ended)
    ratio = relative_error([theirs], [mine])
    return {
        "budget": [options.evaluations, options.episodes],
        "episodes": options.held_out,
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


def beside(vehicle_model: VehicleModel, gains: Mapping[str, float], episodes: int) -> dict[str, Any]:
    """Return the capped errors [m of the paper's vehicle] of each of `SIDES`, by case, and the failures of each.

    Args:
        vehicle_model: the vehicle.
        gains: those of a search for predictive control.
        episodes: number of episodes, those of the comparison of searches.
    """
    own, tunable = vehicle_model.in_paper_units, TUNABLES[RIVAL]
    course = TuningEpisodes(_SPEED_RANGE, episodes, VALIDATION_SEED, tunable.world, own)
    controllers = (tunable.factory(dict(g), vehicle=own.vehicle) for g in (from_parameters(RIVAL, own)[1], gains))
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


def main(arguments: Sequence[str]) -> int:
    """Run the comparison and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options = parse(Options, arguments, PROGRAM)
    vehicle_models = [known_vehicle_model(name) for name in options.vehicle or vehicle_names()]
    _check(options)
    record = read_json(options.out) if options.out.exists() else {}
    for vehicle_model in vehicle_models:
        if options.what == "agent":
            gains = _found(record, vehicle_model.name)["gains"]
            record.setdefault("agent", {})[vehicle_model.name] = both = beside(vehicle_model, gains, options.held_out)
            print(vehicle_model.name, "failures", both["failed"], flush=True)
            write_atomically(options.out, json_text(record))
            continue
        for name in options.policy or SEARCHED:
            found = record.setdefault("search", {}).setdefault(vehicle_model.name, {})
            found[name] = searched(vehicle_model, name, options)
            print(vehicle_model.name, name, json_text(found[name]), flush=True)
            write_atomically(options.out, json_text(record))
    return DONE


def _found(record: Mapping[str, Any], vehicle: str) -> Any:
    """Return the recorded result of a search for predictive control on a vehicle.

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
            f"--policy is for `search` only, since `agent` runs {MEASURED_AGENT} and {RIVAL}; leave it out"
        )
    check_words("controller", options.policy, TUNABLES)
    for word in ("held_out", "episodes"):
        if (number := getattr(options, word)) < 1 or number % 8:
            raise UsageError(f"--{word} is {number}; it must be a positive multiple of 8")
    if options.evaluations < 0 or Budget(options.evaluations, options.episodes).last_seed > VALIDATION_SEED:
        raise UsageError(
            f"--evaluations is {options.evaluations}; it must be at least 0, and not exceed the seeds for tuning"
        )
