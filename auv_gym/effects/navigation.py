"""Navigation under water: dead reckoning with a Doppler log and a gyro between rare position fixes.

The log measures the velocity over ground, with an error of scale and of alignment with the gyro, whose heading drifts.
The estimated position is the sum of the measured velocities (`DeadReckoning.position`). A filter corrects it at each
fix.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from auv_gym.effects.base import At, Effect
from auv_gym.physics.dynamics import State
from auv_gym.physics.errors import to_world
from auv_gym.physics.intervals import Interval, check_interval, check_number, draw, mean_square
from auv_gym.physics.namespaces import Array, Number

Position: TypeAlias = tuple[Number, Number]
"""A position x, y [m] in the world."""


@dataclass(frozen=True)
class Reckoning:
    """The dead reckoning of an episode."""

    fixes: tuple[float, ...] = ()  # [s] times of the position fixes, without the one at the start
    scale: float = 0.0  # relative error of the measured velocity
    misalignment: float = 0.0  # [rad] angle between log and gyro
    drift: float = 0.0  # [rad/s] of the measured heading


@dataclass(frozen=True)
class RandomReckoning:
    """Distribution of the dead reckoning between position fixes; the defaults are for small survey vehicles.

    The error of 0.5 % of the log is that of Tang, Wang, Li and Wu, "A novel INS and Doppler sensors calibration method
    for long range underwater vehicle navigation", Sensors 13 (2013); the gyro's 3 deg/h and 0.34 deg/sqrt(h) are those
    of the simulated vehicle in Sensors 17 (2017) 415, table 2. Paull, Saeedi, Seto and Li, IEEE Journal of Oceanic
    Engineering 39 (2014) 131, review such systems. The misalignment is an assumption.
    """

    interval: Interval = (10.0, 30.0)  # [s] from one position fix to the next
    scale: Interval = (-0.005, 0.005)  # relative error of the measured velocity
    misalignment: Interval = (-0.005, 0.005)  # [rad] angle between log and gyro
    drift: Interval = (-1.5e-5, 1.5e-5)  # [rad/s] of the measured heading, 1e-5 are 2.06 deg/h
    walk: float = 1e-4  # [rad/sqrt(s)] random walk of the measured heading, 1e-4 are 0.344 deg/sqrt(h)

    def __post_init__(self) -> None:
        check_interval("reckoning interval", self.interval, 1, 1e4)
        check_interval("reckoning scale", self.scale, -0.5, 0.5)
        check_interval("reckoning misalignment", self.misalignment, -1, 1)
        check_interval("reckoning drift", self.drift, -0.1, 0.1)
        check_number("reckoning walk", self.walk, 0, 1)

    def draw(self, rng: np.random.Generator, duration: float) -> Reckoning:
        """Return the dead reckoning of an episode of that duration [s]."""
        scale, misalignment, drift = (draw(x, rng.random) for x in (self.scale, self.misalignment, self.drift))
        low, high = self.interval if isinstance(self.interval, tuple) else (self.interval,) * 2
        times = np.cumsum(rng.uniform(low, high, math.ceil(duration / low)))
        return Reckoning(tuple(times[times <= duration].tolist()), scale, misalignment, drift)

    def mean_square_drift(self, heading_bias: Interval, duration: float) -> float:
        """Return the mean square error of the reckoned displacement on one axis, relative to its square.

        It is the mean over the distribution, over the directions of motion, and over an episode of that duration [s].
        """
        angle = mean_square(heading_bias) + mean_square(self.misalignment)
        angle += mean_square(self.drift) * duration**2 / 3 + self.walk**2 * duration / 2
        return 0.5 * (mean_square(self.scale) + angle)


def heading_errors(drift: float, walk: float, dt: float, instants: int, rng: np.random.Generator) -> Array:
    """Return the heading errors [rad] at instants dt [s] apart, of a drift [rad/s] and a random walk [rad/sqrt(s)].

    The first error is zero.
    """
    steps = drift * dt + walk * math.sqrt(dt) * rng.standard_normal(instants)
    steps[0] = 0.0
    return np.cumsum(steps)


@dataclass(frozen=True)
class FixFilter:
    """The gain of the position fixes, from the variances of the sensors.

    It is that of a Kalman filter of the position on one axis in which the drift, a constant that is not estimated, is
    considered (Schmidt, Advances in Control Systems 3 (1966) 293): the variance P of the position's error and its
    covariance C with the drift, in units of the drift's standard deviation, give the gain K = P / (P + fix^2).
    """

    fix: float  # [m] standard deviation of a fix on one axis
    drift: float  # mean square error of the reckoned displacement, relative to its square
    bias: float  # [m^2/s^2] mean square of the velocity's bias
    noise: float  # [m^2/s] variance that the noise of the velocity adds in a second

    def gains(self, ways: Sequence[float], times: Sequence[float]) -> list[float]:
        """Return the gain of each fix after the first one, whose gain is 1.

        Args:
            ways: distances [m] since the previous fix.
            times: durations [s] since the previous fix.
        """
        R = P = self.fix**2
        C, gains = 0.0, []
        for way, time in zip(ways, times, strict=True):
            D = math.sqrt(self.drift * way**2 + self.bias * time**2)
            P, C = P + 2 * D * C + D**2 + self.noise * time, C + D
            K = P / (P + R) if P > 0 else 1.0
            P, C = (1 - K) * P, (1 - K) * C
            gains.append(K)
        return gains


class _Fixes(Effect):
    """An effect on the measured position that depends on the position fixes."""

    remembers = ("x", "y")

    class Inputs(NamedTuple):
        """Its inputs."""

        fix: Number = 1.0  # gain of the position fix: 1 where the fix is the position, 0 without a fix


class Outages(_Fixes):
    """Without a position fix the last measured position is kept: `Sensors.outages`."""

    what = "outages of the position fix"
    entry, drawn = ("sensors.outages", 0), ("outages", ())

    @classmethod
    def series(cls, scenario: Any, episode: Any, table: Array) -> Array | None:
        """Return the gain of the fix; with dead reckoning outages are in its own gain."""
        if not episode.outages or episode.reckoning:
            return None
        return fixes(episode.outages, scenario.control_dt, len(table))[None]

    @staticmethod
    def position(position: Sequence[Number], at: At) -> tuple[Number, ...]:
        """Return the position of the last fix; a depth is measured without fixes."""
        there, ns = at.inputs.fix > 0.5, at.ns
        x, y = ns.where(there, position[0], at.last.x), ns.where(there, position[1], at.last.y)
        return x, y, *position[2:]


class DeadReckoning(_Fixes):
    """Dead reckoning with a Doppler log and a gyro between rare fixes: `Sensors.reckoning`."""

    what = "a dead reckoning"
    entry, drawn = ("sensors.reckoning", None), ("reckoning", None)

    class Constants(NamedTuple):
        """The systematic errors of the Doppler velocity log."""

        reckons: Number = 0.0  # 1 with dead reckoning between fixes, 0 if the last fix is held
        along: Number = 1.0  # gain in the direction of the velocity, (1 + scale error) cos(misalignment)
        across: Number = 0.0  # gain to the right of it, (1 + scale error) sin(misalignment)

        def logged(self, along: Number, across: Number) -> tuple[Number, Number]:
            """Return a measured velocity [m/s] or displacement [m], without noise."""
            return to_world(along, across, self.along, self.across)

    class Inputs(NamedTuple):
        """Its inputs."""

        fix: Number = 1.0  # gain of the position fix
        heading: Number = 0.0  # [rad] error of the measured heading

    @classmethod
    def constants(cls, _: Any, episode: Any) -> tuple[Number, ...]:
        """Return the errors of the log."""
        if (reckoning := episode.reckoning) is None:
            return cls.Constants()
        share, angle = 1.0 + reckoning.scale, reckoning.misalignment
        return 1.0, share * math.cos(angle), share * math.sin(angle)

    @classmethod
    def series(cls, scenario: Any, episode: Any, table: Array) -> Array | None:
        """Return the gain of the fix and the error of the heading."""
        if (reckoning := episode.reckoning) is None:
            return None
        sensors, dt, instants = scenario.sensors, scenario.control_dt, len(table)
        fix_filter = sensors.fix_filter(scenario.noise_of(episode), dt, scenario.duration)
        rng = np.random.default_rng([episode.noise_seed, 3])
        speeds = np.hypot(table[:, 3], table[:, 4])
        gains = _fix_gains(fixes(episode.outages, dt, instants), reckoning, fix_filter, dt, speeds)
        return np.array((gains, heading_errors(reckoning.drift, sensors.reckoning.walk, dt, instants, rng)))

    @staticmethod
    def noise(noise: State, at: At) -> State:
        """Return the errors of the measurements with that of the gyro."""
        x, y, psi, *rest = noise
        return x, y, psi + at.inputs.heading, *rest

    @staticmethod
    def velocity(velocity: tuple[Number, Number], at: At) -> tuple[Number, Number]:
        """Return the velocity that the log measures."""
        return at.own.logged(*velocity)  # type: ignore[no-any-return]

    @staticmethod
    def position(position: Position, at: At) -> Position:
        """Return the position [m] estimated by dead reckoning and position fixes.

        The dead-reckoned position is last + R(n_psi) D (position - before) + R(psi_m) (n_u, n_v) dt, with rotations R
        and the gains D of the log: the heading error n_psi rotates the measured displacement. A fix, position +
        (n_x, n_y), is weighted by the gain `fix`, the dead-reckoned position by 1 - `fix`.
        """
        n_psi, n_u, n_v = at.noise[2:5]
        (x, y, psi), (x_0, y_0), fix, dt, ns = at.state[:3], at.before[:2], at.inputs.fix, at.dt, at.ns
        rest, psi_m = 1.0 - fix, psi + n_psi
        logged_x, logged_y = at.own.logged(x - x_0, y - y_0)
        dx, dy = to_world(logged_x, logged_y, ns.cos(n_psi), ns.sin(n_psi))
        noise_x, noise_y = to_world(n_u * dt, n_v * dt, ns.cos(psi_m), ns.sin(psi_m))
        reckoned_x = at.last.x + at.own.reckons * (dx + noise_x)
        reckoned_y = at.last.y + at.own.reckons * (dy + noise_y)
        return rest * reckoned_x + fix * position[0], rest * reckoned_y + fix * position[1]


def fixes(outages: Sequence[tuple[float, float]], dt: float, instants: int) -> Array:
    """Return 0 for each control instant in an outage, else 1, shape (instants,); the first position is known."""
    found, times = np.ones(instants), dt * np.arange(instants, dtype=np.float64)
    for begin, end in outages:
        found[(times >= begin) & (times < end)] = 0.0
    found[0] = 1.0
    return found


def _fix_gains(known: Array, reckoning: Reckoning, fix_filter: FixFilter, dt: float, speeds: Array) -> Array:
    """Return the gain of the position fix at each control instant: 1 at the first instant, 0 without a fix.

    `known` is from `fixes`. The filter uses the distances between fixes on the reference, which has these speeds [m/s].
    """
    instants = np.unique(np.ceil(np.array(reckoning.fixes) / dt - 1e-9).astype(int))
    used = [0, *(k for k in instants.tolist() if 0 < k < len(known) and known[k])]
    distance = np.concatenate(([0.0], dt * np.cumsum(speeds[1:])))
    gains = np.zeros(len(known))
    gains[used] = [1.0, *fix_filter.gains(np.diff(distance[used]).tolist(), (dt * np.diff(used)).tolist())]
    return gains
