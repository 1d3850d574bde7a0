"""Load the gains of the tuned controllers, and adapt them to the limits, the lag and the drag of another vehicle.

Each controller has a JSON file per speed range in `baselines/gains`. The file also says where the numbers come from.
For a vehicle with known actuators each gain at cruise is multiplied by powers of the vehicle's `RATIOS`. The file
`EXPONENTS` has the exponents, which `python -m research gain-exponents` fits to random vehicles.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from auv_gym.physics.actuators import fin_share
from auv_gym.physics.namespaces import FLOATS
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.presets import SPEED_RANGES
from auv_gym.scenarios.vehicles import PAPER, PAPER_LAG, VehicleModel, as_vehicle
from baselines.policy import BySpeed, Controller, Remembering

GAINS_FOLDER = Path(__file__).parent
"""Folder of the files of gains, NAME-SPEED_RANGE.json."""
EXPONENTS = GAINS_FOLDER / "exponents.json"
"""File of the exponents of the gains at cruise, by controller: for each gain those of `vehicle_ratios`."""
RATIOS = ("thrust", "torque", "lag", "sway", "yaw", "mass")
"""Ratios of a vehicle to the paper's vehicle, both in the paper's units: limits of the actuators at the design speed,
their lag, drag in sway and yaw over velocity at the design speed, and m22."""
LARGEST_RATIO = 4.0
"""A ratio counts as at most this number and at least its inverse, so that extreme vehicles are not extrapolated to."""


def gain_file(name: str, speed_range: str) -> Path:
    """Return the path of the file with the gains of a controller for a speed range.

    Raises:
        ValueError: the speed range is neither slow nor cruise.
    """
    if speed_range not in SPEED_RANGES:
        raise ValueError(f"unknown speed range {speed_range!r}; allowed are {', '.join(SPEED_RANGES)}")
    return GAINS_FOLDER / f"{name}-{speed_range}.json"


def checked_gains(gains: Any, names: Sequence[str], source: str) -> dict[str, float]:
    """Return the gains as floats, in the order of `names`.

    Raises:
        ValueError: `gains` is not a mapping from exactly these names to finite numbers of at least 0. The message
            begins with `source`.
    """
    if not isinstance(gains, Mapping) or set(gains) != set(names):
        given = ", ".join(map(str, gains)) if isinstance(gains, Mapping) else repr(gains)
        raise ValueError(f"{source} has the gains {given}; they must be {', '.join(names)}")
    for key, value in gains.items():
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value < math.inf:
            raise ValueError(f"{source}: gain {key} is {value!r}; it must be a finite number of at least 0")
    return {key: float(gains[key]) for key in names}


def vehicle_ratios(vehicle_model: VehicleModel) -> list[float]:
    """Return the logarithms of the `RATIOS` of a vehicle in the paper's units; 0 for the paper's vehicle.

    Those of ratios above one come first, with 0 for the others, then those of ratios below one: a gain has an exponent
    for stronger vehicles and one for weaker vehicles.
    """
    ratios = zip(_measures(vehicle_model), _measures(PAPER), strict=True)
    logarithms = [math.log(min(max(mine / papers, 1 / LARGEST_RATIO), LARGEST_RATIO)) for mine, papers in ratios]
    return [*(max(x, 0.0) for x in logarithms), *(min(x, 0.0) for x in logarithms)]


def _measures(vehicle_model: VehicleModel) -> tuple[float, ...]:
    actuators, vehicle = vehicle_model.actuators, vehicle_model.vehicle
    torque = actuators.F_r_max * fin_share(vehicle.speed, actuators.fin, actuators.F_r_max, FLOATS)
    lag = vehicle_model.lag or PAPER_LAG  # None: that of the paper's vehicle in the paper's units
    _, sway, yaw = vehicle_model.drag(vehicle.speed)
    return actuators.F_u_max, torque, lag, sway, yaw, vehicle.m22


@cache
def _exponents() -> Mapping[str, Mapping[str, Sequence[float]]]:
    record = json.loads(EXPONENTS.read_text(encoding="utf-8"))
    return {name: entry["exponents"] for name, entry in record.items()}


def adapted_gains(name: str, speed_range: str, names: Sequence[str], vehicle: Any) -> dict[str, float]:
    """Return the gains of a controller for a vehicle in the paper's units.

    Args:
        name: of the controller.
        speed_range: "slow" or "cruise".
        names: of its gains.
        vehicle: a `VehicleModel`. For anything else, whose actuators are not known, and in slow motion the gains are
            those of the files.

    Raises:
        ValueError: see `load_gains`.
    """
    gains = load_gains(name, speed_range, names)
    if not isinstance(vehicle, VehicleModel) or speed_range != "cruise":
        return gains
    ratios = vehicle_ratios(vehicle)
    for gain, powers in _exponents().get(name, {}).items():
        gains[gain] *= math.exp(sum(power * ratio for power, ratio in zip(powers, ratios, strict=True)))
    return gains


def load_gains(name: str, speed_range: str, names: Sequence[str], part: str = "gains") -> dict[str, float]:
    """Return the gains of a controller for a speed range and the paper's vehicle.

    Args:
        name: of the controller; its files begin with it.
        speed_range: "slow" or "cruise".
        names: of its gains.
        part: "gains", or "start" for the initial gains of the search. Without a search they are the same.

    Raises:
        ValueError: the speed range or the file does not exist, the file is not valid JSON, or the names of its gains
            are not `names`.
    """
    record = gain_record(name, speed_range)
    return checked_gains(record.get(part, record.get("gains")), names, str(gain_file(name, speed_range)))


def gain_record(name: str, speed_range: str) -> dict[str, Any]:
    """Return the contents of the file with a controller's gains for a speed range.

    A file that holds no JSON object is returned as {"gains": contents}, so that `checked_gains` can report it.

    Raises:
        ValueError: the speed range or the file does not exist, or the file is not valid JSON.
    """
    file = gain_file(name, speed_range)
    try:
        record = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        command = f"auv-gym tune {name} --speed-range {speed_range}"
        raise ValueError(
            f'the file of gains {file} does not exist; write initial gains, {{"gains": ...}}, then run {command}'
        ) from None
    except ValueError as error:
        raise ValueError(f"{file} is not valid JSON: {error}") from error
    return record if isinstance(record, dict) else {"gains": record}


def tuned_policy(
    name: str,
    names: Sequence[str],
    controller: Callable[[Mapping[str, float], Vehicle], Controller],
    gains: Mapping[str, float] | None = None,
    vehicle: Vehicle | VehicleModel | str | dict[str, Any] = PAPER_VEHICLE,
) -> Remembering:
    """Return a policy that selects its gains by the speed of the reference.

    Args:
        name: of the controller; its files begin with it.
        names: of its gains.
        controller: returns the controller for gains and a vehicle.
        gains: used at every speed instead of the gains in the files.
        vehicle: nominal model of the controller in the paper's units; an object, a name or a dict.

    Raises:
        ValueError: unknown vehicle; a file or `gains` is not valid, see `load_gains` and `checked_gains`.
    """
    known = as_vehicle(vehicle)
    if gains is not None:
        return Remembering(controller(checked_gains(gains, names, name), known))
    slow, cruise = (controller(adapted_gains(name, speed_range, names, vehicle), known) for speed_range in SPEED_RANGES)
    return Remembering(BySpeed(slow, cruise))
