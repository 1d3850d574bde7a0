"""Paths in space: planar paths with a height, and a knot. Any other `SpacePath` can be planned as well.

A height is a formula of time with three derivatives: `Climb`, `Steps` or `Wave`. A helix is a circle that climbs, a
lawnmower pattern with `Steps` covers one depth after another, and a line with one step dives and levels out.
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
from auv_gym.planning.paths.base import Path, validate


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


def _sine(amplitude: float, frequency: float, phase: float, t: Array) -> Array:
    """Return a sine and its first three derivatives, shape (4, T)."""
    angle = frequency * t + phase
    s, c = np.sin(angle), np.cos(angle)
    shape = np.stack((s, frequency * c, -(frequency**2) * s, -(frequency**3) * c))
    return np.asarray(amplitude * shape)


@dataclass(frozen=True)
class WithHeight(SpacePath):
    """A planar path with a height: a `SpacePath`. The speed of the planar path is the level part of the speed."""

    path: Path
    height: Height
    z0: float = 0.0  # [m] height at which that of `height` is 0

    @property
    def speed(self) -> float:
        """Nominal speed of the planar path [m/s]."""
        return self.path.speed

    @property
    def start(self) -> float:
        """First time of the domain [s]."""
        return self.path.start

    @property
    def end(self) -> float:
        """Last time of the domain [s]."""
        return self.path.end

    def derivatives(self, t: Array) -> Array:
        """Return position [m] and its first three time derivatives at times of shape (T,), an array (4, 3, T)."""
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
        """Return position [m] and its first three time derivatives at times of shape (T,), an array (4, 3, T)."""
        A, t, quarter = self.size, np.asarray(t, dtype=np.float64), 0.5 * math.pi

        def part(amplitude: float, multiple: int, lead: float = 0.0) -> Array:
            return _sine(amplitude, multiple * self.frequency, multiple * self.phase + lead, t)

        x, y = part(A, 1) + part(2 * A, 2), part(A, 1, quarter) - part(2 * A, 2, quarter)
        curve = np.stack((x, y, part(-self.height, 3)), axis=1)
        curve[0] += np.reshape((self.x0, self.y0, self.z0), (3, *(1,) * t.ndim))
        return curve


HEIGHTS: dict[str, type] = {"climb": Climb, "steps": Steps, "wave": Wave}
"""The heights by their names in scenarios."""
SPACE_PATHS: dict[str, type] = {"with_height": WithHeight, "trefoil": Trefoil}
"""The families of paths in space by their names in scenarios."""
