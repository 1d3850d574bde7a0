"""A mission: straight legs between waypoints, with rounded corners."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss

from auv_gym.physics.namespaces import Array, Indices
from auv_gym.planning.paths.base import checked_times, is_number
from auv_gym.planning.paths.waypoints import check_speeds, checked_waypoints

_NODES, _WEIGHTS = 0.5 * leggauss(24)[0] + 0.5, 0.5 * leggauss(24)[1]  # Gauss-Legendre on [0, 1]
_PEAK = 15 / 8  # largest slope of the step S
_SHARP = 150.0  # [deg] corner beyond which a smaller radius is no help
_SWING = _PEAK * math.sqrt(math.pi / 2)
"""Length of a slight corner over radius and root of its turn, with the rate of curvature of one of 90 degrees."""


class _Segments(NamedTuple):
    """The straight parts and the corners of the path, in their order; arrays of shape (K,), or (K, 2)."""

    length: Array  # [m]
    begin: Array  # x, y [m] where it begins
    course: Array  # [rad] at its begin
    turn: Array  # [rad] change of the course, 0 on a straight part
    V: Array  # [m/s] speed at its begin
    gain: Array  # [m/s] change of the speed


@dataclass(frozen=True)
class Legs:
    """Straight legs between waypoints at constant speeds, with rounded corners, from t = 0 to t = `end`.

    In a corner the course changes by the angle between the legs times S(z) = z^3 (10 - 15 z + 6 z^2), with z the share
    of its arc length, and the speed from that of one leg to that of the next by the same law. So course and speed are
    twice continuously differentiable. The radius of curvature in the middle of a corner is `radius`, and larger in a
    slight corner, which is as long as the change of its curvature needs. A closed path begins behind the corner at the
    first waypoint.
    """

    waypoints: tuple[tuple[float, float], ...]  # [m] (x, y), two or more, three or more if closed
    speed: float  # [m/s] nominal speed, that of each leg if there are no `speeds`
    radius: float  # [m] least radius of curvature in corners
    speeds: tuple[float, ...] = ()  # [m/s] one for each leg
    closed: bool = False  # whether the path returns to the first waypoint, which is not repeated

    start: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        points, kept = checked_waypoints("Legs", self.waypoints, self.closed)
        for name in ("speed", "radius"):
            if not is_number(getattr(self, name), "positive"):
                raise ValueError(f"Legs: {name} must be finite and positive, got {getattr(self, name)!r}")
        legs = len(self.waypoints) - (0 if self.closed else 1)
        check_speeds("Legs", self.speeds, legs, "legs", "on leg")
        last = [k - 1 for k in (*kept[1:], *((len(self.waypoints),) if self.closed else ()))]  # of those at one place
        object.__setattr__(self, "waypoints", tuple(map(tuple, points.tolist())))
        object.__setattr__(self, "speeds", tuple(float(self.speeds[k]) for k in last) if self.speeds else ())
        _ = self._segments  # raises ValueError for corners that do not fit

    @property
    def end(self) -> float:
        """Duration [s]."""
        return float(self._times[-1])

    @property
    def arrivals(self) -> Array:
        """Times at the waypoints [s]: at the ends of an open path, and in the middle of each corner."""
        corners = np.arange(1, len(self._segments.length), 2)
        middle = self._times[corners] + np.array([self._time_in(k, 0.5) for k in corners.tolist()])
        return middle if self.closed else np.concatenate(([0.0], middle, [self.end]))

    @cached_property
    def _origin(self) -> Array:
        """The first waypoint [m]; positions are computed from there, since coordinates can be millions of metres."""
        return np.array(self.waypoints[0])

    @cached_property
    def _segments(self) -> _Segments:
        points = np.array(self.waypoints) - self._origin
        if self.closed:
            points = np.vstack((points, points[:2]))
        steps = np.diff(points, axis=0)
        courses, lengths = np.arctan2(steps[:, 1], steps[:, 0]), np.hypot(*steps.T)
        turns = np.remainder(np.diff(courses) + math.pi, 2 * math.pi) - math.pi
        speeds = np.array(self.speeds or [self.speed] * (len(courses) - (1 if self.closed else 0)))
        if self.closed:
            speeds = np.append(speeds, speeds[0])
        gains = np.diff(speeds)
        bends = np.maximum(_PEAK * np.abs(turns), _SWING * np.sqrt(np.abs(turns)))
        arcs = np.maximum(bends, np.where(gains == 0, 0.0, 1.0)) * self.radius
        cuts = _cuts(turns, arcs)
        before = np.concatenate((cuts[-1:] if self.closed else [0.0], cuts[: len(lengths) - 1]))
        after = np.append(cuts, 0.0)
        self._check(turns, before + after, lengths)
        straight = lengths - before - after
        if self.closed:  # the last leg is the first one again
            straight = straight[:-1]
        rows: list[tuple[float, ...]] = []
        unit = np.stack((np.cos(courses), np.sin(courses)), axis=1)
        for k, length in enumerate(straight.tolist()):
            x, y = points[k] + before[k] * unit[k]
            rows.append((length, x, y, courses[k], 0.0, speeds[k], 0.0))
            if k < len(turns):
                x, y = points[k + 1] - cuts[k] * unit[k]
                rows.append((arcs[k], x, y, courses[k], turns[k], speeds[k], gains[k]))
        table = np.array(rows)
        return _Segments(table[:, 0], table[:, 1:3], *table[:, 3:].T)

    def _check(self, turns: Array, both: Array, lengths: Array) -> None:
        """Raise ValueError if the corners at both ends of a leg [m] do not fit on its length [m]."""
        n = len(self.waypoints)
        for k, turn in enumerate(turns.tolist()):
            if abs(turn) > math.pi - 1e-3:
                raise ValueError(
                    f"Legs: the path turns back at waypoint {(k + 1) % n}; a vehicle that cannot turn on the spot "
                    "needs two corners there"
                )
        short = both - lengths
        if (short > 1e-9 * lengths).any():
            k = int(np.argmax(short / lengths))
            most = self.radius * lengths[k] / both[k]
            digits = 10.0 ** (math.floor(math.log10(most)) - 3)
            hint = f"a radius of {math.floor(most / digits) * digits:.4g} m would fit"
            if most < self.radius / 10:
                hint += "; where waypoints are that dense, thin them, or use a Spline"
            corners = [abs(math.degrees(turns[c])) for c in (k - 1, k) if self.closed or 0 <= c < len(turns)]
            if max(corners) > _SHARP:
                hint = "a path that almost turns back needs two corners there"
            raise ValueError(
                f"Legs: the leg from waypoint {k % n} to {(k + 1) % n} has {lengths[k]:.4g} m, and its corners, of "
                f"{' and '.join(f'{angle:.1f}' for angle in corners)} degrees, need {both[k]:.4g} m; {hint}"
            )

    @cached_property
    def _times(self) -> Array:
        """Times at the begins of the segments, and at the end [s]."""
        spent = [self._time_in(k, 1.0) for k in range(len(self._segments.length))]
        return np.concatenate(([0.0], np.cumsum(spent)))

    def _time_in(self, k: int, share: float) -> float:
        """Return the time that a share of the length of a segment takes [s]."""
        s = self._segments
        return float(_travel_time(s.length[k], s.V[k], s.gain[k], np.array(share)))

    def derivatives(self, t: Array) -> Array:
        """See `Path.derivatives`.

        Raises:
            ValueError: a time is outside 0 ... `end`.
        """
        t = checked_times(self, t)
        k: Indices = np.clip(np.searchsorted(self._times, t, side="right") - 1, 0, len(self._times) - 2)
        length, begin, course, turn, V_0, gain = (column[k] for column in self._segments)
        since, some = t - self._times[k], np.where(length > 0, length, 1.0)
        z = since * V_0 / some
        for _ in range(4):  # Newton's method; exact at once where the speed is constant
            late = _travel_time(length, V_0, gain, z) - since
            z = np.clip(z - late * (V_0 + gain * _step(z)) / some, 0.0, 1.0)
        S, S1, S2 = _step(z), 30 * (z * (1 - z)) ** 2 / some, 60 * z * (1 - z) * (1 - 2 * z) / some**2
        inside = course[..., None] + turn[..., None] * _step(z[..., None] * _NODES)
        way = (length * z)[..., None] * _WEIGHTS
        x, y = (way * np.cos(inside)).sum(axis=-1), (way * np.sin(inside)).sum(axis=-1)
        beta, kappa, kappa_1 = course + turn * S, turn * S1, turn * S2
        V, V_1, V_2 = V_0 + gain * S, gain * S1, gain * S2
        a, jerk = V * V_1, V * (V_1 * V_1 + V * V_2)
        c, s = np.cos(beta), np.sin(beta)
        local = (
            (V, 0.0 * V),
            (a, kappa * V * V),
            (jerk - kappa * kappa * V**3, 3 * kappa * V * a + kappa_1 * V**3),
        )
        rates = [np.stack((along * c - across * s, along * s + across * c)) for along, across in local]
        position = np.moveaxis(begin, -1, 0) + np.stack((x, y)) + self._origin.reshape(2, *(1,) * t.ndim)
        return np.stack((position, *rates))


def _step(z: Any) -> Any:
    """Return S(z) = z^3 (10 - 15 z + 6 z^2)."""
    return z**3 * (10 - 15 * z + 6 * z * z)


def _travel_time(length: Any, V: Any, gain: Any, z: Any) -> Any:
    """Return the time [s] for a share z of a segment's length, whose speed changes from V by gain S(z)."""
    inside = V[..., None] + gain[..., None] * _step(z[..., None] * _NODES)
    return length * z * (_WEIGHTS / inside).sum(axis=-1)


def _cuts(turns: Array, arcs: Array) -> Array:
    """Return the distance [m] from each waypoint to begin and end of its corner."""
    angles = turns[:, None] * _step(_NODES)
    return np.asarray(arcs * (_WEIGHTS * np.cos(angles)).sum(axis=1) / np.maximum(1 + np.cos(turns), 1e-12))
