"""The path through given waypoints."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.planning.paths.base import checked_times, is_number
from auv_gym.planning.paths.turning import _NODES, _WEIGHTS
from auv_gym.planning.paths.waypoints import WaypointWarning, check_speeds, checked_waypoints


@dataclass(frozen=True)
class Spline:
    """A smooth path through waypoints at given speeds, from t = 0 to t = `end`.

    The curve p(q) interpolates the waypoints by a quintic spline over the chord length q, straight at both ends
    (p'' = p'''' = 0) or periodic. The speed V(q) is a cubic spline through the speeds at the waypoints, natural or
    periodic. The time law q' = V / |p_q| is inverted to 1e-13 of the duration, then differentiated exactly.
    """

    waypoints: tuple[tuple[float, float], ...]  # [m] (x, y), two or more, three or more if closed
    speed: float  # [m/s] nominal speed; the constant speed if there are no `speeds`
    speeds: tuple[float, ...] = ()  # [m/s] one for each waypoint
    closed: bool = False  # whether the path returns to the first waypoint, which is not repeated

    start: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        points, kept = checked_waypoints("Spline", self.waypoints, self.closed)
        if not is_number(self.speed, "positive"):
            raise ValueError(f"Spline: speed must be finite and positive, got {self.speed!r}")
        check_speeds("Spline", self.speeds, len(self.waypoints), "waypoints", "at waypoint")
        object.__setattr__(self, "waypoints", tuple(map(tuple, points.tolist())))
        object.__setattr__(self, "speeds", tuple(float(self.speeds[k]) for k in kept) if self.speeds else ())
        self._law.check_length()  # raises ValueError for an impossible path

    @property
    def end(self) -> float:
        """Duration [s]."""
        return float(self._law.t[-1])

    @property
    def arrivals(self) -> Array:
        """Times at the waypoints [s], and at the return to the first waypoint if the path is closed."""
        return self._law.t[:: self._law.panels]

    @cached_property
    def _law(self) -> _TimeLaw:
        return _TimeLaw.of(self)

    def derivatives(self, t: Array) -> Array:
        """See `Path.derivatives`.

        Raises:
            ValueError: a time is outside 0 ... `end`.
        """
        t = checked_times(self, t)
        q = self._law.chord(t)
        p, p1, p2, p3 = (np.moveaxis(self._law.curve(q, nu), -1, 0) for nu in range(4))  # by q
        p = p + np.array(self.waypoints[0]).reshape(2, *(1,) * t.ndim)
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

    curve: Any  # scipy BSpline, chord length [m] -> (x, y) [m] from the first waypoint
    pace: Any  # scipy CubicSpline, chord length [m] -> speed [m/s]
    q: Array  # [m]
    t: Array  # [s]
    panels: int  # number of intervals of the table between two waypoints

    @classmethod
    def of(cls, path: Spline) -> _TimeLaw:
        """Fit the splines, and refine the table until two successive tables agree to 1e-14 of the duration.

        Raises:
            ValueError: the speed is not positive everywhere, or the curve reverses its direction.
        """
        from scipy.interpolate import CubicSpline, make_interp_spline

        points, speeds = (
            np.subtract(path.waypoints, path.waypoints[0]),
            np.array(path.speeds or (path.speed,) * len(path.waypoints)),
        )
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
            f"Spline: the curve reverses its direction near waypoint {near}, {path.waypoints[near]}; "
            "round the reversal with further waypoints"
        )

    def check_length(self) -> None:
        """Warn if the curve is more than a tenth longer than the polygon of the waypoints."""
        length = float(_travel_time(self.curve, np.ones_like, self.q[:-1], self.q[1:]).sum())
        if length > 1.1 * self.q[-1]:
            warnings.warn(
                f"Spline: the curve is {length:.4g} m long, the polygon of its waypoints {self.q[-1]:.4g} m; "
                "`Legs` keeps to straight legs", WaypointWarning, stacklevel=4,
            )  # fmt: skip

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
        """Approximate q(t), a scipy CubicHermiteSpline."""
        from scipy.interpolate import CubicHermiteSpline

        return CubicHermiteSpline(self.t, self.q, self.pace(self.q) / np.hypot(*self.curve(self.q, 1).T))


def _travel_time(curve: Any, pace: Any, a: Array, b: Array) -> Array:
    """Return the travel time [s] from chord length a to b [m], elementwise, by Gauss-Legendre quadrature."""
    nodes = a[..., None] + (b - a)[..., None] * _NODES
    p1 = curve(nodes, 1)
    times: Array = (b - a) * ((np.hypot(p1[..., 0], p1[..., 1]) / pace(nodes)) @ _WEIGHTS)
    return times


def _check_pace(pace: Any, chords: Array) -> None:
    """Raise ValueError if the spline of the speed is not positive between the waypoints."""
    turning = pace.derivative().roots(extrapolate=False)
    turning = turning[np.isfinite(turning)]
    if (least := pace(turning).min(initial=np.inf)) <= 0:
        k = int(np.searchsorted(chords, turning[pace(turning).argmin()])) - 1
        raise ValueError(
            f"Spline: the speed must stay positive, got {least:.4g} m/s between waypoints {k} and {k + 1}; "
            "let the speeds change less, or over more waypoints"
        )
