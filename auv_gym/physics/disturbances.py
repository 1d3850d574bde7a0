"""The disturbances: ocean current, waves as body forces, and a mismatch between true and nominal vehicle.

Each disturbance has a `Random...` class, the distribution in a scenario. Its `draw` returns the disturbance of one
episode, or of N episodes with rows of shape (N,).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from auv_gym.physics.intervals import Interval, Uniform, by_library, check_interval, check_number, draw
from auv_gym.physics.namespaces import Number
from auv_gym.physics.vehicle import LARGEST_PARAMETER, MIN_MASS_RATIO, PARAMETER_NAMES, CrossTerms, Vehicle

_cos, _sin = by_library(math.cos), by_library(math.sin)


@dataclass(frozen=True)
class Current:
    """A current: a mean that may turn, a first-order Gauss-Markov gust on each axis, and a shear in space.

    The gust is an Ornstein-Uhlenbeck process smoothed by a first-order filter, as Fossen (2021, section 10.3) models
    slowly varying currents. The shear is a parallel flow whose speed is a sine across it, so that it is free of
    divergence. Its wave length is large, so the current at the centre of the vehicle acts. The change of the water's
    velocity along the path of the vehicle does not enter the inertia forces, see `dynamics`.
    """

    V_x: float = 0.0  # [m/s] mean, in the world
    V_y: float = 0.0  # [m/s]
    gust: float = 0.0  # [m/s] standard deviation of the process on each axis, before smoothing
    gust_time: float = 20.0  # [s] its correlation time
    smoothing: float = 2.0  # [s] time constant of the smoothing filter
    cap: float = math.inf  # largest speed of mean plus gust, as a fraction of the path's slowest speed
    turn: float = 0.0  # [rad/s] rate of turn of the mean
    shear: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)  # see `simulation.Shear`


@dataclass(frozen=True)
class RandomCurrent:
    """Distribution of the current; speeds are fractions of the path's nominal speed, or [m/s] if not `relative`."""

    speed: Interval = 0.0  # mean speed
    direction: Interval = (-math.pi, math.pi)  # [rad] direction in which the mean flows
    gust: float = 0.0  # standard deviation of the gust on each axis
    gust_time: float = 20.0  # [s]
    smoothing: float = 2.0  # [s]
    cap: float = math.inf  # largest speed of mean plus gust, always as a fraction of the path's slowest speed
    relative: bool = True
    turn: Interval = 0.0  # [rad/s] how fast the mean turns
    shear: Interval = 0.0  # amplitude of a parallel flow that varies like a sine across its direction
    wavelength: Interval = 40.0  # [m] of the shear

    def __post_init__(self) -> None:
        check_interval("current speed", self.speed, 0, 1e3)
        check_interval("current turn", self.turn, -10, 10)
        check_interval("current shear", self.shear, 0, 1e3)
        check_interval("current wavelength", self.wavelength, 1.0, 1e6)
        check_interval("current direction", self.direction, -1e3, 1e3)
        check_number("current gust", self.gust, 0, 1e3)
        check_number("current gust_time", self.gust_time, 1e-3, 1e6)
        check_number("current smoothing", self.smoothing, 0, 1e6)
        check_number("current cap", self.cap, 0)
        if not isinstance(self.relative, bool):
            raise ValueError(f"current relative is {self.relative!r}; it must be true or false")

    def draw(self, uniform: Uniform, speed: Number) -> Current:
        """Return one current for a path of this nominal speed [m/s]."""
        unit = speed if self.relative else 1.0
        V, direction = draw(self.speed, uniform) * unit, draw(self.direction, uniform)
        drawn: dict[str, Any] = {}
        if self.turn != 0:
            drawn["turn"] = draw(self.turn, uniform)
        if self.shear != 0:
            amplitude, across = draw(self.shear, uniform) * unit, 2 * math.pi * uniform()
            k, phase = 2 * math.pi / draw(self.wavelength, uniform), 2 * math.pi * uniform()
            c, s = _cos(across), _sin(across)
            drawn["shear"] = (-amplitude * s, amplitude * c, k * c, k * s, phase)
        return Current(
            V * _cos(direction),
            V * _sin(direction),
            self.gust * unit,
            self.gust_time,
            self.smoothing,
            self.cap,
            **drawn,
        )


@dataclass(frozen=True)
class Waves:
    """First-order wave forces on the vehicle: a sum of sines of equal amplitude on each axis."""

    surge: float  # [N] root mean square
    sway: float  # [N]
    yaw: float  # [N m]
    frequencies: tuple[float, ...]  # [rad/s]
    phases: tuple[tuple[float, ...], ...]  # [rad], shape (3, number of frequencies)


