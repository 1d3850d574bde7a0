"""The vehicle: inertia and drag of a torpedo-shaped AUV in the horizontal plane."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from auv_gym.physics.intervals import check_number, is_float
from auv_gym.physics.namespaces import Number


class Coefficients(NamedTuple):
    """What the equations of motion need of a vehicle: floats, or rows of shape (N,) for N vehicles at once."""

    m11: Number  # [kg]
    m22: Number  # [kg]
    m33: Number  # [kg m^2]
    d11: Number  # [kg/s]
    d22: Number  # [kg/s]
    d33: Number  # [kg m^2/s]
    X_uu: Number  # [kg/m]
    Y_vv: Number  # [kg/m]
    N_rr: Number  # [kg m^2]
    Y_uv: Number  # [kg/m]
    Y_ur: Number  # [kg]
    N_uv: Number  # [kg]
    N_ur: Number  # [kg m]

    @property
    def without_lift(self) -> tuple[Number, ...]:
        """The coefficients without lift; with them `dynamics.rates` does not compute it."""
        return self[: len(self) - len(_LIFT)]

    @property
    def slip_mass(self) -> Number:
        """Inertia [kg] against a change of the sideslip: m22 - m11, and what lift adds to it."""
        return self.m22 - (self.m11 - self.Y_ur)


_LIFT = Coefficients._fields[-4:]
"""The parameters of the lift, which grow with the surge velocity."""
_SPEEDS = (1e-2, 16.0)
"""Least and largest design speed of a vehicle [m/s]."""
LARGEST_PARAMETER = 1e11
"""Largest parameter of a vehicle, in its SI unit."""
MIN_MASS_RATIO = 1.01
"""Least m22/m11: the planner's memory is (m22 - m11)/d22, and its integration step must follow."""


@dataclass(frozen=True)
class Vehicle:
    """Parameters of (2): rigid body plus added mass, linear drag and, beyond the paper, quadratic drag; a design speed.

    Drag enters as `-(d11 + X_uu |u|) u` in surge, in sway and yaw with their coefficients; all are magnitudes. Lift of
    body and fins adds `-Y_uv |u| v + Y_ur |u| r` to the sway force and `N_uv |u| v - N_ur |u| r` to the yaw moment; a
    fin behind the centre has all four positive. Beyond the Munk moment (m11 - m22) u v, which (2c) has by itself.
    The design speed acts on nothing: with mass and length it is the measure that scenarios and gains are scaled by, see
    `auv_gym.physics.units`.

    Raises:
        ValueError: a parameter is not finite or too large, one but Y_ur or N_uv is negative, a mass or linear drag is
            zero, m22 is not above m11 and m11 - Y_ur, since the section III planner and the sideslip it describes need
            a slender body, or the design speed is outside of `_SPEEDS`.
    """

    m11: float  # [kg] surge inertia, added mass included
    m22: float  # [kg] sway inertia, added mass included
    m33: float  # [kg m^2] yaw inertia, added mass included
    d11: float  # [kg/s] linear surge drag
    d22: float  # [kg/s] linear sway drag
    d33: float  # [kg m^2/s] linear yaw drag
    X_uu: float = 0.0  # [kg/m] quadratic surge drag
    Y_vv: float = 0.0  # [kg/m] quadratic sway drag
    N_rr: float = 0.0  # [kg m^2] quadratic yaw drag
    Y_uv: float = 0.0  # [kg/m] lift: sway drag that grows with the surge velocity
    Y_ur: float = 0.0  # [kg] lift: sway force of a yaw rate
    N_uv: float = 0.0  # [kg] lift: yaw moment of a sway velocity, positive where it turns the bow into the flow
    N_ur: float = 0.0  # [kg m] lift: yaw drag that grows with the surge velocity
    speed: float = 1.5  # [m/s] the fastest that it is to cruise at

    def __post_init__(self) -> None:
        for name, value in zip(Coefficients._fields, self.coefficients, strict=True):
            if not is_float(value) or not abs(value) <= LARGEST_PARAMETER:
                raise ValueError(
                    f"vehicle parameter {name} is {value!r}; it must be a finite number up to {LARGEST_PARAMETER:g}"
                )
            if name[0] in "md" and value <= 0:
                raise ValueError(f"vehicle parameter {name} is {value!r}; inertia and linear drag must be positive")
            if value < 0 and name not in ("Y_ur", "N_uv"):
                raise ValueError(f"vehicle parameter {name} is {value!r}; drag is a magnitude, 0 or more")
        if self.m22 < (1 - 1e-12) * MIN_MASS_RATIO * max(self.m11, self.m11 - self.Y_ur):  # in any units
            raise ValueError(
                f"m22 = {self.m22!r} kg is not above m11 = {self.m11!r} kg, by a factor of {MIN_MASS_RATIO} at least, "
                f"nor may Y_ur = {self.Y_ur!r} kg bring m11 - Y_ur there; "
                "a torpedo-shaped hull adds more mass in sway than in surge, and only then the plan is stable"
            )
        check_number("vehicle speed", self.speed, *_SPEEDS)

    @classmethod
    def unchecked(cls, coefficients: Coefficients) -> Vehicle:
        """Return a vehicle of parameters that are known to be valid, or of rows of those of N vehicles."""
        vehicle = object.__new__(cls)
        vehicle.__dict__.update(zip(Coefficients._fields, coefficients, strict=True), speed=cls.speed)
        return vehicle

    @property
    def length(self) -> float:
        """Its length scale sqrt(m33/m11) [m], a radius of gyration."""
        return math.sqrt(self.m33 / self.m11)

    @property
    def time(self) -> float:
        """Its time scale [s]: the length scale over the design speed."""
        return self.length / self.speed

    @property
    def has_lift(self) -> bool:
        """Whether lift acts on it."""
        return any(getattr(self, name) for name in _LIFT)

    @property
    def coefficients(self) -> Coefficients:
        """The parameters as the tuple that the equations unpack."""
        return Coefficients(*(getattr(self, name) for name in Coefficients._fields))


PAPER_VEHICLE = Vehicle(m11=215.0, m22=265.0, m33=80.0, d11=70.0, d22=100.0, d33=50.0)
"""The vehicle of Repoulias and Papadopoulos (2005), who take it from their reference [7], very likely K. Y. Pettersen
and O. Egeland, "Time-varying exponential stabilization of the position and attitude of an underactuated autonomous
underwater vehicle", IEEE Trans. Automatic Control 44(1):112-115, 1999. The paper's printed results fix every
parameter but m33, which only its figures depend on."""

VEHICLES = {"paper": PAPER_VEHICLE}
"""Vehicles by name: add an entry here to use it as `gym.make(..., vehicle=NAME)`."""
