"""Fit a vehicle to the log of a trial: masses, drag, lag and limits with intervals: `auv-gym identify --help`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from auv_gym.physics.actuators import Actuators
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.vehicles import as_vehicle
from baselines.identification import Identified, Log, identify
from baselines.identification.begin import OPTIONAL
from baselines.identification.files import scenario_text, vehicle_text
from baselines.identification.report import report_files, rows
from baselines.identification.trials import EXAMPLE_CURRENT, example
from baselines.tools.command_line import DONE, FAILED, UsageError, parse
from baselines.tools.files import write_atomically

PROGRAM = "auv-gym identify"
EXAMPLE_LAG = 0.4  # [s]
EXAMPLE = Actuators(lag=EXAMPLE_LAG)
"""Actuators of the vehicle in an example."""


@dataclass(frozen=True)
class Options:
    """Fit a vehicle to the log of a trial; write vehicle.toml, scenario.toml and report.md with figures.

    The log is a CSV file with the columns t [s], x, y [m], psi [rad], u, v [m/s] in the body frame, r [rad/s], and the
    commands F_u [N], F_r [N m] that hold from a row to the next.

    Exit status: 0 done, 1 the log does not show a whole vehicle, 2 wrong usage.

    Example: auv-gym identify log.csv --terms X_uu --out vehicle
    """

    log: Annotated[Positional[Path], arg(metavar="LOG.csv")]
    """The log."""
    example: bool = False
    """Write an example to LOG.csv instead: a simulated trial of a minute, with noise and current."""
    seed: int = 0
    """Of an example's noise."""
    terms: Annotated[tuple[str, ...], arg(metavar="T [T ...]", help_behavior_hint="")] = OPTIONAL
    """Terms beyond masses and linear drag that may differ from 0; each is dropped where the log does not tell it
    from 0."""
    through_water: bool = False
    """The speeds u, v are those through the water, not over ground."""
    segment: float = 0.0
    """Length [s] of the pieces that are predicted from a first state. Default: by the vehicle's time constants."""
    like: Annotated[str | None, arg(metavar="VEHICLE", help_behavior_hint="")] = None
    """A vehicle by name or file, to take what the log does not show from."""
    out: Path = Path("runs/identify")
    """Folder for the results."""


def main(arguments: Sequence[str]) -> int:
    """Fit as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments or the log do not make sense.
        OSError: a file cannot be read or written.
    """
    options = parse(Options, arguments, PROGRAM)
    if options.example:
        return _written_example(options)
    try:
        like = None if options.like is None else as_vehicle(options.like)
        found = identify(Log.load(options.log), options.terms, not options.through_water, options.segment)
    except ValueError as error:
        raise UsageError(str(error)) from error
    for row in rows(found):
        print("  ".join(row))
    options.out.mkdir(parents=True, exist_ok=True)
    vehicle, says = _vehicle(found, like)
    for name, content in report_files(found, options.log.name, says).items():
        write_atomically(options.out / name, content)
    if vehicle is not None:
        write_atomically(options.out / "vehicle.toml", vehicle_text(found, vehicle, options.log.name))
        says = _written_scenario(found, vehicle, options.out / "scenario.toml") or says
    print(f"written: {options.out / 'report.md'}{'' if vehicle is None else ' and vehicle.toml beside it'}")
    if says:
        print(says)
    return FAILED if vehicle is None else DONE


def _written_example(options: Options) -> int:
    """Write the log of a trial of the paper's vehicle with the sensors of the cruise presets."""
    if options.seed < 0:
        raise UsageError(f"--seed is {options.seed}; it must be 0 or more")
    sensors = PRESETS["cruise-noise"].sensors
    example(PAPER_VEHICLE, EXAMPLE, sensors, options.seed).save(options.log)
    V_x, V_y = EXAMPLE_CURRENT
    print(f"written: {options.log}, a minute of the paper's vehicle in a current of {V_x}, {V_y} m/s")
    return DONE


def _vehicle(found: Identified, like: Vehicle | None) -> tuple[Vehicle | None, str]:
    """Return the vehicle, and what is to be said about it: why there is none, or what is not from the log."""
    try:
        vehicle = found.vehicle(like)
    except ValueError as error:
        return None, f"no vehicle.toml: {error}{'; or name a vehicle by --like' if found.unknown else ''}"
    return vehicle, f"not from the log: {', '.join(found.unknown)}" if found.unknown else ""


def _written_scenario(found: Identified, vehicle: Vehicle, file: Path) -> str:
    """Write a scenario with the vehicle; return why there is none."""
    try:
        write_atomically(file, scenario_text(found, vehicle))
    except ValueError as error:
        return f"no scenario.toml: {error}"
    return ""
