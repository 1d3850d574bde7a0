"""Navigation under water: between rare position fixes the position is reckoned from a Doppler log and a gyro.

The log measures the velocity over ground, wrong by a scale and by its alignment with the gyro, whose heading drifts.
The estimate of the position adds up what they measure (`simulation.step`), and a filter takes on a share of each fix.
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

    fixes: tuple[float, ...] = ()  # [s] when a position fix comes, but for the one at the start
    scale: float = 0.0  # error of the measured velocity as a share of it
    misalignment: float = 0.0  # [rad] of the log to the gyro
    drift: float = 0.0  # [rad/s] of the measured heading


@dataclass(frozen=True)
class RandomReckoning:
    """Distribution of a dead reckoning between position fixes; the defaults are those of small survey vehicles.

    A log of 0.5 % is that of Tang, Wang, Li and Wu, "A novel INS and Doppler sensors calibration method for long range
    underwater vehicle navigation", Sensors 13 (2013); a gyro of 3 deg/h and 0.34 deg/sqrt(h) that of the simulated
    vehicle in Sensors 17 (2017) 415, table 2. Paull, Saeedi, Seto and Li, IEEE Journal of Oceanic Engineering 39 (2014)
    131, review such systems. The misalignment is a choice of ours.
    """

    interval: Interval = (10.0, 30.0)  # [s] from one position fix to the next
    scale: Interval = (-0.005, 0.005)  # error of the measured velocity as a share of it
    misalignment: Interval = (-0.005, 0.005)  # [rad] of the log to the gyro
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
        """Return the mean square error of the reckoned way on one axis, as a share of the way.

        It is the mean over the distribution, over the directions of the way, and over an episode of that duration [s].
        """
        angle = mean_square(heading_bias) + mean_square(self.misalignment)
        angle += mean_square(self.drift) * duration**2 / 3 + self.walk**2 * duration / 2
        return 0.5 * (mean_square(self.scale) + angle)


def heading_errors(drift: float, walk: float, dt: float, instants: int, rng: np.random.Generator) -> Array:
    """Return what drift [rad/s] and random walk [rad/sqrt(s)] make of the heading [rad] at control instants dt apart.

    The first one has no error.
    """
    steps = drift * dt + walk * math.sqrt(dt) * rng.standard_normal(instants)
    steps[0] = 0.0
    return np.cumsum(steps)


@dataclass(frozen=True)
class FixFilter:
    """The filter that decides which share of a position fix is taken on; it knows how good the sensors are.

    It is a Kalman filter of the position on one axis in which the drift, a constant that it does not estimate, is
    considered (Schmidt, Advances in Control Systems 3 (1966) 293): the variance P of the position's error and its
    covariance C with the drift, in units of the drift's standard deviation, give the gain K = P / (P + fix^2).
    """

    fix: float  # [m] standard deviation of a fix on one axis
    drift: float  # mean square error of the reckoned way, as a share of the way squared
    bias: float  # [m^2/s^2] mean square of the velocity's bias
    noise: float  # [m^2/s] variance that the velocity's noise adds in a second

    def gains(self, ways: Sequence[float], times: Sequence[float]) -> list[float]:
        """Return the gain of each fix after the first one, which is taken on whole.

        Args:
            ways: travelled since the fix before [m].
            times: passed since then [s].
        """
        R = P = self.fix**2
        C, found = 0.0, []
        for way, time in zip(ways, times, strict=True):
            D = math.sqrt(self.drift * way**2 + self.bias * time**2)
            P, C = P + 2 * D * C + D**2 + self.noise * time, C + D
            K = P / (P + R) if P > 0 else 1.0
            P, C = (1 - K) * P, (1 - K) * C
            found.append(K)
        return found
