"""Planar paths x(t), y(t), three times continuously differentiable in time, with exact derivatives.

Every family but `Spline` is elementwise: its fields may be arrays of shape (N,), made by `stack`, and then times of
shape (T, 1) give N paths at once. Angles are counter-clockwise from the x axis, as is a positive turn rate.

A new family is a frozen dataclass with the members of `Path`, an entry in `PATHS` and a test.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from numbers import Real
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from numpy.polynomial.legendre import leggauss
from numpy.polynomial.polynomial import polyval
from numpy.typing import NDArray

if TYPE_CHECKING:
    from typing_extensions import Self

Array = NDArray[np.float64]
Uniform = Callable[[], float]
"""Returns the next random number in [0, 1)."""


@runtime_checkable
class Path(Protocol):
    """Anything with a position and three continuous time derivatives on a domain of times."""

    @property
    def speed(self) -> float:
        """Nominal speed [m/s], the scale of the path's velocities."""

    @property
    def start(self) -> float:
        """First time of the domain [s], -inf if there is none."""

    @property
    def end(self) -> float:
        """Last time of the domain [s], inf if there is none."""

    def derivatives(self, t: Array) -> Array:
        """Return position [m] and its first three time derivatives.

        Args:
            t: times [s], ascending along axis 0: any shape, or (T, 1) for a path of N stacked ones.

        Returns:
            Index 0 counts the derivatives, index 1 is x, y; shape (4, 2, *t.shape), or (4, 2, T, N) if stacked.
        """


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
        _validate(self, positive=("speed",))

    def derivatives(self, t: Array) -> Array:
        """See `Path.derivatives`."""
        U = self.speed
        return _place(self, (U * t, 0.0), (U, 0.0), (0.0, 0.0), (0.0, 0.0))

    @classmethod
    def drawn(cls, speed: float, turn_rate: float, uniform: Uniform) -> Self:  # noqa: ARG003, the families share the signature
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
        _validate(self, positive=("speed",), nonzero=("turn_rate",))

    def derivatives(self, t: Array) -> Array:
        """See `Path.derivatives`."""
        U, w = self.speed, self.turn_rate
        s, c = np.sin(w * t), np.cos(w * t)
        x1, y1 = U * c, U * s
        return _place(self, (y1 / w, (U - x1) / w), (x1, y1), (-w * y1, w * x1), (-(w**2) * x1, -(w**2) * y1))

    @classmethod
    def drawn(cls, speed: float, turn_rate: float, uniform: Uniform) -> Self:
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
        _validate(self, positive=("speed",))

    def derivatives(self, t: Array) -> Array:
        """See `Path.derivatives`."""
        U, A, w = self.speed, self.amplitude, self.frequency
        theta = w * t + self.phase
        s, c = np.sin(theta), np.cos(theta)
        return _place(self, (U * t, A * s), (U, A * w * c), (0.0, -A * w**2 * s), (0.0, -A * w**3 * c))

    @classmethod
    def drawn(cls, speed: float, turn_rate: float, uniform: Uniform) -> Self:
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
        _validate(self, positive=("semi_x", "semi_y"), nonzero=("frequency",))

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
        return _place(self, (x, y), (x1, y1), (-(w**2) * x, -(w**2) * y), (-(w**2) * x1, -(w**2) * y1))

    @classmethod
    def drawn(cls, speed: float, turn_rate: float, uniform: Uniform) -> Self:
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
        _validate(self, positive=("size",), nonzero=("frequency",))

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
        return _place(self, (x, y), (x1, y1), (-(w**2) * x, -4 * w**2 * y), (-(w**2) * x1, -4 * w**2 * y1))

    @classmethod
    def drawn(cls, speed: float, turn_rate: float, uniform: Uniform) -> Self:
        """Draw direction, frequency and phase; the lobes turn fastest, at 1.22 ... 1.75 `turn_rate`."""
        heading, w = 2 * math.pi * uniform(), 0.55 * turn_rate * (0.7 + 0.3 * uniform())
        return cls(speed / (1.2 * w), w, 2 * math.pi * uniform(), heading=heading)


