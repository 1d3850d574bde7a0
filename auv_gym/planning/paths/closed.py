"""Families with a closed-form position: line, circle, sine, ellipse, figure-eight."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing_extensions import Self

from auv_gym.physics.intervals import Uniform, by_library, signed
from auv_gym.physics.namespaces import Namespace, Number
from auv_gym.planning.paths.base import Family, Pairs, validate

_sqrt = by_library(math.sqrt)


@dataclass(frozen=True)
class Line(Family):
    """A straight line at constant speed: x = U t."""

    speed: float  # U [m/s]
    x0: float = 0.0  # [m] position at t = 0
    y0: float = 0.0  # [m]
    heading: float = 0.0  # [rad] direction of travel

    def __post_init__(self) -> None:
        validate(self, positive=("speed",))

    def formulas(self, t: Number, ns: Namespace) -> Pairs:
        """See `Family.formulas`."""
        U = self.speed
        return (U * t, 0.0), (U, 0.0), (0.0, 0.0), (0.0, 0.0)

    @classmethod
    def drawn(cls, speed: Number, turn_rate: float, uniform: Uniform) -> Self:  # noqa: ARG003, the families share the signature
        """Return a line in a random direction; the turn rate is not used."""
        return cls.member(speed, heading=2 * math.pi * uniform())


@dataclass(frozen=True)
class Circle(Family):
    """A circle at constant speed: x = U/w sin wt, y = U/w (1 - cos wt)."""

    speed: float  # U [m/s]
    turn_rate: float  # w [rad/s], negative for clockwise
    x0: float = 0.0  # [m] position at t = 0
    y0: float = 0.0  # [m]
    heading: float = 0.0  # [rad] direction of travel at t = 0

    def __post_init__(self) -> None:
        validate(self, positive=("speed",), nonzero=("turn_rate",))

    def formulas(self, t: Number, ns: Namespace) -> Pairs:
        """See `Family.formulas`."""
        U, w = self.speed, self.turn_rate
        s, c = ns.sin(w * t), ns.cos(w * t)
        x1, y1 = U * c, U * s
        return (y1 / w, (U - x1) / w), (x1, y1), (-w * y1, w * x1), (-(w**2) * x1, -(w**2) * y1)

    @classmethod
    def drawn(cls, speed: Number, turn_rate: float, uniform: Uniform) -> Self:
        """Return a circle with a random direction and a turn rate of .4 ... 1 `turn_rate` of random sign."""
        heading, magnitude = 2 * math.pi * uniform(), turn_rate * (0.4 + 0.6 * uniform())
        return cls.member(speed, signed(magnitude, uniform), heading=heading)


@dataclass(frozen=True)
class Sine(Family):
    """A sine wave about a straight axis: x = U t, y = A sin(wt + phase)."""

    speed: float  # U [m/s] along the axis
    amplitude: float  # A [m]
    frequency: float  # w [rad/s]
    phase: float = 0.0  # [rad] at t = 0
    x0: float = 0.0  # [m] point of the axis at t = 0
    y0: float = 0.0  # [m]
    heading: float = 0.0  # [rad] direction of the axis

    def __post_init__(self) -> None:
        validate(self, positive=("speed",))

    def formulas(self, t: Number, ns: Namespace) -> Pairs:
        """See `Family.formulas`."""
        U, A, w = self.speed, self.amplitude, self.frequency
        theta = w * t + self.phase
        s, c = ns.sin(theta), ns.cos(theta)
        return (U * t, A * s), (U, A * w * c), (0.0, -A * w**2 * s), (0.0, -A * (w * w * w) * c)

    @classmethod
    def drawn(cls, speed: Number, turn_rate: float, uniform: Uniform) -> Self:
        """Return a sine with random direction, frequency and phase; its largest turn rate is .8 `turn_rate`."""
        heading, w, phase = 2 * math.pi * uniform(), 2 * turn_rate * (0.4 + 0.6 * uniform()), 2 * math.pi * uniform()
        return cls.member(speed, 0.8 * turn_rate * speed / w**2, w, phase, heading=heading)


@dataclass(frozen=True)
class Ellipse(Family):
    """An ellipse at constant eccentric rate: x = a cos th, y = b sin th, th = wt + phase."""

    semi_x: float  # a [m]
    semi_y: float  # b [m]
    frequency: float  # w [rad/s], negative for clockwise
    phase: float = 0.0  # [rad] th at t = 0
    x0: float = 0.0  # [m] centre
    y0: float = 0.0  # [m]
    heading: float = 0.0  # [rad] direction of the semi-axis a

    def __post_init__(self) -> None:
        validate(self, positive=("semi_x", "semi_y"), nonzero=("frequency",))

    @property
    def speed(self) -> float:
        """Root mean square speed [m/s]."""
        speed: float = abs(self.frequency) * (0.5 * (self.semi_x**2 + self.semi_y**2)) ** 0.5
        return speed

    def formulas(self, t: Number, ns: Namespace) -> Pairs:
        """See `Family.formulas`."""
        a, b, w = self.semi_x, self.semi_y, self.frequency
        theta = w * t + self.phase
        s, c = ns.sin(theta), ns.cos(theta)
        x, y = a * c, b * s
        x1, y1 = -a * w * s, b * w * c
        return (x, y), (x1, y1), (-(w**2) * x, -(w**2) * y), (-(w**2) * x1, -(w**2) * y1)

    @classmethod
    def drawn(cls, speed: Number, turn_rate: float, uniform: Uniform) -> Self:
        """Return a random ellipse: b/a is .5 ... 1, the largest turn rate |w| a/b is .4 ... 1 `turn_rate`."""
        heading, ratio = 2 * math.pi * uniform(), 0.5 + 0.5 * uniform()
        w = ratio * turn_rate * (0.4 + 0.6 * uniform())
        a = speed / (w * _sqrt(0.5 * (1 + ratio**2)))
        return cls.member(a, ratio * a, signed(w, uniform), 2 * math.pi * uniform(), heading=heading)


@dataclass(frozen=True)
class FigureEight(Family):
    """The lemniscate of Gerono: x = A sin th, y = A sin th cos th, th = wt + phase.

    Its speed is .66 ... 1.41 A|w|, its turn rate at most 3.18 |w|.
    """

    size: float  # A [m] half its length
    frequency: float  # w [rad/s]
    phase: float = 0.0  # [rad] th at t = 0
    x0: float = 0.0  # [m] crossing point
    y0: float = 0.0  # [m]
    heading: float = 0.0  # [rad] direction of the long axis

    def __post_init__(self) -> None:
        validate(self, positive=("size",), nonzero=("frequency",))

    @property
    def speed(self) -> float:
        """Nominal speed [m/s], 1.2 A|w|."""
        return 1.2 * self.size * abs(self.frequency)

    def formulas(self, t: Number, ns: Namespace) -> Pairs:
        """See `Family.formulas`."""
        A, w = self.size, self.frequency
        theta = w * t + self.phase
        s, c = ns.sin(theta), ns.cos(theta)
        x, y = A * s, A * s * c
        x1, y1 = A * w * c, A * w * (1 - 2 * s * s)
        return (x, y), (x1, y1), (-(w**2) * x, -4 * w**2 * y), (-(w**2) * x1, -4 * w**2 * y1)

    @classmethod
    def drawn(cls, speed: Number, turn_rate: float, uniform: Uniform) -> Self:
        """Return a random figure-eight; its largest turn rate is 1.22 ... 1.75 `turn_rate`, in the lobes."""
        heading, w = 2 * math.pi * uniform(), 0.55 * turn_rate * (0.7 + 0.3 * uniform())
        return cls.member(speed / (1.2 * w), w, 2 * math.pi * uniform(), heading=heading)


PAPER_CIRCLE = Circle(speed=0.1, turn_rate=-0.01, y0=10.0)
"""The paper's example: x_R = 10 sin(.01 t), y_R = 10 cos(.01 t), clockwise at 0.1 m/s."""
