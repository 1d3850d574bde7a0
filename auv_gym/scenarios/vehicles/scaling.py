"""The dimensions of the entries of a scenario, and the conversion of its parts to other units."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from auv_gym.effects.actuators import Actuators
from auv_gym.effects.sensors import Sensors
from auv_gym.physics.intervals import times as scaled
from auv_gym.physics.units import POWERS as UNITS
from auv_gym.physics.units import Units
from auv_gym.planning.paths import Path

SCENARIO_POWERS: Mapping[str, Mapping[str, tuple[float, ...]]] = {
    "path": {"speed": (1, -1)},
    "start": {"x_e": (1, 0), "y_e": (1, 0)},
    "sensors": {
        "position": (1, 0), "velocity": (1, -1), "yaw_rate": (0, -1), "position_bias": (1, 0),
        "velocity_bias": (1, -1), "yaw_rate_bias": (0, -1), "outages": (0, -1), "outage_time": (0, 1),
        "low_pass": (0, -1), "correlation": (0, 1),
    },
    "reckoning": {"interval": (0, 1), "drift": (0, -1), "walk": (0, -0.5)},
    "current": {"gust_time": (0, 1), "smoothing": (0, 1), "turn": (0, -1), "wavelength": (1, 0)},
    "waves": {"band": (0, -1), "most_yaw": (0, 0, 1)},
    "faults": {"rate": (0, -1), "time": (0, 1), "jump": (1, 0), "offset": (1, -1), "begin": (0, 1)},
}  # fmt: skip
"""Powers of length, time and mass in the dimensions of the entries of a scenario, except dimensionless entries and
entries with other rules."""
_LIMITS = {"F_u_max": "N", "F_r_max": "N m", "F_u_rate": "N/s", "F_r_rate": "N m/s", "fin": "kg"}
"""SI units of the limits of actuators."""


def scaled_part(name: str, part: Any, units: Units) -> Any:
    """Return a part of a scenario with each entry multiplied by the factor of its dimension.

    Args:
        name: name of the part, a key of `SCENARIO_POWERS`.
        part: the part; None and fixed paths do not change.
        units: the factors of length, time and mass.
    """
    if part is None or isinstance(part, Path):
        return part
    powers = dict(SCENARIO_POWERS[name])
    if isinstance(part, Sensors):
        part = replace(part, reckoning=scaled_part("reckoning", part.reckoning, units))
    if name == "current" and not part.relative:
        powers |= dict.fromkeys(("speed", "gust", "shear"), (1, -1))
    entries = {entry: getattr(part, entry, None) for entry in powers}  # `NoiseLevels` has some of those of `Sensors`
    return replace(part, **{e: scaled(x, units.factor(*powers[e])) for e, x in entries.items() if x is not None})


def actuators_in(units: Units, actuators: Actuators) -> Actuators:
    """Return actuators with limits and lag divided by the factors of these units."""
    limits = {name: getattr(actuators, name) / units.factor(*UNITS[unit]) for name, unit in _LIMITS.items()}
    return replace(actuators, **limits, lag=scaled(actuators.lag, 1 / units.time))