def _turn_coefficients() -> Array:
    """Return the integrals over a half turn of heading pi S(z), z in [0, 1], as power series in q = (2z - 1)^2.

    int_0^z cos(pi S) = sum_k c[k, 0] q^k,   int_0^z sin(pi S) = sum_k c[k, 1] (1 + (2z - 1) q^k),   c of shape (19, 2).
    Interpolating the integrands by polynomials of degree 36 is exact to round-off.
    """

    def angle(v: Array) -> Array:
        return math.pi / 16 * (15 * v - 10 * v**3 + 3 * v**5)  # pi (S - 1/2)

    along = Chebyshev.interpolate(lambda v: -0.5 * np.sin(angle(v)), 36).convert(kind=Polynomial).integ(lbnd=-1)
    across = Chebyshev.interpolate(lambda v: 0.5 * np.cos(angle(v)), 36).convert(kind=Polynomial).integ(lbnd=-1)
    return np.stack((along.coef[:-1:2], across.coef[1::2]), axis=1)


_TURN = _turn_coefficients()
_TURN_WIDTH = 2 * float(_TURN[:, 1].sum())  # int_0^1 sin(pi S) = .40756: a turn's width over the length of its arc


@dataclass(frozen=True)
class Lawnmower:
    """A survey at constant speed: straight legs to and fro, joined by half turns to alternating sides.

    The heading of a turn is pi S(z), z the share of the turn's duration and S = z^3 (10 - 15 z + 6 z^2), so it is twice
    continuously differentiable. The pattern advances by `spacing` at each turn, also back in time.
    """

    speed: float  # U [m/s]
    leg: float  # [m] length of the straight part
    spacing: float  # [m] between legs, negative for a first turn to starboard (clockwise)
    x0: float = 0.0  # [m] start of the first leg, at t = 0
    y0: float = 0.0  # [m]
    heading: float = 0.0  # [rad] direction of the first leg

    start: ClassVar[float] = -math.inf
    end: ClassVar[float] = math.inf

    def __post_init__(self) -> None:
        _validate(self, positive=("speed", "leg"), nonzero=("spacing",))

    @property
    def turn_time(self) -> float:
        """Duration T of a half turn [s]; its largest turn rate is 15 pi / (8 T)."""
        return abs(self.spacing) / (_TURN_WIDTH * self.speed)

    def derivatives(self, t: Array) -> Array:
        """See `Path.derivatives`."""
        U, T, straight = self.speed, self.turn_time, self.leg / self.speed
        k = np.floor(t / (straight + T))  # legs completed
        ahead = 1 - 2 * (k % 2)  # 1 on the way out, -1 on the way back
        port = np.sign(self.spacing)
        since = t - k * (straight + T)  # [s] on this leg and its turn
        z = np.minimum(np.maximum((since - straight) / T, 0.0), 1.0)
        v, rest = 2 * z - 1, z * (1 - z)
        angle = math.pi * z * z * z * (10 - 15 * z + 6 * z * z)
        rate, acceleration = 30 * math.pi / T * rest**2, -60 * math.pi / T**2 * rest * v
        along, across = polyval(v * v, _TURN)
        s, c = U * np.sin(angle), U * np.cos(angle)
        x = 0.5 * (1 - ahead) * self.leg + ahead * (U * np.minimum(since, straight) + U * T * along)
        y = self.spacing * (k + 0.5 + v * across / _TURN_WIDTH)
        x1, y1 = ahead * c, port * s
        x2, y2 = -ahead * rate * s, port * rate * c
        x3, y3 = -ahead * acceleration * s - rate**2 * x1, port * acceleration * c - rate**2 * y1
        return _place(self, (x, y), (x1, y1), (x2, y2), (x3, y3))

    @classmethod
    def drawn(cls, speed: float, turn_rate: float, uniform: Uniform) -> Self:
        """Draw direction, largest turn rate .7 ... 1 `turn_rate`, side of the first turn, leg .2 ... 1 spacing."""
        heading, turn_time = 2 * math.pi * uniform(), 15 * math.pi / (8 * turn_rate * (0.7 + 0.3 * uniform()))
        spacing = _TURN_WIDTH * speed * turn_time
        port = uniform() < 0.5
        return cls(speed, spacing * (0.2 + 0.8 * uniform()), spacing if port else -spacing, heading=heading)


