"""A mismatch between the true and the nominal vehicle; lift and cross terms of a vehicle."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from auv_gym.effects.base import At, Effect
from auv_gym.physics.intervals import Interval, Uniform, check_interval, check_number, draw
from auv_gym.physics.namespaces import Number
from auv_gym.physics.vehicle import LARGEST_PARAMETER, MIN_MASS_RATIO, PARAMETER_NAMES, CrossTerms, Vehicle


@dataclass(frozen=True)
class RandomMismatch:
    """Distribution of the true vehicle about the nominal one, as factors; m22 stays above m11.

    The factor of a drag applies to its linear and quadratic part, and to the lift, which grows with the surge velocity.
    Cross-flow has the smaller one of the factors of sway and yaw, so that damping takes power in every draw; the surge
    loss in turns has the factor of the surge drag.

    Y_ur, N_uv and X_vr have the factors of m11, m22 - m11 and m22, since sources count added mass in these terms, up to
    all of it: a Munk moment that N_uv cancels (M. M. Munk, NACA report 184, 1924) stays cancelled in every draw. What
    is left of a sum m11 - Y_ur, m22 - m11 - N_uv or m22 - X_vr, with the lift in it, scales as a whole, so its sign
    never changes.

    With `vehicles` the true vehicle is one of an ensemble, and the factors apply to it. A row has the parameters of
    `physics.units.DIMENSIONS` in their order, `Vehicle.all_coefficients`: 13 numbers, or all 25 if the nominal vehicle
    has cross terms.
    """

    mass: Interval = 1.0  # on m11 and m22 together
    ratio: Interval = 1.0  # on m22/m11
    m33: Interval = 1.0
    d11: Interval = 1.0
    d22: Interval = 1.0
    d33: Interval = 1.0
    quadratic: Interval = 0.0  # adds this multiple of `quadratic_drag`
    quadratic_drag: tuple[float, float, float] = (100.0, 200.0, 100.0)  # [kg/m], [kg/m], [kg m^2]
    vehicles: tuple[tuple[float, ...], ...] = ()  # the ensemble; none: the nominal vehicle

    def __post_init__(self) -> None:
        for name in ("mass", "ratio", "m33", "d11", "d22", "d33"):
            check_interval(f"mismatch {name}", getattr(self, name), 1e-3, 1e3)
        check_interval("mismatch quadratic", self.quadratic, 0, 1e6)
        if len(self.quadratic_drag) != 3:
            raise ValueError(f"mismatch quadratic_drag is {self.quadratic_drag!r}; it must be three numbers")
        for value in self.quadratic_drag:
            check_number("mismatch quadratic_drag", value, 0, LARGEST_PARAMETER)

    def check(self, vehicle: Vehicle) -> None:
        """Raise ValueError if a draw for this vehicle can be invalid, for instance with m22 too close to m11."""
        size = len(vehicle.all_coefficients)
        if wrong := [len(row) for row in self.vehicles if len(row) != size]:
            raise ValueError(f"mismatch vehicles has a row of {wrong[0]} numbers; for this vehicle it must have {size}")
        for row in self._rows(vehicle):
            if _ends(self.ratio)[0] < (least := self._least_ratio(row)):
                raise ValueError(
                    f"mismatch ratio may fall to {_ends(self.ratio)[0]:g}; for m22 > {MIN_MASS_RATIO} m11 it must be "
                    f"at least {least:.4g}, since the vehicle has m22/m11 = {row[1] / row[0]:.4g}"
                )
            for end in (0, 1):
                true = self._true(row, [_ends(interval)[end] for interval in self._intervals])
                Vehicle(**dict(zip(PARAMETER_NAMES, true, strict=False)))

    def cut(self, vehicle: Vehicle) -> RandomMismatch:
        """Return the distribution with m22/m11 cut to what a vehicle allows, for a vehicle that is hardly slender."""
        if _ends(self.ratio)[0] >= (least := max(map(self._least_ratio, self._rows(vehicle)))):
            return self
        low, high = (max(end, least) for end in _ends(self.ratio))
        return replace(self, ratio=(low, high) if low < high else low)

    def draw(self, uniform: Uniform, vehicle: Vehicle) -> Vehicle:
        """Return one true vehicle."""
        row: Sequence[Number] = vehicle.all_coefficients
        if count := len(self.vehicles):
            index = np.minimum(np.asarray(uniform()) * count, count - 1).astype(np.int64)
            row = [x.item() if x.ndim == 0 else x for x in np.array(self.vehicles).T[:, index]]
        return Vehicle.unchecked(self._true(row, [draw(interval, uniform) for interval in self._intervals]))

    def like(self, nominal: Vehicle, true: Vehicle, other: Vehicle) -> Vehicle:
        """Return another plane of a vehicle with the factors that have led from a nominal to a true plane."""
        names = ("m11", "m22", "m33", "d11", "d22", "d33")
        mass, sway, inertia, *drags = (getattr(true, name) / getattr(nominal, name) for name in names)
        q = (true.X_uu - nominal.X_uu * drags[0]) / self.quadratic_drag[0] if self.quadratic_drag[0] else 0.0
        found = Vehicle.unchecked(self._true(other.all_coefficients, [mass, sway / mass, inertia, *drags, q]))
        shared = ("m11", "d11", "X_uu", "eps", "speed")  # without a residue of rounding
        found.__dict__.update({name: getattr(true, name) for name in shared})
        return found

    def extremes(self, vehicle: Vehicle) -> tuple[Any, ...]:
        """Return the stiffest vehicles of the distribution, as rows: least m33 with all other extremes.

        Much quadratic drag gives a fast decay; little drag allows high speeds. Small masses give a fast decay, large
        ones a large Munk moment.
        """
        mass, ratio, m33, *drags = map(_ends, self._intervals)
        corners = np.array([*itertools.product(mass, ratio, m33[:1], *drags)]).T
        several = [np.broadcast_arrays(*self._true(row, corners)) for row in self._rows(vehicle)]
        return tuple(map(np.concatenate, zip(*several, strict=True)))

    @property
    def _intervals(self) -> tuple[Interval, ...]:
        """The intervals of the factors, in the order of `_true`."""
        return self.mass, self.ratio, self.m33, self.d11, self.d22, self.d33, self.quadratic

    def _rows(self, vehicle: Vehicle) -> Sequence[Sequence[float]]:
        """Return the parameters of the ensemble, or of the nominal vehicle."""
        return self.vehicles or (vehicle.all_coefficients,)

    def _least_ratio(self, row: Sequence[float]) -> float:
        """Return the least factor on m22/m11 with which the parameters are those of a `Vehicle`."""
        m11, m22, Y_ur = row[0], row[1], row[10]
        return MIN_MASS_RATIO * (1 + 1e-9) * max(m11, m11 - Y_ur) / m22

    def _true(self, row: Sequence[Number], factors: Iterable[Number]) -> tuple[Number, ...]:
        """Return the parameters of a vehicle with factors applied: floats or rows, as `Vehicle.all_coefficients`."""
        m11, m22, m33, d11, d22, d33, X_uu, Y_vv, N_rr, Y_uv, Y_ur, N_uv, N_ur, *cross = row
        mass, ratio, inertia, surge, sway, yaw, q = factors
        more = [q * drag for drag in self.quadratic_drag]
        if cross:
            *damping, eps = cross
            least = sway + (yaw - sway) * (yaw < sway)
            names = CrossTerms._fields[:-1]
            factor = {"X_vv": surge, "X_vr": mass * ratio, "X_rr": surge}
            scaled = [c * factor.get(name, least) for name, c in zip(names, damping, strict=True)]
            cross = [*scaled, eps]
        munk = mass * ((m22 * ratio - m11) / (m22 - m11))
        return (
            m11 * mass, m22 * mass * ratio, m33 * inertia, d11 * surge, d22 * sway, d33 * yaw,
            X_uu * surge + more[0], Y_vv * sway + more[1], N_rr * yaw + more[2],
            Y_uv * sway, Y_ur * mass, N_uv * munk, N_ur * yaw, *cross,
        )  # fmt: skip


class Lift(Effect):
    """Lift of body and fins, which grows with the surge velocity, see `Vehicle`."""

    what = "a vehicle with lift"
    entry = ("vehicle.has_lift", False)

    @classmethod
    def there(cls, episode: Any) -> bool:
        """Return whether the true vehicle has lift, without cross terms, which include it."""
        return bool(episode.vehicle.has_lift) and not episode.vehicle.has_cross_terms

    @staticmethod
    def vehicle(_: Sequence[Number], at: At) -> Sequence[Number]:
        """Return all coefficients."""
        coefficients: Sequence[Number] = at.vehicle
        return coefficients


class CrossFlow(Effect):
    """Cross terms of the damping, and the side force of a rudder, see `Vehicle`."""

    what = "a vehicle with cross terms"
    entry = drawn = ("vehicle.has_cross_terms", False)
    numbers = "episode.vehicle.cross_terms"
    Constants = CrossTerms

    @staticmethod
    def vehicle(_: Sequence[Number], at: At) -> Sequence[Number]:
        """Return all coefficients with the cross terms."""
        return *at.vehicle, *at.own


def _ends(interval: Interval) -> tuple[float, float]:
    return interval if isinstance(interval, tuple) else (interval, interval)
