"""The vehicle: inertia and drag of a torpedo-shaped AUV in the horizontal plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from auv_gym.intervals import is_float
from auv_gym.namespaces import Number


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


LARGEST = 1e9
"""Largest parameter of a vehicle, in its SI unit."""
MIN_MASS_RATIO = 1.01
"""Least m22/m11: the planner's memory is (m22 - m11)/d22, and its integration step must follow."""


@dataclass(frozen=True)
class Vehicle:
    """Parameters of (2): rigid body plus added mass, linear drag and, beyond the paper, quadratic drag.

    Drag enters as `-(d11 + X_uu |u|) u` in surge, in sway and yaw with their coefficients; all are magnitudes.

    Raises:
        ValueError: a parameter is not finite, too large or negative, a mass or linear drag is zero, or
            m22 is not above m11: the section III planner and the sideslip it describes need a slender hull.
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

    def __post_init__(self) -> None:
        for name, value in zip(Coefficients._fields, self.coefficients, strict=True):
            if not is_float(value) or not abs(value) <= LARGEST:
                raise ValueError(f"vehicle parameter {name} is {value!r}; it must be a finite number up to {LARGEST:g}")
            if name[0] in "md" and value <= 0:
                raise ValueError(f"vehicle parameter {name} is {value!r}; inertia and linear drag must be positive")
            if value < 0:
                raise ValueError(f"vehicle parameter {name} is {value!r}; quadratic drag is a magnitude, 0 or more")
        if self.m22 < MIN_MASS_RATIO * self.m11:
            raise ValueError(
                f"m22 = {self.m22!r} kg is not above m11 = {self.m11!r} kg, by a factor of {MIN_MASS_RATIO} at least; "
                "a torpedo-shaped hull adds more mass in sway than in surge, and only then the plan is stable"
            )

    @property
    def coefficients(self) -> Coefficients:
        """The parameters as the tuple that the equations unpack."""
        return Coefficients(self.m11, self.m22, self.m33, self.d11, self.d22, self.d33, self.X_uu, self.Y_vv, self.N_rr)


PAPER_VEHICLE = Vehicle(m11=215.0, m22=265.0, m33=80.0, d11=70.0, d22=100.0, d33=50.0)
"""The vehicle of Repoulias and Papadopoulos (2005), who take it from their reference [7], very likely K. Y. Pettersen
and O. Egeland, "Time-varying exponential stabilization of the position and attitude of an underactuated autonomous
underwater vehicle", IEEE Trans. Automatic Control 44(1):112-115, 1999. The paper's printed results fix every
parameter but m33, which only its figures depend on."""

VEHICLES = {"paper": PAPER_VEHICLE}
"""Vehicles by name: add an entry here to use it as `gym.make(..., vehicle=NAME)`."""