@dataclass(frozen=True)
class RandomSmooth:
    """Speed and turn rate as sums of sines: V = U (1 + e sin(w0 t + p0)), turn rate sum_i A_i sin(w_i t + p_i).

    The heading is a closed form, the position its integral. Each sum has three terms.
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

    start: ClassVar[float] = -math.inf
    end: ClassVar[float] = math.inf

    def __post_init__(self) -> None:
        triples = ("turn_rates", "frequencies", "phases")
        _validate(self, positive=("speed", "frequencies"), triples=triples)
        if not (np.all(np.greater_equal(self.speed_variation, 0)) and np.all(np.less(self.speed_variation, 1))):
            raise ValueError(f"RandomSmooth: speed_variation must be in [0, 1), got {self.speed_variation!r}")
        for name in triples:
            if isinstance(getattr(self, name), list):  # as JSON has it
                object.__setattr__(self, name, tuple(getattr(self, name)))

    def derivatives(self, t: Array) -> Array:
        """See `Path.derivatives`.

        Whatever the spacing of the times, the steps of the position's integral are at most .02 rad of the fastest sine
        or turn: the error stays below 1e-12 m over hundreds of metres.
        """
        t = np.asarray(t, dtype=np.float64)
        rates = (sum(map(abs, self.turn_rates)), *self.frequencies, abs(self.speed_frequency))
        grid, rows, origin = _refined(t.ravel(), 0.02 / np.max(rates))
        grid = grid.reshape(-1, *(1,) * np.ndim(self.speed))

        theta = self.speed_frequency * grid + self.speed_phase
        swing = self.speed * self.speed_variation
        s, c = swing * np.sin(theta), swing * np.cos(theta)
        V, V1, V2 = self.speed + s, self.speed_frequency * c, -(self.speed_frequency**2) * s
        beta, rate, acceleration = np.asarray(self.heading), np.zeros(1), np.zeros(1)  # direction of travel
        for A, w, p in zip(self.turn_rates, self.frequencies, self.phases, strict=True):
            theta = w * grid + p
            s, c = A * np.sin(theta), A * np.cos(theta)
            beta, rate, acceleration = beta + (A * np.cos(p) - c) / w, rate + s, acceleration + w * c

        z = np.empty((4, *np.shape(V)), dtype=np.complex128)  # x + iy: z' = V exp(i beta)
        direction = np.cos(beta) + 1j * np.sin(beta)
        z[1] = V * direction
        z[2] = (V1 + 1j * (V * rate)) * direction
        z[3] = (V2 - V * rate * rate + 1j * (2 * V1 * rate + V * acceleration)) * direction
        z[0] = self.x0 + 1j * np.asarray(self.y0) + _integral(grid, z[1], z[2], z[3], origin)
        z = z.take(rows, axis=1).reshape(4, *np.broadcast_shapes(t.shape, np.shape(self.speed)))
        return np.stack((z.real, z.imag), axis=1)

    @classmethod
    def drawn(cls, speed: float, turn_rate: float, uniform: Uniform) -> Self:
        """Draw direction, shares of the three sines in `turn_rate`, frequencies .3 ... 1.2 `turn_rate` and phases."""

        def three(low: float, high: float) -> tuple[float, float, float]:
            a, b, c = (low + (high - low) * uniform() for _ in range(3))
            return a, b, c

        heading = 2 * math.pi * uniform()
        a, b, c = three(0.2, 1.0)
        scale = turn_rate / (a + b + c)
        frequencies, phases = three(0.3 * turn_rate, 1.2 * turn_rate), three(0.0, 2 * math.pi)
        return cls(
            speed,
            (scale * a, scale * b, scale * c),
            frequencies,
            phases,
            speed_frequency=turn_rate * (0.3 + 0.9 * uniform()),
            speed_phase=2 * math.pi * uniform(),
            heading=heading,
        )


_NODES, _WEIGHTS = 0.5 * leggauss(10)[0] + 0.5, 0.5 * leggauss(10)[1]  # Gauss-Legendre on [0, 1]
_DOMAIN_ROUNDING = 1e-9  # [s] by which a time may leave a spline's domain


@dataclass(frozen=True)
class Spline:
    """A smooth path through waypoints, passed at given speeds, from t = 0 to t = `end`.

    The curve p(q) interpolates the waypoints by a quintic spline over the chord length q, straight at both ends
    (p'' = p'''' = 0) or periodic. The speed V(q) is a cubic spline through the speeds at the waypoints, natural or
    periodic. The time law q' = V / |p_q| is inverted to 1e-13 of the duration, then differentiated exactly.
    """

    waypoints: tuple[tuple[float, float], ...]  # [m] (x, y), two or more, three or more if closed
    speed: float  # [m/s] nominal speed, held everywhere unless `speeds` are given
    speeds: tuple[float, ...] = ()  # [m/s] one for each waypoint
    closed: bool = False  # whether to return to the first waypoint, which is not repeated

    start: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        points = _points(self.waypoints, self.closed)
        _validate_speeds(self.speed, self.speeds, len(points))
        object.__setattr__(self, "waypoints", tuple((float(x), float(y)) for x, y in points))
        object.__setattr__(self, "speeds", tuple(float(speed) for speed in self.speeds))
        _ = self._law  # refuses a path that cannot be travelled

    @property
    def end(self) -> float:
        """Duration [s]."""
        return float(self._law.t[-1])

    @property
    def arrivals(self) -> Array:
        """Times at the waypoints [s], and at the return to the first one if closed."""
        return self._law.t[:: self._law.panels]

    @cached_property
    def _law(self) -> _TimeLaw:
        return _TimeLaw.of(self)

    def derivatives(self, t: Array) -> Array:
        """See `Path.derivatives`.

        Raises:
            ValueError: a time is outside 0 ... `end`.
        """
        t = np.asarray(t, dtype=np.float64)
        if not np.all((t >= -_DOMAIN_ROUNDING) & (t <= self.end + _DOMAIN_ROUNDING)):
            raise ValueError(f"Spline: times must be in 0 ... {self.end:.9g} s, got {t.min():.9g} ... {t.max():.9g} s")
        q = self._law.chord(t)
        p, p1, p2, p3 = (np.moveaxis(self._law.curve(q, nu), -1, 0) for nu in range(4))  # by q
        V, V1, V2 = (self._law.pace(q, nu) for nu in range(3))
        g = np.hypot(*p1)
        g1 = (p1 * p2).sum(axis=0) / g
        g2 = ((p2 * p2 + p1 * p3).sum(axis=0) - g1 * g1) / g
        Q = V / g  # q' as a function of q, and its derivatives by q
        Q1 = (V1 - Q * g1) / g
        Q2 = (V2 - 2 * Q1 * g1 - Q * g2) / g
        q1, q2, q3 = Q, Q * Q1, Q * (Q1 * Q1 + Q * Q2)  # by t
        return np.stack((p, p1 * q1, p2 * q1**2 + p1 * q2, p3 * q1**3 + 3 * p2 * q1 * q2 + p1 * q3))


@dataclass(frozen=True)
class _TimeLaw:
    """The curve p(q) and the speed V(q) of a `Spline`, and a table of t(q) = int |p_q| / V dq."""

    curve: Any  # scipy BSpline, chord length [m] -> (x, y) [m]
    pace: Any  # scipy CubicSpline, chord length [m] -> speed [m/s]
    q: Array  # [m]
    t: Array  # [s]
    panels: int  # of the table between two waypoints

    @classmethod
    def of(cls, path: Spline) -> _TimeLaw:
        """Fit the splines and refine the table until two successive ones agree to 1e-14 of the duration."""
        from scipy.interpolate import CubicSpline, make_interp_spline

        points, speeds = np.array(path.waypoints), np.array(path.speeds or (path.speed,) * len(path.waypoints))
        if path.closed:
            points, speeds = np.vstack((points, points[:1])), np.append(speeds, speeds[0])
        chords = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
        ends = [(2, np.zeros(2)), (4, np.zeros(2))]
        curve = make_interp_spline(chords, points, k=5, bc_type="periodic" if path.closed else (ends, ends))
        pace = CubicSpline(chords, speeds, bc_type="periodic" if path.closed else "natural")
        _check_pace(pace, chords)

        marks = np.arange(len(chords))
        coarse = np.full(2 * (len(chords) - 1), np.inf)
        for panels in (4, 8, 16, 32, 64, 128, 256, 512):
            q = np.interp(np.arange(panels * marks[-1] + 1) / panels, marks, chords)
            stretch = np.hypot(*curve(q, 1).T)
            if stretch.min() < 1e-2:
                break
            spent = _travel_time(curve, pace, q[:-1], q[1:])
            if np.abs(spent.reshape(-1, 2).sum(axis=1) - coarse).max() <= 1e-14 * spent.sum():
                return cls(curve, pace, q, np.concatenate(([0.0], np.cumsum(spent))), panels)
            coarse = spent
        near = int(np.abs(chords - q[stretch.argmin()]).argmin()) % len(path.waypoints)
        raise ValueError(
            f"Spline: the curve turns back on itself near waypoint {near}, {path.waypoints[near]}; "
            "round the reversal with further waypoints"
        )

    def chord(self, t: Array) -> Array:
        """Return q(t) [m] by Newton's method on t(q), from a cubic Hermite interpolant of the table."""
        k = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 2)
        q = self.guess(t)
        for _ in range(2):
            p1 = self.curve(q, 1)
            late = self.t[k] + _travel_time(self.curve, self.pace, self.q[k], q) - t
            q = q - late * self.pace(q) / np.hypot(p1[..., 0], p1[..., 1])
        return np.asarray(q)

    @cached_property
    def guess(self) -> Any:
        """The interpolant of q(t): scipy CubicHermiteSpline."""
        from scipy.interpolate import CubicHermiteSpline

        return CubicHermiteSpline(self.t, self.q, self.pace(self.q) / np.hypot(*self.curve(self.q, 1).T))


def _travel_time(curve: Any, pace: Any, a: Array, b: Array) -> Array:
    """Return the time [s] from chord length a to b [m], elementwise, by Gauss-Legendre quadrature."""
    nodes = a[..., None] + (b - a)[..., None] * _NODES
    p1 = curve(nodes, 1)
    times: Array = (b - a) * ((np.hypot(p1[..., 0], p1[..., 1]) / pace(nodes)) @ _WEIGHTS)
    return times


def _points(waypoints: Any, closed: bool) -> Array:
    """Return the waypoints as an array (n, 2), or raise the ValueError that says what is wrong with them."""
    try:
        points = np.asarray(waypoints, dtype=np.float64)
    except (TypeError, ValueError):
        points = np.empty(0)
    least = 3 if closed else 2
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < least:
        raise ValueError(f"Spline: waypoints must be {least} or more pairs (x, y), got {waypoints!r}")
    if not np.isfinite(points).all():
        bad = int(np.argmin(np.isfinite(points).all(axis=1)))
        raise ValueError(f"Spline: waypoints must be finite, got {points[bad].tolist()} at waypoint {bad}")
    following = np.roll(points, -1, axis=0) if closed else points[1:]
    repeated = (following == points[: len(following)]).all(axis=1)
    if repeated.any():
        bad = int(repeated.argmax())
        raise ValueError(
            f"Spline: successive waypoints must differ, got {points[bad].tolist()} "
            f"at waypoints {bad} and {(bad + 1) % len(points)}"
        )
    return points


def _validate_speeds(speed: Any, speeds: Any, count: int) -> None:
    if not _is_number(speed, "positive"):
        raise ValueError(f"Spline: speed must be finite and positive, got {speed!r}")
    if not isinstance(speeds, Sequence) or len(speeds) not in (0, count):
        raise ValueError(f"Spline: speeds must be none or one for each of {count} waypoints, got {speeds!r}")
    for k, value in enumerate(speeds):
        if not _is_number(value, "positive"):
            raise ValueError(f"Spline: speeds must be finite and positive, got {value!r} at waypoint {k}")


def _check_pace(pace: Any, chords: Array) -> None:
    """Raise ValueError where the speed's spline, positive at the waypoints, dips to zero between them."""
    turning = pace.derivative().roots(extrapolate=False)
    turning = turning[np.isfinite(turning)]
    if turning.size and pace(turning).min() <= 0:
        q = turning[pace(turning).argmin()]
        k = int(np.searchsorted(chords, q)) - 1
        raise ValueError(
            f"Spline: the speed must stay positive, got {pace(q):.4g} m/s between waypoints {k} and {k + 1}; "
            "let the speeds change less, or over more waypoints"
        )


def _is_number(value: Any, kind: str) -> bool:
    """Whether every entry is a finite number, also "positive" or "not zero" if `kind` says so."""
    if not isinstance(value, Real | np.ndarray):
        return False
    numbers = np.asarray(value, dtype=np.float64)
    right = numbers > 0 if kind == "positive" else numbers != 0 if kind == "not zero" else True
    return bool(np.all(np.isfinite(numbers) & right))


def _validate(
    path: Any, positive: Sequence[str] = (), nonzero: Sequence[str] = (), triples: Sequence[str] = ()
) -> None:
    """Raise ValueError for the first field that is not finite, positive, not zero or three numbers, as it must be."""
    for name in (field.name for field in fields(path)):
        value = getattr(path, name)
        kind = "positive" if name in positive else "not zero" if name in nonzero else ""
        if name in triples:
            valid = isinstance(value, Sequence | np.ndarray) and len(value) == 3
            valid = valid and all(_is_number(entry, kind) for entry in value)
        else:
            valid = _is_number(value, kind)
        if not valid:
            rule = ("three numbers, each " if name in triples else "") + "finite" + (f" and {kind}" if kind else "")
            raise ValueError(f"{type(path).__name__}: {name} must be {rule}, got {value!r}")


def _place(pose: Any, *local: tuple[Any, Any]) -> Array:
    """Rotate position and derivatives (x, y) by the path's heading and move them to (x0, y0): shape (4, 2, ...)."""
    c, s = np.cos(pose.heading), np.sin(pose.heading)
    shape = np.broadcast(pose.x0, pose.y0, c, *(row for pair in local for row in pair)).shape
    placed = np.empty((4, 2, *shape))
    for (x, y), row in zip(local, placed, strict=True):
        row[0], row[1] = c * x - s * y, s * x + c * y
    placed[0, 0] += pose.x0
    placed[0, 1] += pose.y0
    return placed


def _refined(t: Array, longest: float) -> tuple[Array, NDArray[np.int64], int]:
    """Return ascending times with 0 among them and steps of at most `longest`, and where in it `t` and 0 are."""
    k = int(np.searchsorted(t, 0.0))
    knots = np.concatenate((t[:k], [0.0], t[k:]))
    rows = np.zeros(len(knots), dtype=np.int64)
    np.cumsum(np.maximum(np.ceil(np.diff(knots) / longest), 1).astype(np.int64), out=rows[1:])
    grid = np.interp(np.arange(rows[-1] + 1), rows, knots)
    return grid, np.concatenate((rows[:k], rows[k + 1 :])), int(rows[k])


def _integral(t: Array, f: NDArray[Any], f1: NDArray[Any], f2: NDArray[Any], origin: int) -> NDArray[Any]:
    """Return the integral of f from t[origin] to each t, along axis 0, from f and its derivatives f1, f2 at the same t.

    Two-point Hermite quadrature, exact for quintics: a step h contributes an error of h^7 f^(6) / 100800.
    """
    h = np.diff(t, axis=0)
    total = np.zeros_like(f)
    pieces = h / 2 * (f[1:] + f[:-1] - h / 5 * (f1[1:] - f1[:-1] - h / 12 * (f2[1:] + f2[:-1])))
    np.cumsum(pieces, axis=0, out=total[1:])
    total -= total[origin]
    return total


PATHS: dict[str, type] = {
    "line": Line,
    "circle": Circle,
    "sine": Sine,
    "ellipse": Ellipse,
    "figure_eight": FigureEight,
    "lawnmower": Lawnmower,
    "random_smooth": RandomSmooth,
    "spline": Spline,
}
"""Every family by its name in a scenario."""

PAPER_CIRCLE = Circle(speed=0.1, turn_rate=-0.01, y0=10.0)
"""The paper's example: x_R = 10 sin(.01 t), y_R = 10 cos(.01 t), clockwise at 0.1 m/s."""

_ELEMENTWISE = frozenset(PATHS.values()) - {Spline}


def stack(paths: Sequence[Path]) -> Path:
    """Return one path of N paths of one family, its fields arrays of shape (N,), for times of shape (T, 1).

    Raises:
        ValueError: no path, more than one family, or a family that is not elementwise.
    """
    families = {type(path) for path in paths}
    if len(families) != 1 or not families <= _ELEMENTWISE:
        allowed = ", ".join(sorted(family.__name__ for family in _ELEMENTWISE))
        got = ", ".join(sorted(family.__name__ for family in families)) or "none"
        raise ValueError(f"stack takes paths of one family out of {allowed}, got {got}")
    family: Any = families.pop()
    columns = {field.name: np.array([getattr(path, field.name) for path in paths]).T for field in fields(family)}
    stacked: Path = family(**columns)
    return stacked


def evaluate(paths: Sequence[Path], t: Array) -> Array:
    """Return position and three derivatives of N paths of any families at times t [s], shape (T,): (4, 2, T, N)."""
    t = np.asarray(t, dtype=np.float64)
    members: dict[type, list[int]] = {}
    for column, path in enumerate(paths):
        members.setdefault(type(path), []).append(column)
    out = np.empty((4, 2, len(t), len(paths)))
    for family, columns in members.items():
        if family in _ELEMENTWISE:
            out[..., columns] = stack([paths[k] for k in columns]).derivatives(t[:, None])
        else:
            for k in columns:
                out[..., k] = paths[k].derivatives(t)
    return out
