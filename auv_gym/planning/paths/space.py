"""Paths in space: planar paths with a height, and a knot. Any other `SpacePath` can be planned as well.

A height is a formula of time with three derivatives: `Climb`, `Steps`, `Wave` or `Through`. A helix is a circle that
climbs, a lawnmower pattern with `Steps` covers one depth after another, a line with one step dives and levels out, and
`Legs` with `Through` pass waypoints with depths.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from auv_gym.physics.intervals import check_number
from auv_gym.physics.namespaces import Array
from auv_gym.planning.paths.base import OfPath, Path, validate


class SpacePath(ABC):
    """A position in space with three continuous time derivatives on a domain of times."""

    @property
    @abstractmethod
    def speed(self) -> float:
        """Nominal speed [m/s], the scale of the path's velocities."""

    @property
    def start(self) -> float:
        """First time of the domain [s]; -inf if it is unbounded."""
        return -math.inf

    @property
    def end(self) -> float:
        """Last time of the domain [s]; inf if it is unbounded."""
        return math.inf

    @abstractmethod
    def derivatives(self, t: Array) -> Array:
        """Return position [m] and its first three time derivatives at times of shape (T,), an array (4, 3, T)."""


class Height(Protocol):
    """A height above the planar path."""

    def derivatives(self, t: Array) -> Array:
        """Return the height [m] and its first three time derivatives at times of shape (T,), an array (4, T)."""


@dataclass(frozen=True)
class Climb:
    """A constant rate of climb: z = rate t."""

    rate: float  # [m/s], negative for a dive

    def __post_init__(self) -> None:
        validate(self)

    def derivatives(self, t: Array) -> Array:
        """See `Height.derivatives`."""
        return np.stack((self.rate * t, np.full_like(t, self.rate), 0 * t, 0 * t))


@dataclass(frozen=True)
class Steps:
    """Changes of height, z = sum of rise (1 + tanh((t - middle) / time)) / 2; the largest rate is rise / (2 time).

    Raises:
        ValueError: a step is no pair of finite numbers, or the time is not positive.
    """

    steps: Sequence[tuple[float, float]]  # [s] middle and [m] rise of each step
    time: float  # [s] a quarter of a step's time from 2 % to 98 % of the rise

    def __post_init__(self) -> None:
        check_number("Steps time", self.time, 1e-6, 1e6)
        for step in self.steps:
            if len(step) != 2 or not all(map(math.isfinite, step)):
                raise ValueError(f"Steps: a step must be a time [s] and a rise [m], got {step!r}")

    def derivatives(self, t: Array) -> Array:
        """See `Height.derivatives`."""
        rows = np.zeros((4, *np.shape(t)))
        for middle, rise in self.steps:
            T, h = np.tanh((t - middle) / self.time), 0.5 * rise
            slope = 1 - T * T
            shape = 1 + T, slope / self.time, -2 * T * slope / self.time**2, 2 * slope * (3 * T * T - 1) / self.time**3
            rows += h * np.stack(shape)
        return rows


@dataclass(frozen=True)
class Wave:
    """An oscillation of the height: z = A sin(wt + phase)."""

    amplitude: float  # A [m]
    frequency: float  # w [rad/s]
    phase: float = 0.0  # [rad] at t = 0

    def __post_init__(self) -> None:
        validate(self)

    def derivatives(self, t: Array) -> Array:
        """See `Height.derivatives`."""
        return _sine(self.amplitude, self.frequency, self.phase, t)


