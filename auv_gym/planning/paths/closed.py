"""Families with closed formulas: line, circle, sine, ellipse, figure-eight.

Each is elementwise: its fields may be arrays of shape (N,), made by `auv_gym.planning.paths.stack`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

if TYPE_CHECKING:
    from typing_extensions import Self

from auv_gym.physics.namespaces import Array
from auv_gym.planning.paths.base import UniformRange, place, validate


@dataclass(frozen=True)
class Line:
    """A straight line at constant speed: x = U t."""

    speed: float  # U [m/s]
    x0: float = 0.0  # [m] position at t = 0
    y0: float = 0.0  # [m]
    heading: float = 0.0  # [rad] direction of travel

    start: ClassVar[float] = -math.inf
    end: ClassVar[float] = math.inf

    def __post_init__(self) -> None:
        validate(self, positive=("speed",))

    def derivatives(self, t: Array) -> Array:
        """See `Path.derivatives`."""
        U = self.speed
        return place(self, (U * t, 0.0), (U, 0.0), (0.0, 0.0), (0.0, 0.0))

    @classmethod
    def drawn(cls, speed: float, turn_rate: float, uniform: UniformRange) -> Self:  # noqa: ARG003, the families share the signature
        """Draw a direction; a line does not turn."""
        return cls(speed, heading=2 * math.pi * uniform())


@dataclass(frozen=True)
class Circle:
    """A circle at constant speed: x = U/w sin wt, y = U/w (1 - cos wt)."""

    speed: float  # U [m/s]
    turn_rate: float  # w [rad/s], negative for clockwise
    x0: float = 0.0  # [m] position at t = 0
    y0: float = 0.0  # [m]
    heading: float = 0.0  # [rad] direction of travel at t = 0

    start: ClassVar[float] = -math.inf
    end: ClassVar[float] = math.inf

    def __post_init__(self) -> None:
        validate(self, positive=("speed",), nonzero=("turn_rate",))

    def derivatives(self, t: Array) -> Array:
        """See `Path.derivatives`."""
        U, w = self.speed, self.turn_rate
        s, c = np.sin(w * t), np.cos(w * t)
        x1, y1 = U * c, U * s
        return place(self, (y1 / w, (U - x1) / w), (x1, y1), (-w * y1, w * x1), (-(w**2) * x1, -(w**2) * y1))

    @classmethod
    def drawn(cls, speed: float, turn_rate: float, uniform: UniformRange) -> Self:
        """Draw a direction, a turn rate of .4 ... 1 times the largest one, and its sign."""
        heading, magnitude = 2 * math.pi * uniform(), turn_rate * (0.4 + 0.6 * uniform())
        return cls(speed, magnitude if uniform() < 0.5 else -magnitude, heading=heading)


@dataclass(frozen=True)
class Sine:
    """A sine wave about a straight axis: x = U t, y = A sin(wt + phase)."""

    speed: float  # U [m/s] along the axis
    amplitude: float  # A [m]
    frequency: float  # w [rad/s]
    phase: float = 0.0  # [rad] at t = 0
    x0: float = 0.0  # [m] point of the axis at t = 0
    y0: float = 0.0  # [m]
    heading: float = 0.0  # [rad] direction of the axis

    start: ClassVar[float] = -math.inf
    end: ClassVar[float] = math.inf

    def __post_init__(self) -> None:
        validate(self, positive=("speed",))

    def derivatives(self, t: Array) -> Array:
        """See `Path.derivatives`."""
        U, A, w = self.speed, self.amplitude, self.frequency
        theta = w * t + self.phase
        s, c = np.sin(theta), np.cos(theta)
        return place(self, (U * t, A * s), (U, A * w * c), (0.0, -A * w**2 * s), (0.0, -A * w**3 * c))

    @classmethod
    def drawn(cls, speed: float, turn_rate: float, uniform: UniformRange) -> Self:
        """Draw direction, frequency and phase; the largest turn rate, at the crests, is .8 `turn_rate`."""
        heading, w, phase = 2 * math.pi * uniform(), 2 * turn_rate * (0.4 + 0.6 * uniform()), 2 * math.pi * uniform()
        return cls(speed, 0.8 * turn_rate * speed / w**2, w, phase, heading=heading)


@dataclass(frozen=True)
class Ellipse:
    """An ellipse at constant eccentric rate: x = a cos th, y = b sin th, th = wt + phase."""

    semi_x: float  # a [m]
    semi_y: float  # b [m]
    frequency: float  # w [rad/s], negative for clockwise
    phase: float = 0.0  # [rad] th at t = 0
    x0: float = 0.0  # [m] centre
    y0: float = 0.0  # [m]
    heading: float = 0.0  # [rad] direction of the semi-axis a

    start: ClassVar[float] = -math.inf
    end: ClassVar[float] = math.inf

    def __post_init__(self) -> None:
        validate(self, positive=("semi_x", "semi_y"), nonzero=("frequency",))

    @property
    def speed(self) -> float:
        """Root mean square speed [m/s]."""
        speed: float = abs(self.frequency) * (0.5 * (self.semi_x**2 + self.semi_y**2)) ** 0.5
        return speed

    def derivatives(self, t: Array) -> Array:
        """See `Path.derivatives`."""
        a, b, w = self.semi_x, self.semi_y, self.frequency
        theta = w * t + self.phase
        s, c = np.sin(theta), np.cos(theta)
        x, y = a * c, b * s
        x1, y1 = -a * w * s, b * w * c
        return place(self, (x, y), (x1, y1), (-(w**2) * x, -(w**2) * y), (-(w**2) * x1, -(w**2) * y1))

    @classmethod
    def drawn(cls, speed: float, turn_rate: float, uniform: UniformRange) -> Self:
        """Draw direction, b/a in .5 ... 1, largest turn rate |w| a/b in .4 ... 1 `turn_rate`, its sign and phase."""
        heading, ratio = 2 * math.pi * uniform(), 0.5 + 0.5 * uniform()
        w = ratio * turn_rate * (0.4 + 0.6 * uniform())
        a = speed / (w * math.sqrt(0.5 * (1 + ratio**2)))
        return cls(a, ratio * a, w if uniform() < 0.5 else -w, 2 * math.pi * uniform(), heading=heading)


@dataclass(frozen=True)
class FigureEight:
    """The lemniscate of Gerono: x = A sin th, y = A sin th cos th, th = wt + phase.

    Its speed is .66 ... 1.41 A|w|, its turn rate at most 3.18 |w|.
    """

    size: float  # A [m] half its length
    frequency: float  # w [rad/s]
    phase: float = 0.0  # [rad] th at t = 0
    x0: float = 0.0  # [m] crossing point
    y0: float = 0.0  # [m]
    heading: float = 0.0  # [rad] direction of the long axis

    start: ClassVar[float] = -math.inf
    end: ClassVar[float] = math.inf

    def __post_init__(self) -> None:
        validate(self, positive=("size",), nonzero=("frequency",))

    @property
    def speed(self) -> float:
        """Nominal speed [m/s], 1.2 A|w|."""
        return 1.2 * self.size * abs(self.frequency)

    def derivatives(self, t: Array) -> Array:
        """See `Path.derivatives`."""
        A, w = self.size, self.frequency
        theta = w * t + self.phase
        s, c = np.sin(theta), np.cos(theta)
        x, y = A * s, A * s * c
        x1, y1 = A * w * c, A * w * (1 - 2 * s * s)
        return place(self, (x, y), (x1, y1), (-(w**2) * x, -4 * w**2 * y), (-(w**2) * x1, -4 * w**2 * y1))

    @classmethod
    def drawn(cls, speed: float, turn_rate: float, uniform: UniformRange) -> Self:
        """Draw direction, frequency and phase; the lobes turn fastest, at 1.22 ... 1.75 `turn_rate`."""
        heading, w = 2 * math.pi * uniform(), 0.55 * turn_rate * (0.7 + 0.3 * uniform())
        return cls(speed / (1.2 * w), w, 2 * math.pi * uniform(), heading=heading)


PAPER_CIRCLE = Circle(speed=0.1, turn_rate=-0.01, y0=10.0)
"""The paper's example: x_R = 10 sin(.01 t), y_R = 10 cos(.01 t), clockwise at 0.1 m/s."""
