"""Tune a controller's gains on tuning episodes: `auv-gym tune --help`.

The objective is the mean over the episodes of a speed range of the steady-state RMSE, which is limited to the error cap
in each episode, plus a price of the rate of the command, see `objective.RATE_PRICE`; with --error-only without it.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import Positional, arg

from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.vehicles import PAPER, VehicleModel, as_vehicle, as_vehicle_model
from auv_gym.task.policy import Policy
from baselines.agents.names import PolicyName
from baselines.evaluation.runner import failure
from baselines.gains.loading import adapted_gains, checked_gains, load_gains, recorded_gains, write_gains
from baselines.policies import make_policy
from baselines.space import SPEED_RANGE
from baselines.tools.command_line import DONE, FAILED, UsageError, called, check_words, checked, parse, typed
from baselines.tools.files import read_json, write_atomically
from baselines.tuning.objective import SPACE_TUNABLES, TUNABLES, Tunable, TuningEpisodes, tuning_scenarios
from baselines.tuning.search import (
    EVALUATIONS,
    TUNING_EPISODES,
    VALIDATION_EPISODES,
    VALIDATION_SEED,
    Budget,
    search_record,
)

PROGRAM = "auv-gym tune"


@dataclass(frozen=True)
class Options:
    """Tune the gains of a controller and write them to runs/tune/NAME-SPEED_RANGE@VEHICLE.json, with their provenance.

    The search starts at the entry "start" of the controller in baselines/gains/gains.json, for another vehicle at the
    shipped gains in the units of the vehicle. For a controller of the package the file is a policy, as in
    auv-gym evaluate --policy FILE.json; in Python use make_policy(NAME, vehicle=..., gains=...).
    FILE.py:FACTORY is a controller of your own, whose factory takes its gains as keyword arguments; --start names their
    initial values, and NAME of the result is FILE-FACTORY.
    Exit status: 0 done, 1 the controller failed, 2 wrong usage.

    Example: auv-gym tune los-pid --speed-range slow
    """

    name: Annotated[Positional[str], arg(metavar="NAME")]
    """The controller: integral-normalised, los-pid, lqi, ilos, ekf, nmpc, nmpc-adverse or los-setpoints; or
    FILE.py:FACTORY."""
    speed_range: Annotated[Literal["slow", "cruise", "space"], arg(metavar="slow|cruise|space")] = "cruise"
    """Speed range to tune for, or motion in space."""
    evaluations: int = EVALUATIONS
    """Number of evaluations of the search; 0 only measures the initial gains."""
    episodes: int = TUNING_EPISODES
    """Episodes of each evaluation, a multiple of 32, so that each case has the same number."""
    start: Annotated[Path | None, arg(metavar="FILE")] = None
    """A JSON file of gains by name, at which the search starts; they may stand in its entry "gains"."""
    vehicle: str = PAPER.name
    """A published vehicle by name, or a .toml file."""
    error_only: bool = False
    """Search for the smallest error, without a price of the rate of the command."""
    dry_run: bool = False
    """Print the result; do not write the file."""
    ship: bool = False
    """Write the result to baselines/gains/gains.json instead, in a clone of this repository."""


def main(arguments: Sequence[str]) -> int:
    """Run the command and return its exit status.

    Raises:
        UsageError: an argument is wrong.
    """
    options = parse(Options, arguments, PROGRAM)
    budget = _budget(options)
    tunable, vehicle_model = _tunable(options), known_vehicle_model(options.vehicle)
    in_paper_units, in_space = vehicle_model.in_paper_units, options.speed_range == SPEED_RANGE
    vehicle: Any = in_paper_units.in_space if in_space else in_paper_units.vehicle
    start = checked(partial(_start, options, tunable.names, in_paper_units))
    # refused if the vehicle's fins have no effect at such a low speed
    checked(partial(tuning_scenarios, options.speed_range, tunable.world, vehicle_model))
    name = Path(options.name.replace(".py:", "-")).name
    file = Path("runs/tune") / f"{name}-{options.speed_range}@{Path(options.vehicle).stem}.json"
    if file.exists() and checked(partial(read_json, file)).get("controller") != options.name:
        raise UsageError(f"{file} is the result of another controller of this name; rename one of the two files")
    checked(partial(tunable.factory, dict(start), vehicle=vehicle))

    def draw(episodes: int, seed: int) -> TuningEpisodes:
        priced = not options.error_only
        return TuningEpisodes(options.speed_range, episodes, seed, tunable.world, vehicle_model, priced=priced)

    try:
        record = search_record(tunable, draw, start, budget, vehicle, VALIDATION_EPISODES)
    except Exception as error:  # noqa: BLE001, a policy of the user's can raise anything
        print(f"{called(PROGRAM)}: {failure(error, options.name)}", file=sys.stderr)
        return FAILED
    record["command"] = typed(PROGRAM, arguments)
    print(json.dumps(record, indent=2))
    if options.ship and not options.dry_run:
        tuned = recorded_gains()["tuned"].get(options.name, {})
        write_gains("tuned", options.name, {**tuned, options.speed_range: record})
    elif not options.dry_run:
        write_atomically(file, json.dumps({"controller": options.name, **record}, indent=2) + "\n")
        print(f"written: {file}")
    return DONE


def _tunable(options: Options) -> Tunable:
    """Return what is to be tuned; raise UsageError for a combination of options that is not possible."""
    own = PolicyName.of(options.name).kind == "python"
    if own and options.start is None:
        raise UsageError(f'{options.name} needs --start FILE.json, the initial gains by name, such as {{"k": 1.5}}')
    if own and options.vehicle != PAPER.name:
        raise UsageError(
            f"--vehicle {options.vehicle}: the gains of {options.name} have no known units, so the search is for the "
            "vehicle of the paper only"
        )
    if options.ship and (own or options.vehicle != PAPER.name or options.error_only):
        raise UsageError("--ship is for controllers of the package, the vehicle of the paper and the whole objective")
    known = SPACE_TUNABLES if options.speed_range == SPEED_RANGE else TUNABLES
    return Tunable(partial(_of_file, options.name), ()) if own else known[options.name]


def _of_file(name: str, gains: dict[str, float], vehicle: Any = PAPER_VEHICLE) -> Policy:
    return make_policy(name, vehicle, **gains)


def known_vehicle_model(vehicle: str) -> VehicleModel:
    """Return the vehicle model of a name or file.

    Raises:
        UsageError: the vehicle is unknown, or the file cannot be read.
    """
    vehicle_model = PAPER if vehicle == PAPER.name else checked(partial(as_vehicle_model, vehicle))
    if vehicle_model is None:
        checked(partial(as_vehicle, vehicle))  # an error if it is unknown
        raise UsageError(f"the limits and the lag of {vehicle} are not known; take {PAPER.name}, or a .toml file")
    return vehicle_model


def _budget(options: Options) -> Budget:
    """Return the budget; raise UsageError if the controller or a number is wrong."""
    if PolicyName.of(options.name).kind != "python":
        known = SPACE_TUNABLES if options.speed_range == SPEED_RANGE else TUNABLES
        check_words("controller", [options.name], (*known, "FILE.py:FACTORY"))
    world = "plain" if options.speed_range == SPEED_RANGE else "adverse"
    cycle = len(tuning_scenarios(options.speed_range, world))
    if options.episodes < cycle or options.episodes % cycle:
        raise UsageError(f"--episodes is {options.episodes}; it must be a positive multiple of {cycle}")
    if options.evaluations < 0:
        raise UsageError(f"--evaluations is {options.evaluations}; it must be at least 0")
    budget = Budget(options.evaluations, options.episodes)
    if budget.last_seed > VALIDATION_SEED:
        raise UsageError(
            f"--evaluations {options.evaluations} of --episodes {options.episodes} need seeds up to "
            f"{budget.last_seed}; seeds of tuning episodes must be below {VALIDATION_SEED}"
        )
    return budget


def _start(options: Options, names: Sequence[str], in_paper_units: VehicleModel) -> dict[str, float]:
    """Return the initial gains of the search; raise ValueError if they are wrong, OSError if there is no file."""
    if options.start is not None:
        record = read_json(options.start)
        gains = record.get("gains", record) if isinstance(record, dict) else record
        known = names or (tuple(gains) if isinstance(gains, dict) and gains else ('numbers by name, as {"k": 1.5}',))
        start = checked_gains(gains, known, str(options.start))
    elif in_paper_units == PAPER:
        start = load_gains(options.name, options.speed_range, names, "start")
    else:
        start = adapted_gains(options.name, options.speed_range, names, in_paper_units)
    if zero := [name for name, gain in start.items() if not gain > 0]:
        raise ValueError(f"the search uses logarithms: the initial values of {', '.join(zero)} must be positive")
    return start
