"""Gains as data: a JSON file in `baselines/gains` for each controller and regime, with where the numbers come from."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.presets import SPEED_RANGES
from auv_gym.scenarios.vehicles import as_vehicle
from baselines.policy import BySpeed, Controller, Remembering

GAINS_FOLDER = Path(__file__).parent  # of the gains, NAME-REGIME.json


def gain_file(name: str, speed_range: str) -> Path:
    """Return where the gains of a controller for a regime are kept.

    Raises:
        ValueError: the regime is neither slow nor cruise.
    """
    if speed_range not in SPEED_RANGES:
        raise ValueError(f"unknown regime {speed_range!r}; allowed are {', '.join(SPEED_RANGES)}")
    return GAINS_FOLDER / f"{name}-{speed_range}.json"


def checked_gains(gains: Any, names: Sequence[str], source: str) -> dict[str, float]:
    """Return the gains as floats, in the order of `names`.

    Raises:
        ValueError: they are no mapping of exactly these names to finite numbers of at least 0; `source` is cited.
    """
    if not isinstance(gains, Mapping) or set(gains) != set(names):
        given = ", ".join(map(str, gains)) if isinstance(gains, Mapping) else repr(gains)
        raise ValueError(f"{source} has the gains {given}; they must be {', '.join(names)}")
    for key, value in gains.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value < math.inf:
            raise ValueError(f"{source}: gain {key} is {value!r}; it must be a finite number of at least 0")
    return {key: float(gains[key]) for key in names}


def load_gains(name: str, speed_range: str, names: Sequence[str], part: str = "gains") -> dict[str, float]:
    """Return the gains of a controller for a regime, "slow" or "cruise".

    Args:
        name: the controller's name, which its files begin with.
        speed_range: "slow" or "cruise".
        names: the names of its gains.
        part: "gains", or "start" for those that the search began at; where there was no search, they are the same.

    Raises:
        ValueError: there is no such regime or file, the file is not valid JSON, or its gains are not those of `names`.
    """
    record = gain_record(name, speed_range)
    return checked_gains(record.get(part, record.get("gains")), names, str(gain_file(name, speed_range)))


def gain_record(name: str, speed_range: str) -> dict[str, Any]:
    """Return the file of a controller's gains for a regime; what is no record is taken for its gains.

    Raises:
        ValueError: there is no such regime or file, or the file is not valid JSON.
    """
    file = gain_file(name, speed_range)
    try:
        record = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        command = f"auv-gym tune {name} --speed-range {speed_range}"
        how = f'write some to begin at, {{"gains": ...}}, then {command}'
        raise ValueError(f"there are no gains in {file}; {how}") from None
    except ValueError as error:
        raise ValueError(f"{file} is not valid JSON: {error}") from error
    return record if isinstance(record, dict) else {"gains": record}


def tuned_policy(
    name: str,
    names: Sequence[str],
    controller: Callable[[Mapping[str, float], Vehicle], Controller],
    gains: Mapping[str, float] | None = None,
    vehicle: Vehicle | str | dict[str, Any] = PAPER_VEHICLE,
) -> Remembering:
    """Return a policy with the gains of the regime that its reference's speed belongs to.

    Args:
        name: the controller's name, which its files begin with.
        names: the names of its gains.
        controller: makes it from gains for a vehicle.
        gains: used at every speed in place of the files.
        vehicle: the vehicle that the controller believes in; an object, a name or a dict.

    Raises:
        ValueError: unknown vehicle; a file or `gains` is not what it must be, see `load_gains` and `checked_gains`.
    """
    known = as_vehicle(vehicle)
    if gains is not None:
        return Remembering(controller(checked_gains(gains, names, name), known))
    slow, cruise = (controller(load_gains(name, speed_range, names), known) for speed_range in SPEED_RANGES)
    return Remembering(BySpeed(slow, cruise))