@dataclass(frozen=True)
class RandomWaves:
    """Distribution of the waves. The RMS forces are fractions of d11 U, d22 U and d33 U / (1 m) at path speed U."""

    surge: float = 0.0
    sway: float = 0.0
    yaw: float = 0.0
    band: tuple[float, float] = (0.5, 1.1)  # [rad/s]; one frequency is drawn in each of `components` equal parts
    components: int = 6

    def __post_init__(self) -> None:
        for name in ("surge", "sway", "yaw"):
            check_number(f"waves {name}", getattr(self, name), 0, 1e3)
        if not isinstance(self.band, tuple):
            raise ValueError(f"waves band is {self.band!r}; it must be a pair (low, high)")
        check_interval("waves band", self.band, 1e-3, 1e2)
        if isinstance(self.components, bool) or not isinstance(self.components, int) or not 1 <= self.components <= 12:
            raise ValueError(f"waves components is {self.components!r}; it must be an integer in [1, 12]")

    def draw(self, uniform: Uniform, speed: Number, vehicle: Vehicle) -> Waves:
        """Return one sea state for a path of this nominal speed [m/s] and the vehicle whose drag scales it."""
        low, high = self.band
        n = self.components
        frequencies = tuple(low + (high - low) * (j + uniform()) / n for j in range(n))
        phases = tuple(tuple(2 * math.pi * uniform() for _ in range(n)) for _ in range(3))
        return Waves(
            self.surge * vehicle.d11 * speed,
            self.sway * vehicle.d22 * speed,
            self.yaw * vehicle.d33 * speed,
            frequencies,
            phases,
        )


@dataclass(frozen=True)
class RandomMismatch:
    """Distribution of the true vehicle about the nominal one, as factors; m22 stays above m11.

    The factor of a drag applies to its linear and quadratic part, and to the lift, which grows with the surge velocity.
    Cross-flow has the smaller one of the factors of sway and yaw, so that damping takes power in every draw; the surge
    loss in turns has the factor of the surge drag.

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
        lowest = self.ratio[0] if isinstance(self.ratio, tuple) else self.ratio
        for row in self._rows(vehicle):
            m11, m22, *_ = row
            least = MIN_MASS_RATIO * (1 + 1e-9) * m11 / m22
            if lowest < least:
                raise ValueError(
                    f"mismatch ratio may fall to {lowest:g}; for m22 > {MIN_MASS_RATIO} m11 it must be at least "
                    f"{least:.4g}"
                )
            for end in (0, 1):
                true = self._true(row, [_ends(interval)[end] for interval in self._intervals])
                Vehicle(**dict(zip(PARAMETER_NAMES, true, strict=False)))

    def draw(self, uniform: Uniform, vehicle: Vehicle) -> Vehicle:
        """Return one true vehicle."""
        row: Sequence[Number] = vehicle.all_coefficients
        if count := len(self.vehicles):
            index = np.minimum(np.asarray(uniform()) * count, count - 1).astype(np.int64)
            row = [x.item() if x.ndim == 0 else x for x in np.array(self.vehicles).T[:, index]]
        return Vehicle.unchecked(self._true(row, [draw(interval, uniform) for interval in self._intervals]))

    def extremes(self, vehicle: Vehicle) -> tuple[Any, ...]:
        """Return the stiffest vehicles of the distribution, as rows: least masses with all extremes of drag.

        Much quadratic drag gives a fast decay; little drag allows high speeds.
        """
        mass, ratio, m33, *drags = map(_ends, self._intervals)
        corners = np.array([*itertools.product(mass[:1], ratio, m33[:1], *drags)]).T
        several = [np.broadcast_arrays(*self._true(row, corners)) for row in self._rows(vehicle)]
        return tuple(map(np.concatenate, zip(*several, strict=True)))

    @property
    def _intervals(self) -> tuple[Interval, ...]:
        """The intervals of the factors, in the order of `_true`."""
        return self.mass, self.ratio, self.m33, self.d11, self.d22, self.d33, self.quadratic

    def _rows(self, vehicle: Vehicle) -> Sequence[Sequence[float]]:
        """Return the parameters of the ensemble, or of the nominal vehicle."""
        return self.vehicles or (vehicle.all_coefficients,)

    def _true(self, row: Sequence[Number], factors: Iterable[Number]) -> tuple[Number, ...]:
        """Return the parameters of a vehicle with factors applied: floats or rows, as `Vehicle.all_coefficients`."""
        m11, m22, m33, d11, d22, d33, X_uu, Y_vv, N_rr, Y_uv, Y_ur, N_uv, N_ur, *cross = row
        mass, ratio, inertia, surge, sway, yaw, q = factors
        more = [q * drag for drag in self.quadratic_drag]
        if cross:
            *damping, eps = cross
            least = sway + (yaw - sway) * (yaw < sway)
            names = CrossTerms._fields[:-1]
            scaled = [c * (surge if name[0] == "X" else least) for name, c in zip(names, damping, strict=True)]
            cross = [*scaled, eps]
        return (
            m11 * mass, m22 * mass * ratio, m33 * inertia, d11 * surge, d22 * sway, d33 * yaw,
            X_uu * surge + more[0], Y_vv * sway + more[1], N_rr * yaw + more[2],
            Y_uv * sway, Y_ur, N_uv, N_ur * yaw, *cross,
        )  # fmt: skip


def _ends(interval: Interval) -> tuple[float, float]:
    return interval if isinstance(interval, tuple) else (interval, interval)
