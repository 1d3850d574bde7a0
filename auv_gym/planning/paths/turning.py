"""Families defined by their course over time, with the position as an integral: lawnmower, random smooth curve."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from numpy.polynomial.legendre import leggauss

if TYPE_CHECKING:
    from typing_extensions import Self

from auv_gym.codegen.elementary import polynomial
from auv_gym.physics.errors import to_world
from auv_gym.physics.intervals import Uniform, signed
from auv_gym.physics.namespaces import ARRAYS, Array, Indices, Namespace, Number
from auv_gym.planning.paths.base import Family, Pairs, as_array, placed, validate


def _turn_coefficients() -> Array:
    """Return power series in q = (2z - 1)^2 of the position along a half turn with heading pi S(z), z in [0, 1].

    int_0^z cos(pi S) = sum_k c[k, 0] q^k,   int_0^z sin(pi S) = sum_k c[k, 1] (1 + (2z - 1) q^k),   c of shape (19, 2).
    The integrands are interpolated by polynomials of degree 36, which is exact to round-off.
    """

    def angle(v: Array) -> Array:
        return math.pi / 16 * (15 * v - 10 * v**3 + 3 * v**5)  # pi (S - 1/2)

    along = Chebyshev.interpolate(lambda v: -0.5 * np.sin(angle(v)), 36).convert(kind=Polynomial).integ(lbnd=-1)
    across = Chebyshev.interpolate(lambda v: 0.5 * np.cos(angle(v)), 36).convert(kind=Polynomial).integ(lbnd=-1)
    return np.stack((along.coef[:-1:2], across.coef[1::2]), axis=1)


_TURN = _turn_coefficients()
_ALONG, _ACROSS = _TURN.T.tolist()
_TURN_WIDTH = 2 * float(_TURN[:, 1].sum())  # int_0^1 sin(pi S) = .40756: width of a turn over its arc length


@dataclass(frozen=True)
class Lawnmower(Family):
    """A survey at constant speed: parallel straight legs, connected by half turns to alternating sides.

    The heading in a turn is pi S(z), with the fraction z of the turn's duration and S = z^3 (10 - 15 z + 6 z^2). It is
    twice continuously differentiable. The pattern advances by `spacing` at each turn, also for negative times.
    """

    speed: float  # U [m/s]
    leg: float  # [m] length of a leg
    spacing: float  # [m] distance between legs, negative if the first turn is to starboard (clockwise)
    x0: float = 0.0  # [m] start of the first leg, at t = 0
    y0: float = 0.0  # [m]
    heading: float = 0.0  # [rad] direction of the first leg

    def __post_init__(self) -> None:
        validate(self, positive=("speed", "leg"), nonzero=("spacing",))

    @property
    def turn_time(self) -> float:
        """Duration T of a half turn [s]; its largest turn rate is 15 pi / (8 T)."""
        return abs(self.spacing) / (_TURN_WIDTH * self.speed)

    def formulas(self, t: Number, ns: Namespace) -> Pairs:
        """See `Family.formulas`."""
        U, T, straight = self.speed, self.turn_time, self.leg / self.speed
        port = ns.where(self.spacing < 0, -1.0, 1.0)
        k = ns.floor(t / (straight + T))  # legs completed
        back = k - 2 * ns.floor(k / 2)  # 1 on legs in the opposite direction, else 0
        ahead = 1 - 2 * back
        since = t - k * (straight + T)  # [s] since the start of this leg
        z = ns.clip((since - straight) / T, 0.0, 1.0)
        v, rest = 2 * z - 1, z * (1 - z)
        angle = math.pi * z * z * z * (10 - 15 * z + 6 * z * z)
        rate, acceleration = 30 * math.pi / T * rest**2, -60 * math.pi / T**2 * rest * v
        along, across = polynomial(v * v, _ALONG), polynomial(v * v, _ACROSS)
        s, c = U * ns.sin(angle), U * ns.cos(angle)
        x = back * self.leg + ahead * (U * ns.clip(since, -math.inf, straight) + U * T * along)
        y = self.spacing * (k + 0.5 + v * across / _TURN_WIDTH)
        x1, y1 = ahead * c, port * s
        x2, y2 = -ahead * rate * s, port * rate * c
        x3, y3 = -ahead * acceleration * s - rate**2 * x1, port * acceleration * c - rate**2 * y1
        return (x, y), (x1, y1), (x2, y2), (x3, y3)

    @classmethod
    def drawn(cls, speed: Number, turn_rate: float, uniform: Uniform) -> Self:
        """Return a random survey: largest turn rate .7 ... 1 `turn_rate`, leg .2 ... 1 spacing."""
        heading, turn_time = 2 * math.pi * uniform(), 15 * math.pi / (8 * turn_rate * (0.7 + 0.3 * uniform()))
        spacing = _TURN_WIDTH * speed * turn_time
        side = signed(spacing, uniform)
        return cls.member(speed, spacing * (0.2 + 0.8 * uniform()), side, heading=heading)


@dataclass(frozen=True)
class RandomSmooth(Family):
    """A path with speed V = U (1 + e sin(w0 t + p0)) and turn rate sum_i A_i sin(w_i t + p_i), i = 1, 2, 3.

    The heading has a closed form. The position is integrated numerically.
    """

    speed: float  # U [m/s] mean speed
    turn_rates: tuple[float, float, float]  # A_i [rad/s]
    frequencies: tuple[float, float, float]  # w_i [rad/s]
    phases: tuple[float, float, float]  # p_i [rad]
    speed_variation: float = 0.15  # e, in [0, 1)
    speed_frequency: float = 0.05  # w0 [rad/s]
    speed_phase: float = 0.0  # p0 [rad]
    x0: float = 0.0  # [m] position at t = 0
    y0: float = 0.0  # [m]
    heading: float = 0.0  # [rad] direction of travel at t = 0

    def __post_init__(self) -> None:
        triples = ("turn_rates", "frequencies", "phases")
        validate(self, positive=("speed", "frequencies"), triples=triples)
        if not (np.all(np.greater_equal(self.speed_variation, 0)) and np.all(np.less(self.speed_variation, 1))):
            raise ValueError(f"RandomSmooth: speed_variation must be in [0, 1), got {self.speed_variation!r}")
        for name in triples:
            if isinstance(getattr(self, name), list):  # from JSON
                object.__setattr__(self, name, tuple(getattr(self, name)))

    @property
    def numbers(self) -> Sequence[float]:
        """The arguments of the compiled formulas: four of the speed, three of each sine, and `longest_step`."""
        sines = zip(self.turn_rates, self.frequencies, self.phases, strict=True)
        speed = self.speed, self.speed_variation, self.speed_frequency, self.speed_phase
        return [*speed, *(number for sine in sines for number in sine), self.longest_step]

    @property
    def longest_step(self) -> float:
        """Largest integration step of the position [s]: .02 rad of the fastest sine or turn."""
        rates = (sum(map(abs, self.turn_rates)), *self.frequencies, abs(self.speed_frequency))
        return 0.02 / (max(rates) if isinstance(rates[0], float) else reduce(np.maximum, rates))

    def formulas(self, t: Number, ns: Namespace) -> Pairs:
        """See `Family.formulas`; the position, which is an integral, is 0."""
        course: tuple[Number, Number, Number] = (0.0, 0.0, 0.0)
        for sine in zip(self.turn_rates, self.frequencies, self.phases, strict=True):
            course = with_sine(course, sine, t, ns)
        return ((0.0, 0.0), *self.rates(course, t, ns))

    def rates(self, course: Sequence[Number], t: Number, ns: Namespace) -> Pairs:
        """Return velocity and its first two time derivatives, for the course [rad] and its two time derivatives."""
        beta, rate, acceleration = course
        theta = self.speed_frequency * t + self.speed_phase
        swing = self.speed * self.speed_variation
        s, c = swing * ns.sin(theta), swing * ns.cos(theta)
        V, V1, V2 = self.speed + s, self.speed_frequency * c, -(self.speed_frequency**2) * s
        local = (V, 0.0), (V1, V * rate), (V2 - V * rate * rate, 2 * V1 * rate + V * acceleration)
        c, s = ns.cos(beta), ns.sin(beta)
        return [to_world(along, across, c, s) for along, across in local]

    def derivatives(self, t: Array) -> Array:
        """See `Path.derivatives`.

        The integration steps of the position are at most `longest_step`, for any spacing of the times. The error is
        below 1e-12 m over hundreds of metres.
        """
        t = np.asarray(t, dtype=np.float64)
        grid, rows, origin = _refined(t.ravel(), np.min(self.longest_step))
        grid = grid.reshape(-1, *(1,) * np.ndim(self.speed))
        local: Any = as_array(self.formulas(grid, ARRAYS))
        local[0] = _integral(grid, local[1:], origin)
        curve = as_array(placed(local, (self.x0, self.y0, self.heading), ARRAYS))
        return curve.take(rows, axis=2).reshape(4, 2, *np.broadcast_shapes(t.shape, np.shape(self.speed)))

    @classmethod
    def drawn(cls, speed: Number, turn_rate: float, uniform: Uniform) -> Self:
        """Return a random path: amplitudes that add up to `turn_rate`, frequencies .3 ... 1.2 `turn_rate`."""

        def three(low: float, high: float) -> tuple[float, float, float]:
            a, b, c = (low + (high - low) * uniform() for _ in range(3))
            return a, b, c

        heading = 2 * math.pi * uniform()
        a, b, c = three(0.2, 1.0)
        scale = turn_rate / (a + b + c)
        frequencies, phases = three(0.3 * turn_rate, 1.2 * turn_rate), three(0.0, 2 * math.pi)
        return cls.member(
            speed,
            (scale * a, scale * b, scale * c),
            frequencies,
            phases,
            speed_frequency=turn_rate * (0.3 + 0.9 * uniform()),
            speed_phase=2 * math.pi * uniform(),
            heading=heading,
        )


_NODES, _WEIGHTS = 0.5 * leggauss(10)[0] + 0.5, 0.5 * leggauss(10)[1]  # Gauss-Legendre on [0, 1]


def _refined(t: Array, longest: float) -> tuple[Array, Indices, int]:
    """Return ascending times with `t`, 0 and steps of at most `longest`; the indices of `t`; and the index of 0."""
    k = int(np.searchsorted(t, 0.0))
    knots = np.concatenate((t[:k], [0.0], t[k:]))
    rows = np.zeros(len(knots), dtype=np.int64)
    np.cumsum(np.maximum(np.ceil(np.diff(knots) / longest), 1).astype(np.int64), out=rows[1:])
    grid = np.interp(np.arange(rows[-1] + 1), rows, knots)
    return grid, np.concatenate((rows[:k], rows[k + 1 :])), int(rows[k])


def with_sine(
    course: Sequence[Number], sine: Sequence[Number], t: Number, ns: Namespace
) -> tuple[Number, Number, Number]:
    """Return a course [rad] and its first two time derivatives after the addition of a sine to the turn rate.

    Args:
        course: the course and its derivatives without this sine.
        sine: A [rad/s], w [rad/s], p [rad] of A sin(w t + p).
        t: time [s]; the course at t = 0 does not change.
        ns: the namespace of the numbers.
    """
    beta, rate, acceleration = course
    A, w, p = sine
    theta = w * t + p
    s, c = A * ns.sin(theta), A * ns.cos(theta)
    return beta + (A * ns.cos(p) - c) / w, rate + s, acceleration + w * c


def displacement(h: Number, before: Pairs, after: Pairs) -> tuple[Number, Number]:
    """Return the displacement x, y [m] in a step h [s], for the velocities and two derivatives at its ends.

    The formula is the two-point Hermite quadrature. It is exact for quintics; its error is h^7 f^(6) / 100800 per step.
    """
    axes = zip(zip(*before, strict=True), zip(*after, strict=True), strict=True)
    x, y = (h / 2 * (g + f - h / 5 * (g1 - f1 - h / 12 * (g2 + f2))) for (f, f1, f2), (g, g1, g2) in axes)
    return x, y


def _integral(t: Array, rates: Any, origin: int) -> Array:
    """Return the displacement from t[origin] to each t, shape (2, T, ...), for `rates` (3, 2, T, ...) there."""
    total: Array = np.zeros_like(rates[0])
    steps = displacement(np.diff(t, axis=0), rates[:, :, :-1], rates[:, :, 1:])
    np.cumsum(steps, axis=1, out=total[:, 1:])
    total -= total[:, origin, None]
    return total
