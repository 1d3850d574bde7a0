"""Wind on the part of a vessel that is above the water."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from auv_gym.physics.dynamics import Load
from auv_gym.physics.namespaces import Number


class WindDrag(NamedTuple):
    """Coefficients of the wind's force: floats, or rows of shape (N,); half the air's density is in them."""

    X_air: Number  # [kg/m] surge force, about 0.6 kg/m^3 times the frontal area and its drag coefficient
    Y_air: Number  # [kg/m] sway force, the same of the lateral area
    N_air: Number  # [kg] yaw moment of a wind from the side: Y_air times how far ahead its force acts
    N_turn: Number  # [kg] yaw moment of a wind from ahead or astern of the side, positive where it turns across


def wind_load(u: Number, v: Number, drag: WindDrag, ns: Any = math) -> Load:
    """Return surge force [N], sway force [N] and yaw moment [N m] of the wind.

    With the angle of attack of the relative wind they go as cosine, sine, and sine and sine of twice the angle (T. I.
    Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed., 2021, section 10.1).

    Args:
        u: surge velocity of the vessel through the air [m/s].
        v: its sway velocity through the air [m/s].
        drag: the coefficients.
        ns: the namespace of the numbers.
    """
    speed = ns.sqrt(u * u + v * v + 1e-12)  # has a slope at rest
    return -drag.X_air * speed * u, -drag.Y_air * speed * v, -(drag.N_air * speed + drag.N_turn * u) * v
