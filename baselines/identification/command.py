"""Fit a vehicle to the log of a trial: masses, drag, lag and limits with intervals: `auv-gym identify --help`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import Positional, arg

from auv_gym.physics.actuators import Actuators
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.vehicles import as_vehicle, as_vehicle_model
from baselines.identification import Identified, Log, identify
from baselines.identification.begin import is_current
from baselines.identification.columns import Format
from baselines.identification.files import scenario_text, vehicle_text
from baselines.identification.held_out import drawing, held_out, section
from baselines.identification.log import joined
from baselines.identification.model import LogModel
from baselines.identification.report import MISFIT, report_files, rows
from baselines.identification.trials import EXAMPLE_CURRENT, example
from baselines.tools.command_line import DONE, FAILED, UsageError, parse
from baselines.tools.figure_style import styled, to_png
from baselines.tools.files import write_atomically

PROGRAM = "auv-gym identify"
EXAMPLE_LAG = 0.4  # [s]
EXAMPLE = Actuators(lag=EXAMPLE_LAG)
"""Actuators of the vehicle in an example."""

_LARGEST_ENSEMBLE = 1000  # vehicles in a scenario


@dataclass(frozen=True)
class Options:
    """Fit a vehicle to logs of trials; write vehicle.toml, scenario.toml and report.md with figures.

    A log is a CSV file with the columns t [s], x, y [m], psi [rad], u, v [m/s] in the body frame, r [rad/s], and
    commands that hold from a row to the next: F_u [N], F_r [N m], or thrust [N], rudder [rad], or revolutions [1/s],
    rudder [rad]. Logs of another form: see --format.

    Exit status: 0 done, 1 the logs do not show a whole vehicle, 2 wrong usage.

    Example: auv-gym identify log.csv --terms X_uu --holdout new.csv --out vehicle
    """

    logs: Annotated[Positional[tuple[Path, ...]], arg(metavar="LOG [LOG ...]")]
    """The logs, of one vehicle."""
    holdout: Annotated[tuple[Path, ...], arg(metavar="LOG [LOG ...]", help_behavior_hint="")] = ()
    """Logs that nothing is fitted to: predictions of them are compared with what was measured."""
    format: Annotated[str | None, arg(metavar="FORMAT", help_behavior_hint="")] = None
    """Which columns are what, in which units: the name of a known format, or a TOML file."""
    known: Annotated[tuple[str, ...], arg(metavar="NAME=VALUE [NAME=VALUE ...]", help_behavior_hint="")] = ()
    """Parameters that are known and not searched for."""
    still_water: bool = False
    """There is no current."""
    example: bool = False
    """Write an example to LOG instead: a simulated trial of a minute, with noise and current."""
    seed: int = 0
    """Of an example's noise."""
    terms: Annotated[tuple[str, ...], arg(metavar="T [T ...]", help_behavior_hint="")] = ()
    """Terms beyond masses and linear drag that may differ from 0; each is dropped where the logs do not tell it
    from 0. Default: all; cross-flow, in logs of forces, only where the model explains the log no better without it."""
    through_water: bool = False
    """The speeds u, v are those through the water, not over ground."""
    segment: float = 0.0
    """Length [s] of the pieces that are predicted from a first state. Default: by the vehicle's time constants; in
    logs of a rudder 60 s."""
    like: Annotated[str | None, arg(metavar="VEHICLE", help_behavior_hint="")] = None
    """A vehicle by name or file, to take what the log does not show from."""
    ensemble: int = 0
    """Number of vehicles that the log allows, drawn from the fit: the true vehicle of each episode of scenario.toml is
    one of them. Default: the fitted vehicle alone."""
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
    if not 0 <= options.ensemble <= _LARGEST_ENSEMBLE:
        raise UsageError(f"--ensemble {options.ensemble} must be 0 to {_LARGEST_ENSEMBLE}")
    try:
        like = None if options.like is None else as_vehicle(options.like)
        form = None if options.format is None else Format.named(options.format)
        log, *others = (
            joined([Log.load(file, form) for file in files]) for files in (options.logs, options.holdout) if files
        )
        known = _known(options.known)
        if options.still_water:
            known |= {name: 0.0 for name in LogModel(log, np.array(log.starts)).names if is_current(name)}
        found = identify(log, options.terms or None, not options.through_water, options.segment, known)
        result = held_out(found, others[0]) if others else None
    except ValueError as error:
        raise UsageError(str(error)) from error
    name = ", ".join(file.name for file in options.logs)
    if found.misfit:
        print(MISFIT)
    for row in rows(found):
        print("  ".join(row))
    options.out.mkdir(parents=True, exist_ok=True)
    vehicle, says = _vehicle(found, like)
    actuators = None if options.like is None else _actuators(options.like)
    files = report_files(found, name, says)
    try:
        if vehicle is not None:
            files["vehicle.toml"] = vehicle_text(found, vehicle, name, actuators)
            several = found.ensemble(options.ensemble, like) if options.ensemble else []
            files["scenario.toml"] = scenario_text(found, vehicle, actuators, several)
    except ValueError as error:
        says = f"no {'scenario' if 'vehicle.toml' in files else 'vehicle'}.toml: {error}"
    if result is not None:
        names = ", ".join(file.name for file in options.holdout)
        files["report.md"] = f"{files['report.md']!s}\n{section(result, names)}\n"
        with styled():
            files["held-out.png"] = to_png(drawing(result))
        print(section(result, names).partition("\n\n")[2])
    for file, content in files.items():
        write_atomically(options.out / file, content)
    written = [file for file in files if not file.endswith(".png")]
    print(f"written: {', '.join(str(options.out / file) for file in written)}")
    if says:
        print(says)
    return DONE if "vehicle.toml" in written else FAILED


def _known(given: Sequence[str]) -> dict[str, float]:
    """Return parameters by name.

    Raises:
        UsageError: one of them is not given as NAME=VALUE.
    """
    found = {}
    for text in given:
        name, _, value = text.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            raise UsageError(f"--known {text} must be NAME=VALUE, such as m11=250") from None
    return found


def _actuators(like: str) -> Actuators:
    """Return the actuators of a vehicle by name or file."""
    vehicle_model = as_vehicle_model(like)
    return Actuators() if vehicle_model is None else vehicle_model.actuators


def _written_example(options: Options) -> int:
    """Write the log of a trial of the paper's vehicle with the sensors of the cruise presets."""
    if options.seed < 0:
        raise UsageError(f"--seed is {options.seed}; it must be 0 or more")
    sensors = PRESETS["cruise-noise"].sensors
    file, *rest = options.logs
    if rest:
        raise UsageError(f"--example writes one log, not {len(options.logs)}")
    example(PAPER_VEHICLE, EXAMPLE, sensors, options.seed).save(file)
    V_x, V_y = EXAMPLE_CURRENT
    print(f"written: {file}, a minute of the paper's vehicle in a current of {V_x}, {V_y} m/s")
    return DONE


def _vehicle(found: Identified, like: Vehicle | None) -> tuple[Vehicle | None, str]:
    """Return the vehicle, and what is to be said about it: why there is none, or what is not from the log."""
    try:
        vehicle = found.vehicle(like)
    except ValueError as error:
        return None, f"no vehicle.toml: {error}{'; or name a vehicle by --like' if found.unknown else ''}"
    return vehicle, f"not from the log: {', '.join(found.unknown)}" if found.unknown else ""
