"""Fit a vehicle to the log of a trial: masses, drag, lag and limits with intervals: `auv-gym identify --help`."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import tomli_w
from tyro.conf import Positional, arg

from auv_gym.effects.actuators import Actuators
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.presets import TYPICAL_NOISE
from auv_gym.scenarios.vehicles import as_vehicle, as_vehicle_model
from baselines.identification import Identified, Log, identify
from baselines.identification.axes import ContradictionError
from baselines.identification.columns import Format
from baselines.identification.files import limits_of, scenario, vehicle_text
from baselines.identification.log import joined
from baselines.identification.model import NEEDED, is_current, names_of
from baselines.identification.prediction import HeldOut, held_out
from baselines.identification.report import MISFIT, held_out_text, report_files, rows
from baselines.identification.trials import EXAMPLE_ACTUATORS, EXAMPLE_CURRENT, example
from baselines.tools.command_line import DONE, FAILED, UsageError, called, checked_folder, parse
from baselines.tools.files import write_atomically

PROGRAM = "auv-gym identify"
QUADRATIC = ("X_uu", "Y_vv", "N_rr")
"""The terms that are tried if all terms together show no vehicle."""
_LARGEST_ENSEMBLE = 1000  # vehicles in a scenario


@dataclass(frozen=True)
class Options:
    """Fit a vehicle to logs of trials; write vehicle.toml, scenario.toml and report.md with figures.

    A log is a CSV file with the columns t [s], x, y [m], psi [rad], u, v [m/s] in the body frame, r [rad/s], and
    commands that hold until the next row: F_u [N], F_r [N m], or thrust [N], rudder [rad], or revolutions [1/s],
    rudder [rad]. For logs with other columns see --format.

    Exit status: 0 done, 1 the logs do not show all parameters of a vehicle or their columns contradict each other, 2
    wrong usage. With a model misfit the files are vehicle-misfit.toml and scenario-misfit.toml.

    Example: auv-gym identify log.csv --terms X_uu --holdout new.csv --out vehicle
    """

    logs: Annotated[Positional[tuple[Path, ...]], arg(metavar="LOG [LOG ...]", help_behavior_hint="(required)")]
    """The logs, of one vehicle."""
    holdout: Annotated[tuple[Path, ...], arg(metavar="LOG [LOG ...]")] = ()
    """Held-out logs, which are predicted by the fitted vehicle; the report compares predictions and measurements."""
    format: Annotated[str | None, arg(metavar="FORMAT")] = None
    """Columns, units and axes of the logs: the name of an included format (docs/identify.md has them), or a TOML
    file."""
    known: Annotated[tuple[str, ...], arg(metavar="NAME=VALUE [NAME=VALUE ...]")] = ()
    """Values of known parameters, which are not fitted."""
    still_water: bool = False
    """There is no current."""
    example: bool = False
    """Write an example to LOG instead: a simulated trial of one minute with noise and current."""
    seed: int = 0
    """Seed of the noise of the example."""
    terms: Annotated[tuple[str, ...], arg(metavar="T [T ...]")] = ()
    """Terms beyond masses and linear drag that may differ from 0; those that do not differ significantly are dropped.
    Default: all; in logs of forces, cross-flow only if the model does not explain the log without it."""
    through_water: bool = False
    """The speeds u, v are measured through the water, not over ground."""
    like: Annotated[str | None, arg(metavar="VEHICLE")] = None
    """Name or file of a vehicle that supplies the parameters that are not identified."""
    ensemble: int = 0
    """Number of vehicles that are drawn from the distribution of the fit; one of them is the true vehicle of each
    episode of scenario.toml. 0 for the fitted vehicle alone."""
    out: Path = Path("runs/identify")
    """Folder for the results."""


class InputFiles(NamedTuple):
    """What the options name: logs and vehicles."""

    log: Log
    held_out: Log | None
    known: Mapping[str, float]  # values of known parameters
    like: Vehicle | None  # vehicle that supplies what is not identified
    actuators: Actuators | None  # of the same vehicle


class Files(NamedTuple):
    """The files of an identification."""

    contents: Mapping[str, str | bytes]  # by name
    note: str  # what is missing, "" for nothing
    complete: bool  # whether there is a vehicle


def main(arguments: Sequence[str]) -> int:
    """Run the command; see `run` of `baselines.tools.command_line`."""
    options = parse(Options, arguments, PROGRAM)
    if not options.logs:
        raise UsageError("no LOG is given; name one file or more")
    if options.example:
        return _written_example(options)
    if not 0 <= options.ensemble <= _LARGEST_ENSEMBLE:
        raise UsageError(f"--ensemble {options.ensemble} must be 0 to {_LARGEST_ENSEMBLE}")
    try:
        inputs = read(options)
        for note in inputs.log.notes:
            print(note)
        checked_folder(options.out)
        identified, taken = fitted(inputs, options)
        errors = None if inputs.held_out is None else held_out(identified, inputs.held_out)
    except ContradictionError as error:
        print(f"{called(PROGRAM)}: {error}", file=sys.stderr)
        return FAILED
    except ValueError as error:
        raise UsageError(str(error)) from error
    except OSError as error:
        raise UsageError(f"cannot read {error.filename}: {error.strerror}") from error
    if taken:
        print(taken)
    if identified.misfit:
        print(MISFIT)
    for row in rows(identified):
        print("  ".join(row))
    if errors is not None:
        print(held_out_text(errors, _names(options.holdout)))
    files = written(identified, errors, inputs, options)
    for name, content in files.contents.items():
        write_atomically(options.out / name, content)
    print(f"written: {', '.join(str(options.out / name) for name in files.contents if not name.endswith('.png'))}")
    if files.note:
        print(files.note)
    return DONE if files.complete else FAILED


def read(options: Options) -> InputFiles:
    """Return what the options name.

    Raises:
        ValueError: a log, a vehicle or a value of --known is invalid.
        OSError: a file cannot be read.
    """
    like, actuators = None, None
    if options.like is not None:
        like, model = as_vehicle(options.like), as_vehicle_model(options.like)
        actuators = model.actuators if model else Actuators()
    form = None if options.format is None else Format.named(options.format)
    logs, others = ([Log.load(file, form) for file in files] for files in (options.logs, options.holdout))
    contents = [one.measured.tobytes() for one in (*logs, *others)]
    if len({*contents}) < len(contents):
        again = next(k for k, content in enumerate(contents) if content in contents[:k])
        raise ValueError(f"{(*options.logs, *options.holdout)[again]} has the same measurements as a file before it")
    log, new = joined(logs), joined(others) if others else None
    known = _known(options.known)
    if options.still_water:
        if current := [name for name in known if is_current(name)]:
            raise ValueError(f"--still-water excludes --known {current[0]}")
        known |= {name: 0.0 for name in names_of(log) if is_current(name)}
    return InputFiles(log, new, known, like, actuators)


def fitted(inputs: InputFiles, options: Options) -> tuple[Identified, str]:
    """Return the fit, and a sentence if it has fewer terms than the default since that shows no vehicle.

    Raises:
        ValueError: no fit is possible.
    """
    results, failure = list[Identified](), ValueError()
    for terms in (options.terms,) if options.terms else (None, QUADRATIC, ()):
        try:
            results.append(identify(inputs.log, terms, not options.through_water, inputs.known))
            results[-1].vehicle(inputs.like)
        except ValueError as error:
            failure = failure if failure.args else error
            continue
        says = f"the default terms show no vehicle ({failure}); taken: {', '.join(terms or ('none',))}"
        return results[-1], says if failure.args else ""
    if results:
        return results[0], ""
    raise failure


def written(identified: Identified, errors: HeldOut | None, inputs: InputFiles, options: Options) -> Files:
    """Return report.md with figures, and vehicle.toml and scenario.toml if the log shows enough for them."""
    name = _names(options.logs)
    tables: dict[str, str] = {}
    mark = "-misfit" if identified.misfit else ""
    note = f"not from the log: {', '.join(identified.unknown)}" if identified.unknown else ""
    missing = f"vehicle{mark}.toml"
    try:
        vehicle = identified.vehicle(inputs.like)
        limits = limits_of(identified, inputs.actuators)
        tables[missing] = vehicle_text(identified, vehicle, limits, name)
        missing = f"scenario{mark}.toml"
        ensemble = identified.ensemble(options.ensemble, inputs.like) if options.ensemble else []
        tables[missing] = tomli_w.dumps(scenario(identified, vehicle, limits, ensemble).to_dict())
    except ValueError as error:
        hint = "; or name a vehicle by --like" if identified.unknown and inputs.like is None else ""
        hint += "; are the commands in their columns, in N and N m?" if identified.misfit else ""
        note = f"no {missing}: {error}{hint}"
    report = report_files(identified, name, note, errors, _names(options.holdout))
    return Files({**report, **tables}, note, bool(tables))


def _names(files: Sequence[Path]) -> str:
    return ", ".join(file.name for file in files)


def _known(words: Sequence[str]) -> dict[str, float]:
    """Return the values of --known by name; raise ValueError if one of them is not NAME=VALUE."""
    known = {}
    for text in words:
        name, _, value = text.partition("=")
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if name in known or not math.isfinite(number) or (name in NEEDED and number <= 0):
            raise ValueError(
                f"--known {text} must be NAME=VALUE, such as m11=250, once for each name, finite, and positive for "
                "masses and linear drag"
            )
        known[name] = number
    return known


def _written_example(options: Options) -> int:
    """Write the log of a trial of the paper's vehicle with the sensors of the cruise presets."""
    if options.seed < 0:
        raise UsageError(f"--seed is {options.seed}; it must be 0 or more")
    file, *rest = options.logs
    if rest:
        raise UsageError(f"--example writes one log, not {len(options.logs)}")
    if file.exists():
        raise UsageError(f"{file} exists; --example does not replace a log, choose another file")
    example(PAPER_VEHICLE, EXAMPLE_ACTUATORS, TYPICAL_NOISE["cruise"], options.seed).save(file)
    V_x, V_y = EXAMPLE_CURRENT
    print(f"written: {file}, one minute of the paper's vehicle in a current of {V_x}, {V_y} m/s")
    return DONE
