"""Propeller and rudder at the stern: the forces that revolutions, or a thrust, and a rudder angle bring about.

In the manner of the MMG model (H. Yasukawa and Y. Yoshimura, "Introduction of MMG standard method for ship maneuvering
predictions", J. Mar. Sci. Technol. 20:37-52, 2015), in its simplest form: the rudder works in the wake of the body, and
the propeller speeds that up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from auv_gym.physics.dynamics import Load
from auv_gym.physics.intervals import check_number
from auv_gym.physics.namespaces import Number
from auv_gym.physics.vehicle import LARGEST_PARAMETER

_TINY = 1e-8  # [m^2/s^2] square of an inflow at which the root still has a slope


class Stern(NamedTuple):
    """Coefficients of a propeller and of a rudder or fins: floats, or rows of shape (N,)."""

    T_nn: Number  # [kg m] thrust per squared revolutions
    T_nu: Number  # [kg] thrust that revolutions lose per surge speed
    side: Number  # [kg/m] side force of the rudder per squared speed of its inflow and sine of its angle
    arm: Number  # [m] distance of the rudder behind the origin
    drag: Number  # [kg/m] drag of the rudder per squared speed of its inflow and squared sine of its angle
    wash: Number  # [m/kg] squared speed that the propeller's slipstream adds to the inflow per thrust ahead
    wake: Number  # [1] squared speed that the inflow gains per speed ahead and sideways speed at the stern
    straight: Number  # [1] share of the sideways speed at the stern that reaches the rudder
    uneven: Number  # [1] the same of its magnitude, since a propeller turns one way
    neutral: Number  # [rad] angle of the rudder at which it gives no side force


def thrust(n: Number, u: Number, stern: Stern) -> Number:
    """Return the thrust [N] of n revolutions [1/s] at a surge speed u [m/s] through water (Fossen 2021, chapter 9)."""
    return (stern.T_nn * n - stern.T_nu * u) * abs(n)


def stern_load(T: Number, angle: Number, u: Number, v: Number, r: Number, stern: Stern, ns: Any = math) -> Load:
    """Return surge force [N], sway force [N] and yaw moment [N m] of propeller and rudder.

    A positive angle turns to positive r. With a thrust T ahead and a sideways speed of the stern w = v - arm r the
    square of the inflow is q = u |u| + wash T + wake |u w|, since sideslip at the stern moves the rudder partly out
    of the wake of the body. The side force is side (q sin(angle - neutral) - sqrt(q) (straight w + uneven |w|)): the
    slip turns the inflow. Without a propeller the second part is lift, see `auv_gym.physics.vehicle.Vehicle`.

    Args:
        T: thrust that acts on the vessel [N].
        angle: of the rudder [rad].
        u: surge velocity through water [m/s].
        v: sway velocity through water [m/s].
        r: yaw rate [rad/s].
        stern: the coefficients.
        ns: the namespace of the numbers.
    """
    w = v - stern.arm * r
    inflow = u * abs(u) + stern.wash * 0.5 * (T + abs(T)) + stern.wake * abs(u * w)
    sine = ns.sin(angle - stern.neutral)
    slip = ns.sqrt(abs(inflow) + _TINY) * (stern.straight * w + stern.uneven * abs(w))
    force = stern.side * (inflow * sine - slip)
    return T - stern.drag * inflow * sine * sine, -force, stern.arm * force


@dataclass(frozen=True)
class Shaft:
    """A vehicle's propeller and rudder with their largest commands: the table [shaft] of its file.

    Raises:
        ValueError: a number is not finite, or a largest command is not positive.
    """

    n_max: float  # [1/s] largest revolutions of the propeller
    angle_max: float  # [rad] largest angle of the rudder
    T_nn: float  # [kg m] the coefficients of a `Stern`, with their units
    side: float  # [kg/m]
    arm: float  # [m]
    T_nu: float = 0.0  # [kg]
    drag: float = 0.0  # [kg/m]
    wash: float = 0.0  # [m/kg]
    wake: float = 0.0  # [1]
    straight: float = 0.0  # [1]
    uneven: float = 0.0  # [1]
    neutral: float = 0.0  # [rad]

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            low = 1e-9 if name.endswith("_max") else -LARGEST_PARAMETER
            check_number(f"shaft {name}", getattr(self, name), low, LARGEST_PARAMETER)

    @property
    def stern(self) -> Stern:
        """The coefficients."""
        return Stern(*(getattr(self, name) for name in Stern._fields))

    def forces(self, command: Sequence[Number], u: Number, v: Number, r: Number, ns: Any) -> tuple[Number, Number]:
        """Return surge force [N] and yaw moment [N m] of commands in [-1, 1]: shares of `n_max` and `angle_max`.

        The side force follows from the moment, see `auv_gym.physics.vehicle.Vehicle`. A positive angle turns to
        positive r.

        Args:
            command: of the revolutions and of the angle.
            u: surge velocity through water [m/s].
            v: sway velocity of the origin through water [m/s].
            r: yaw rate [rad/s].
            ns: the namespace of the numbers.
        """
        n, angle = (ns.clip(c, -1.0, 1.0) * most for c, most in zip(command, (self.n_max, self.angle_max), strict=True))
        stern = self.stern
        X, _, N = stern_load(thrust(n, u, stern), angle, u, v, r, stern, ns)
        return X, N
