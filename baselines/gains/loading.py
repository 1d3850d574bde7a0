"""Load the gains of the tuned controllers, and adapt them to the limits, the lag and the drag of another vehicle.

`GAINS_FILE` has all gains and where they come from: the `sets` of the paper's law, by name; gains that `auv-gym tune`
has `tuned`, by controller and speed range; and `exponents`, by controller. For a vehicle with known actuators each gain
at cruise is multiplied by powers of the vehicle's `RATIOS`, with these exponents.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from auv_gym.effects.actuators import fin_share
from auv_gym.physics.namespaces import FLOATS
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.presets import SPEED_RANGES
from auv_gym.scenarios.vehicles import PAPER, PAPER_LAG, VehicleModel, as_vehicle
from baselines.policy import BySpeed, Controller, Remembering
from baselines.tools.files import write_atomically

GAINS_FILE = Path(__file__).with_name("gains.json")  # the only copy of all gains
RATIOS = ("thrust", "torque", "lag", "sway", "yaw", "mass")
"""Ratios of a vehicle to the paper's vehicle, both in the paper's units: limits of the actuators at the design speed,
their lag, drag in sway and yaw over velocity at the design speed, and m22."""
LARGEST_RATIO = 4.0
"""A ratio counts as at most this number and at least its inverse, so that extreme vehicles are not extrapolated to."""


@cache
def recorded_gains() -> dict[str, Any]:
    """Return the contents of `GAINS_FILE`."""
    record: dict[str, Any] = json.loads(GAINS_FILE.read_text(encoding="utf-8"))
    return record


def write_gains(part: str, name: str, record: Mapping[str, Any]) -> None:
    """Write the record of a controller in a part of `GAINS_FILE`, in place of its earlier one."""
    content = json.loads(GAINS_FILE.read_text(encoding="utf-8"))
    content[part][name] = record
    lists = re.compile(r"\[\s+([^\[\]{}]*?)\s+\]")  # on one line each
    text = lists.sub(lambda found: f"[{' '.join(found[1].split())}]", json.dumps(content, indent=1))
    write_atomically(GAINS_FILE, f"{text}\n")
    recorded_gains.cache_clear()


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
    for gain, powers in recorded_gains()["exponents"].get(name, {"exponents": {}})["exponents"].items():
        gains[gain] *= math.exp(sum(power * ratio for power, ratio in zip(powers, ratios, strict=True)))
    return gains


def load_gains(name: str, speed_range: str, names: Sequence[str], part: str = "gains") -> dict[str, float]:
    """Return the gains of a controller for a speed range and the paper's vehicle.

    Args:
        name: of the controller.
        speed_range: "slow" or "cruise".
        names: of its gains.
        part: "gains", or "start" for the initial gains of the search.

    Raises:
        ValueError: there are no such gains, or their names are not `names`.
    """
    try:
        record = recorded_gains()["tuned"][name][speed_range]
    except KeyError:
        command = f"auv-gym tune {name} --speed-range {speed_range} --start FILE.json"
        raise ValueError(f"{GAINS_FILE} has no gains of {name} in {speed_range}: {command} tunes them") from None
    return checked_gains(record[part], names, f"{GAINS_FILE}, {name} in {speed_range},")


def numbers_of(name: str, in_space: bool = False) -> list[Any]:
    """Return all recorded numbers that a controller can depend on, in the plane or in space, as plain JSON."""
    record = recorded_gains()
    ranges = record["tuned"].get(name, {}).items()
    tuned = [entry["gains"] for speed_range, entry in ranges if (speed_range not in SPEED_RANGES) == in_space]
    exponents = record["exponents"].get(name, {}).get("exponents")
    return [tuned, exponents, {key: entry["gains"] for key, entry in record["sets"].items()}]


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
