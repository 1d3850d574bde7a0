"""The vehicle: inertia and drag of a torpedo-shaped AUV in the horizontal plane."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import NamedTuple

import numpy as np

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
    def has_cross_terms(self) -> bool:
        """Whether cross terms follow, see `with_names`."""
        return len(self) > len(Coefficients._fields)

    @property
    def acting(self) -> tuple[Number, ...]:
        """The row itself, as `Vehicle.acting`."""
        return self

    @property
    def slip_mass(self) -> Number:
        """Inertia [kg] against a change of the sideslip: m22 - m11, and what lift adds to it."""
        return self.m22 - (self.m11 - self.Y_ur)


class CrossTerms(NamedTuple):
    """Cross terms of damping, the surge force that turns take, the tracked point: floats, or rows of shape (N,)."""

    X_vv: Number  # [kg/m]
    X_vr: Number  # [kg]
    X_rr: Number  # [kg m]
    Y_rv: Number  # [kg]
    Y_vr: Number  # [kg]
    Y_rr: Number  # [kg m]
    N_vv: Number  # [kg]
    N_rv: Number  # [kg m]
    N_vr: Number  # [kg m]
    d23: Number  # [kg m/s]
    d32: Number  # [kg m/s]
    eps: Number  # [m]

    def slopes(self, Y_vv: Number, N_rr: Number) -> tuple[tuple[Number, ...], tuple[Number, ...]]:
        """Return what quadratic damping takes of the power, over |v|^3, as polynomials of |r/v|.

        Constant terms come first. The first one holds where v and r have one sign, the second one where they differ.
        """
        odd_v, odd_r = self.Y_vr + self.N_vv, self.Y_rr + self.N_rv
        return (
            (Y_vv, self.Y_rv + odd_v, self.N_vr + odd_r, N_rr),
            (Y_vv, self.Y_rv - odd_v, self.N_vr - odd_r, N_rr),
        )


PARAMETER_NAMES = (*Coefficients._fields, *CrossTerms._fields)
"""Names of the parameters, in the order of `Vehicle.all_coefficients`."""


def with_names(rows: Sequence[Number]) -> Coefficients:
    """Return rows of `Vehicle.all_coefficients` with the names of `Coefficients`; cross terms follow without names."""
    return tuple.__new__(Coefficients, rows)


_LIFT = Coefficients._fields[-4:]
"""The parameters of the lift, which grow with the surge velocity."""
_COEFFICIENTS, _CROSS_TERMS = attrgetter(*Coefficients._fields), attrgetter(*CrossTerms._fields)
SIGNED_PARAMETERS = ("Y_ur", "N_uv", *CrossTerms._fields[:-1])
"""Parameters that may be negative."""
_SPEEDS = (1e-2, 16.0)
"""Least and largest design speed of a vehicle [m/s]."""
LARGEST_PARAMETER = 1e16
"""Largest parameter of a vehicle, in its SI unit: a loaded tanker of 400 m has m33 of about 1e13 kg m^2."""
_LINEARISE = "; drag that is purely quadratic can be linearised at a speed v that matters: d22 = Y_vv v, Y_vv = 0"
_MAGNITUDE = "; tables of derivatives give X_u, Y_v and N_r with a minus sign: write the magnitude"
MIN_MASS_RATIO = 1.01
"""Least m22/m11: the planner's memory is (m22 - m11)/d22, and its integration step must follow."""


