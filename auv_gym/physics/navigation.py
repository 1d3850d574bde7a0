"""Navigation under water: dead reckoning with a Doppler log and a gyro between rare position fixes.

The log measures the velocity over ground, with an error of scale and of alignment with the gyro, whose heading drifts.
The estimated position is the sum of the measured velocities (`simulation.step`), and a filter corrects it at each fix.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from auv_gym.physics.intervals import Interval, check_interval, check_number, draw, mean_square
from auv_gym.physics.namespaces import Array


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
