"""The dimensions of what a scenario is made of, and the same scenario in other units.

Seen in units of a vehicle's own (`auv_gym.units`) a scenario is one of a vehicle with the mass, the length and the
design speed of the paper's: everything happens in it as before, in other numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from auv_gym.actuators import Actuators
from auv_gym.intervals import Interval
from auv_gym.paths import Path
from auv_gym.units import POWERS as UNITS
from auv_gym.units import Units, in_paper_units

if TYPE_CHECKING:
    from auv_gym.scenario import Scenario

POWERS: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "path": {"speed": (1, -1)},
    "start": {"x_e": (1, 0), "y_e": (1, 0)},
    "sensors": {
        "position": (1, 0), "velocity": (1, -1), "yaw_rate": (0, -1), "position_bias": (1, 0),
        "velocity_bias": (1, -1), "yaw_rate_bias": (0, -1), "outages": (0, -1), "outage_time": (0, 1),
        "low_pass": (0, -1),
    },
    "reckoning": {"interval": (0, 1), "drift": (0, -1), "walk": (0, -0.5)},
    "current": {"gust_time": (0, 1), "smoothing": (0, 1), "turn": (0, -1), "wavelength": (1, 0)},
    "waves": {"band": (0, -1)},
}  # fmt: skip
"""Powers of length and time in the dimensions of a scenario's entries; those that have none, or a rule of their own,
are left out."""
LIMITS = {"F_u_max": "N", "F_r_max": "N m", "F_u_rate": "N/s", "F_r_rate": "N m/s", "fin": "kg"}
"""SI units of what bounds an actuator."""


def scaled(value: Interval, factor: float) -> Interval:
    """Return a number, or both ends of an interval, times a factor."""
    return (value[0] * factor, value[1] * factor) if isinstance(value, tuple) else value * factor


def scaled_part(name: str, part: Any, units: Units) -> Any:
    """Return a part of a scenario with its entries multiplied by the units, by the powers in their dimensions.

    Args:
        name: of the part, a key of `POWERS`.
        part: the part; None, or a path that is not drawn, stays what it is.
        units: the factors of length, time and mass.
    """
    if part is None or isinstance(part, Path):
        return part
    powers = dict(POWERS[name])
    if name == "sensors":
        part = replace(part, reckoning=scaled_part("reckoning", part.reckoning, units))
    if name == "current" and not part.relative:
        powers |= dict.fromkeys(("speed", "gust", "shear"), (1, -1))
    given = {entry: getattr(part, entry) for entry in powers}
    return replace(part, **{e: scaled(x, units.factor(*powers[e])) for e, x in given.items() if x is not None})


def actuators_in(units: Units, actuators: Actuators) -> Actuators:
    """Return actuators in the paper's units: limits and lag over the factors of these units."""
    limits = {name: getattr(actuators, name) / units.factor(*UNITS[unit]) for name, unit in LIMITS.items()}
    return replace(actuators, **limits, lag=scaled(actuators.lag, 1 / units.time))


def in_vehicle_units(scenario: Scenario) -> Scenario:
    """Return a scenario as it is in its vehicle's own units, which are the paper's for a vehicle like that one.

    Every episode drawn from it is the one drawn from the original, in other numbers; what has no dimension, such as an
    action, is the same. A scenario whose vehicle has the mass, length and design speed of the paper's is returned as it
    is.

    Raises:
        ValueError: its path is not drawn, so that it has no speed and turn rate to scale; or a number is out of bounds.
    """
    units = Units.of(scenario.vehicle)
    if units == Units():
        return scenario
    path: Any = scenario.path
    if isinstance(path, Path):
        raise ValueError(
            f"scenario {scenario.name!r} has one path of its own, which cannot be seen in the units of its vehicle; "
            "give it paths that are drawn: a path with speed and turn_rate"
        )
    back = Units(1 / units.length, 1 / units.time, 1 / units.mass)
    names = "start", "sensors", "current"
    changes = {name: scaled_part(name, getattr(scenario, name), back) for name in names}
    waves, mismatch = scaled_part("waves", scenario.waves, back), scenario.mismatch
    if waves is not None:
        waves = replace(waves, yaw=waves.yaw * units.length)  # of d33 U / (1 m)
    if mismatch is not None:
        dimensions = zip(mismatch.quadratic_drag, ("kg/m", "kg/m", "kg m^2"), strict=True)
        X_uu, Y_vv, N_rr = (drag / units.factor(*UNITS[unit]) for drag, unit in dimensions)
        mismatch = replace(mismatch, quadratic_drag=(X_uu, Y_vv, N_rr))
    return replace(
        scenario,
        path=replace(scaled_part("path", path, back), turn_rate=path.turn_rate * units.time),
        vehicle=in_paper_units(scenario.vehicle),
        waves=waves,
        mismatch=mismatch,
        actuators=actuators_in(units, scenario.actuators),
        control_dt=scenario.control_dt / units.time,
        error_scale=scenario.error_scale / units.length,
        lost_distance=scenario.lost_distance / units.length,
        **changes,
    )