@dataclass(frozen=True)
class Vehicle:
    """Parameters of (2): rigid body plus added mass, linear drag and, beyond the paper, quadratic drag; a design speed.

    Drag enters as `-(d11 + X_uu |u|) u` in surge, in sway and yaw with their coefficients; all are magnitudes. Lift of
    body and fins adds `-Y_uv |u| v + Y_ur |u| r` to the sway force and `N_uv |u| v - N_ur |u| r` to the yaw moment; a
    fin behind the centre has all four positive. These terms do not include the
    Munk moment (m11 - m22) u v, which is part of (2c).

    Cross-flow takes `Y_rv |r| v + Y_vr |v| r + Y_rr |r| r` from the sway force and
    `N_vv |v| v + N_rv |r| v + N_vr |v| r` from the yaw moment, beside Y_vv and N_rr; turns take
    `X_vv v^2 + X_vr v r + X_rr r^2` from the surge force. They are the hydrodynamic derivatives of T. I. Fossen,
    Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed., 2021, chapter 6, with the other sign: Y_rv is
    his -Y_|r|v. Each may have either sign. Linear cross terms take `d23 r` from the sway force and `d32 v` from the yaw
    moment.

    A rudder that is `arm` behind the origin gives a side force -F_r / arm with its torque F_r. The point that is
    eps = m33 / (m22 arm) ahead of the origin, the centre of percussion, does not feel this force. It is the tracked
    point: positions x, y and the sway velocity v + eps r are those of this point, and only drag and lift act on it
    sideways (K. D. Do and J. Pan, Control of Ships and Underwater Vehicles, Springer 2009). eps is 0 for a pure torque.
    A yaw moment from outside, such as that of waves, comes without that side force, see `dynamics.from_outside`.

    The design speed acts on nothing: with mass and length it is the measure that scenarios and gains are scaled by, see
    `auv_gym.physics.units`.

    Raises:
        ValueError: a parameter is not finite or too large, one but `SIGNED_PARAMETERS` is negative, a mass or linear
            drag is zero, m22 is not above m11 and m11 - Y_ur, since the section III planner and the sideslip it
            describes need a slender body, damping is not dissipative, or the design speed is outside of `_SPEEDS`.
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
    X_vv: float = 0.0  # [kg/m] surge drag of a sway velocity
    X_vr: float = 0.0  # [kg] surge drag of a sway velocity in a turn
    X_rr: float = 0.0  # [kg m] surge drag of a yaw rate
    Y_rv: float = 0.0  # [kg] cross-flow: sway drag that grows with the yaw rate
    Y_vr: float = 0.0  # [kg] cross-flow: sway force of a yaw rate that grows with the sway velocity
    Y_rr: float = 0.0  # [kg m] cross-flow: sway force of a yaw rate
    N_vv: float = 0.0  # [kg] cross-flow: yaw moment of a sway velocity
    N_rv: float = 0.0  # [kg m] cross-flow: yaw moment of a sway velocity that grows with the yaw rate
    N_vr: float = 0.0  # [kg m] cross-flow: yaw drag that grows with the sway velocity
    d23: float = 0.0  # [kg m/s] linear sway force of a yaw rate
    d32: float = 0.0  # [kg m/s] linear yaw moment of a sway velocity
    eps: float = 0.0  # [m] distance of the tracked point ahead of the origin; m33 / (m22 arm) for a rudder

    def __post_init__(self) -> None:
        for name, value in (*self.coefficients._asdict().items(), *self.cross_terms._asdict().items()):
            if not is_float(value) or not abs(value) <= LARGEST_PARAMETER:
                raise ValueError(
                    f"vehicle parameter {name} is {value!r}; it must be a finite number up to {LARGEST_PARAMETER:g}"
                )
            if name[0] in "md" and name in Coefficients._fields and value <= 0:
                raise ValueError(
                    f"vehicle parameter {name} is {value!r}; inertia and linear drag must be positive"
                    + (_MAGNITUDE if value < 0 else _LINEARISE) * (name[0] == "d")
                )
            if value < 0 and name not in SIGNED_PARAMETERS:
                raise ValueError(f"vehicle parameter {name} is {value!r}; drag is a magnitude, 0 or more")
        if self.m22 < (1 - 1e-12) * MIN_MASS_RATIO * max(self.m11, self.m11 - self.Y_ur):  # in any units
            raise ValueError(
                f"m22 = {self.m22!r} kg is not above m11 = {self.m11!r} kg; with Y_ur = {self.Y_ur!r} kg it must be at "
                f"least {MIN_MASS_RATIO} m11 and {MIN_MASS_RATIO} (m11 - Y_ur). A slender vehicle has more added mass "
                "in sway than in surge, and only then the plan is stable. Simulators that leave added mass out, such "
                "as Gazebo by default, give m11 = m22: add it, for a slender vehicle about 0.9 times the mass in sway"
            )
        check_number("vehicle speed", self.speed, *_SPEEDS)
        if self.has_cross_terms:
            self._check_damping()

    def _check_damping(self) -> None:
        """Raise ValueError if damping is not dissipative at some sway velocity and yaw rate."""
        if (self.d23 + self.d32) ** 2 > 4 * self.d22 * self.d33:
            raise ValueError(
                f"linear damping of sway and yaw is not dissipative: |d23 + d32| is {abs(self.d23 + self.d32):.4g}; "
                f"it must be at most 2 sqrt(d22 d33) = {2 * math.sqrt(self.d22 * self.d33):.4g} kg m/s"
            )
        size = self.length
        for slope in self.cross_terms.slopes(self.Y_vv, self.N_rr):
            power = np.array([c / size**k for k, c in enumerate(slope)])  # a polynomial of |r/v| times the length
            turning = np.roots((power * range(4))[:0:-1]).real  # where it may be least
            ratios = np.array([1e6, *turning[turning > 0]])
            if (np.polyval(power[::-1], ratios) < -1e-9 * np.polyval(abs(power[::-1]), ratios)).any():
                raise ValueError(
                    "the quadratic damping of sway and yaw is not dissipative: v times the sway force and r times the "
                    "yaw moment that Y_vv, N_rr and cross-flow take must not add up to less than 0 at any v and r"
                )

    @classmethod
    def unchecked(cls, parameters: Sequence[Number]) -> Vehicle:
        """Return a vehicle of `all_coefficients` that are known to be valid, or of rows of those of N vehicles."""
        vehicle = object.__new__(cls)
        vehicle.__dict__.update(zip(PARAMETER_NAMES, parameters, strict=False), speed=cls.speed)
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
    def has_cross_terms(self) -> bool:
        """Whether it has any cross terms; laws ask it in each step."""
        return any(_CROSS_TERMS(self))

    @property
    def cross_terms(self) -> CrossTerms:
        """The cross terms of damping, the surge loss in turns and the tracked point."""
        return CrossTerms._make(_CROSS_TERMS(self))

    @property
    def acting(self) -> tuple[Number, ...]:
        """The shortest row of coefficients that `dynamics.rates` takes for it."""
        return self.all_coefficients if self.has_lift or self.has_cross_terms else self.coefficients.without_lift

    @property
    def all_coefficients(self) -> tuple[Number, ...]:
        """The coefficients, and the cross terms behind them if there are any."""
        return (*self.coefficients, *self.cross_terms) if self.has_cross_terms else self.coefficients

    @property
    def coefficients(self) -> Coefficients:
        """The parameters as the tuple that the equations unpack."""
        return Coefficients._make(_COEFFICIENTS(self))


PAPER_VEHICLE = Vehicle(m11=215.0, m22=265.0, m33=80.0, d11=70.0, d22=100.0, d33=50.0)
"""The vehicle of Repoulias and Papadopoulos (2005), who take it from their reference [7], very likely K. Y. Pettersen
and O. Egeland, "Time-varying exponential stabilization of the position and attitude of an underactuated autonomous
underwater vehicle", IEEE Trans. Automatic Control 44(1):112-115, 1999. The paper's printed results fix every
parameter but m33, which only its figures depend on."""

PAPER_2007 = replace(PAPER_VEHICLE, X_uu=100.0, Y_vv=200.0, N_rr=100.0)
"""The vehicle of the paper with quadratic drag, as in public codes that follow F. Repoulias and E. Papadopoulos,
"Planar trajectory planning and tracking control design for underactuated AUVs", Ocean Engineering 34, 2007. The text of
that article was not at hand, so no number of it is claimed."""
VEHICLES = {"paper": PAPER_VEHICLE, "paper-2007": PAPER_2007}
"""Vehicles by name: add an entry here to use it as `gym.make(..., vehicle=NAME)`."""