@dataclass(frozen=True)
class Through:
    """Heights at given times, joined by constant rates, z = z_k + rate_k (t - t_k); the rate changes within `blend`.

    A change of the rate follows S(x) = 1/2 + 15/16 (x - 2/3 x^3 + 1/5 x^5), with x the time from t_k over `blend`, from
    -1 to 1. So the height has three continuous derivatives. Before the first and after the last time the rate is that
    of the nearest leg. In the middle of a change the height differs from the given one by 5/32 of `blend` times the
    change of the rate.

    Raises:
        ValueError: there are not as many heights as times, fewer than two, the times do not increase by twice `blend`
            or more, or a number is not finite.
    """

    times: Sequence[float]  # [s]
    heights: Sequence[float]  # [m]
    blend: float  # [s] half of the time in which the rate changes

    def __post_init__(self) -> None:
        check_number("Through blend", self.blend, 1e-6, 1e6)
        times, heights = np.array(self.times, dtype=np.float64), np.array(self.heights, dtype=np.float64)
        if not (times.shape == heights.shape and times.ndim == 1 and len(times) >= 2):
            raise ValueError(
                f"Through needs as many heights as times, two or more; there are {heights.size} and {times.size}"
            )
        if not (np.isfinite(times).all() and np.isfinite(heights).all()):
            raise ValueError("Through: times and heights must be finite")
        if (shortest := float(np.diff(times).min())) < 2 * self.blend:
            raise ValueError(
                f"Through: two times are {shortest:.4g} s apart; twice the blend is {2 * self.blend:.4g} s"
            )
        object.__setattr__(self, "times", tuple(times.tolist()))
        object.__setattr__(self, "heights", tuple(heights.tolist()))

    def derivatives(self, t: Array) -> Array:
        """See `Height.derivatives`."""
        times, h = np.array(self.times), self.blend
        rates = np.diff(self.heights) / np.diff(times)
        rows = np.stack((self.heights[0] + rates[0] * (t - times[0]), np.full_like(t, rates[0]), 0 * t, 0 * t))
        for middle, change in zip(times[1:-1], np.diff(rates), strict=True):
            after = (t - middle) / h
            x = np.clip(after, -1.0, 1.0)
            bump = 1 - x * x
            ramp = 5 / 32 + x / 2 + 15 / 16 * (x**2 / 2 - x**4 / 6 + x**6 / 30) + np.maximum(after - 1.0, 0.0)
            step = 0.5 + 15 / 16 * (x - 2 / 3 * x**3 + x**5 / 5)
            rows += change * np.stack((h * ramp, step, 15 / 16 * bump**2 / h, -15 / 4 * x * bump / h**2))
        return rows


def _sine(amplitude: float, frequency: float, phase: float, t: Array) -> Array:
    """Return a sine and its first three derivatives, shape (4, T)."""
    angle = frequency * t + phase
    s, c = np.sin(angle), np.cos(angle)
    shape = np.stack((s, frequency * c, -(frequency**2) * s, -(frequency**3) * c))
    return np.asarray(amplitude * shape)


@dataclass(frozen=True)
class WithHeight(OfPath, SpacePath):
    """A planar path with a height: a `SpacePath`. The speed of the planar path is the level part of the speed."""

    path: Path
    height: Height
    z0: float = 0.0  # [m] height at which that of `height` is 0

    def derivatives(self, t: Array) -> Array:
        """See `SpacePath.derivatives`."""
        t = np.asarray(t, dtype=np.float64)
        level, height = np.asarray(self.path.derivatives(t)), self.height.derivatives(t)
        height[0] += self.z0
        return np.concatenate((level, height[:, None]), axis=1)


@dataclass(frozen=True)
class Trefoil(SpacePath):
    """A trefoil knot: x = A (sin th + 2 sin 2 th), y = A (cos th - 2 cos 2 th), z = -B sin 3 th, th = wt + phase."""

    size: float  # A [m]
    height: float  # B [m]
    frequency: float  # w [rad/s]
    phase: float = 0.0  # [rad] th at t = 0
    x0: float = 0.0  # [m] centre
    y0: float = 0.0  # [m]
    z0: float = 0.0  # [m]

    @property
    def speed(self) -> float:
        """Root mean square of the speed [m/s]."""
        return abs(self.frequency) * math.sqrt(17 * self.size**2 + 4.5 * self.height**2)

    def __post_init__(self) -> None:
        validate(self, positive=("size",), nonzero=("frequency",))

    def derivatives(self, t: Array) -> Array:
        """See `SpacePath.derivatives`."""
        A, t, quarter = self.size, np.asarray(t, dtype=np.float64), 0.5 * math.pi

        def part(amplitude: float, multiple: int, lead: float = 0.0) -> Array:
            return _sine(amplitude, multiple * self.frequency, multiple * self.phase + lead, t)

        x, y = part(A, 1) + part(2 * A, 2), part(A, 1, quarter) - part(2 * A, 2, quarter)
        curve = np.stack((x, y, part(-self.height, 3)), axis=1)
        curve[0] += np.reshape((self.x0, self.y0, self.z0), (3, *(1,) * t.ndim))
        return curve


HEIGHTS: dict[str, type] = {"climb": Climb, "steps": Steps, "wave": Wave, "through": Through}
"""The heights by their names in scenarios."""
SPACE_PATHS: dict[str, type] = {"with_height": WithHeight, "trefoil": Trefoil}
"""The families of paths in space by their names in scenarios."""
