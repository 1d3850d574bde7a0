"""Fit a vehicle to the log of a trial: masses, drag, lag and limits with intervals: `auv-gym identify --help`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tomli_w
from tyro.conf import Positional, arg

from auv_gym.physics.actuators import Actuators
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.vehicles import as_vehicle, as_vehicle_model
from baselines.identification import Identified, Log, identify
from baselines.identification.columns import Format
from baselines.identification.files import scenario, vehicle_text
from baselines.identification.held_out import drawing, held_out, section
from baselines.identification.initial_values import NEEDED
from baselines.identification.log import joined
from baselines.identification.model import is_current, names_of
from baselines.identification.report import MISFIT, report_files, rows
from baselines.identification.trials import EXAMPLE_CURRENT, example
from baselines.tools.command_line import DONE, FAILED, UsageError, checked_folder, parse
from baselines.tools.figure_style import styled, to_png
from baselines.tools.files import write_atomically

PROGRAM = "auv-gym identify"
EXAMPLE_LAG = 0.4  # [s]
EXAMPLE = Actuators(lag=EXAMPLE_LAG)
"""Actuators of the vehicle in the example."""

_LARGEST_ENSEMBLE = 1000  # vehicles in a scenario


@dataclass(frozen=True)
class Options:
    """Fit a vehicle to logs of trials; write vehicle.toml, scenario.toml and report.md with figures.

    A log is a CSV file with the columns t [s], x, y [m], psi [rad], u, v [m/s] in the body frame, r [rad/s], and
    commands that hold until the next row: F_u [N], F_r [N m], or thrust [N], rudder [rad], or revolutions [1/s],
    rudder [rad]. For logs with other columns see --format.

    Exit status: 0 done, 1 the logs do not show all parameters of a vehicle, 2 wrong usage.

    Example: auv-gym identify log.csv --terms X_uu --holdout new.csv --out vehicle
    """

    logs: Annotated[Positional[tuple[Path, ...]], arg(metavar="LOG [LOG ...]")]
    """The logs, of one vehicle."""
    holdout: Annotated[tuple[Path, ...], arg(metavar="LOG [LOG ...]", help_behavior_hint="")] = ()
    """Held-out logs, which are predicted by the fitted vehicle; the report compares predictions and measurements."""
    format: Annotated[str | None, arg(metavar="FORMAT", help_behavior_hint="")] = None
    """Columns, units and axes of the logs: the name of an included format, or a TOML file."""
    known: Annotated[tuple[str, ...], arg(metavar="NAME=VALUE [NAME=VALUE ...]", help_behavior_hint="")] = ()
    """Values of known parameters, which are not fitted."""
    still_water: bool = False
    """There is no current."""
    example: bool = False
    """Write an example to LOG instead: a simulated trial of one minute with noise and current."""
    seed: int = 0
    """Seed of the noise of the example."""
    terms: Annotated[tuple[str, ...], arg(metavar="T [T ...]", help_behavior_hint="")] = ()
    """Terms beyond masses and linear drag that may differ from 0; those that do not differ significantly are dropped.
    Default: all; in logs of forces, cross-flow only if the model does not explain the log without it."""
    through_water: bool = False
    """The speeds u, v are measured through the water, not over ground."""
    like: Annotated[str | None, arg(metavar="VEHICLE", help_behavior_hint="")] = None
    """Name or file of a vehicle that supplies the parameters that are not identified."""
    ensemble: int = 0
    """Number of vehicles that are drawn from the distribution of the fit; one of them is the true vehicle of each
    episode of scenario.toml. Default: the fitted vehicle alone."""
    out: Path = Path("runs/identify")
    """Folder for the results."""


def main(arguments: Sequence[str]) -> int:
    """Run the command with its arguments and return the exit status.

    Raises:
        UsageError: the arguments or the log are invalid.
        OSError: a file cannot be read or written.
    """
    options = parse(Options, arguments, PROGRAM)
    if not options.logs:
        raise UsageError("no LOG is given; name one file or more")
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
            if current := [name for name in known if is_current(name)]:
                raise ValueError(f"--still-water excludes --known {current[0]}")
            known |= {name: 0.0 for name in names_of(log) if is_current(name)}
        checked_folder(options.out)
        found = identify(log, options.terms or None, not options.through_water, known)
        result = held_out(found, others[0]) if others else None
    except ValueError as error:
        raise UsageError(str(error)) from error
    name = ", ".join(file.name for file in options.logs)
    if found.misfit:
        print(MISFIT)
    for row in rows(found):
        print("  ".join(row))
    vehicle, note = _vehicle(found, like)
    actuators = None
    if options.like is not None:
        model = as_vehicle_model(options.like)
        actuators = model.actuators if model else Actuators()
    files = report_files(found, name, note)
    try:
        if vehicle is not None:
            files["vehicle.toml"] = vehicle_text(found, vehicle, name, actuators)
            several = found.ensemble(options.ensemble, like) if options.ensemble else []
            files["scenario.toml"] = tomli_w.dumps(scenario(found, vehicle, actuators, several).to_dict())
    except ValueError as error:
        note = f"no {'scenario' if 'vehicle.toml' in files else 'vehicle'}.toml: {error}"
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
    if note:
        print(note)
    return DONE if "vehicle.toml" in written else FAILED


def _known(given: Sequence[str]) -> dict[str, float]:
    """Return the values of --known by name.

    Raises:
        UsageError: one of them is not NAME=VALUE.
    """
    known = {}
    for text in given:
        name, _, value = text.partition("=")
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if name in known or not math.isfinite(number) or (name in NEEDED and number <= 0):
            raise UsageError(
                f"--known {text} must be NAME=VALUE, such as m11=250, once for each name, finite, and positive for "
                "masses and linear drag"
            )
        known[name] = number
    return known


def _written_example(options: Options) -> int:
    """Write the log of a trial of the paper's vehicle with the sensors of the cruise presets."""
    if options.seed < 0:
        raise UsageError(f"--seed is {options.seed}; it must be 0 or more")
    sensors = PRESETS["cruise-noise"].sensors
    file, *rest = options.logs
    if rest:
        raise UsageError(f"--example writes one log, not {len(options.logs)}")
    if file.exists():
        raise UsageError(f"{file} exists; --example does not replace a log, choose another file")
    example(PAPER_VEHICLE, EXAMPLE, sensors, options.seed).save(file)
    V_x, V_y = EXAMPLE_CURRENT
    print(f"written: {file}, one minute of the paper's vehicle in a current of {V_x}, {V_y} m/s")
    return DONE


def _vehicle(found: Identified, like: Vehicle | None) -> tuple[Vehicle | None, str]:
    """Return the vehicle and a note: why there is no vehicle, or which parameters are not from the log."""
    try:
        vehicle = found.vehicle(like)
    except ValueError as error:
        return None, f"no vehicle.toml: {error}{'; or name a vehicle by --like' if found.unknown else ''}"
    return vehicle, f"not from the log: {', '.join(found.unknown)}" if found.unknown else ""
