"""Measurements: noise, constant bias, position fixes, and a first-order low-pass on the tracking errors."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from auv_gym.effects.base import At, Effect
from auv_gym.effects.navigation import FixFilter, RandomReckoning
from auv_gym.physics.dynamics import State
from auv_gym.physics.intervals import (
    Interval,
    Uniform,
    by_library,
    check_interval,
    check_number,
    draw,
    draw_log,
    mean_square,
)
from auv_gym.physics.namespaces import Namespace, Number, wrap_angle

NOISES = ("position", "heading", "velocity", "yaw_rate")
"""Names of the levels of the noise."""


@dataclass(frozen=True)
class NoiseLevels:
    """Levels of the noise of a vehicle's instruments, as in `Sensors`, at least one; None: that of the scenario."""

    position: Interval | None = None  # [m]
    heading: Interval | None = None  # [rad]
    velocity: Interval | None = None  # [m/s]
    yaw_rate: Interval | None = None  # [rad/s]

    def __post_init__(self) -> None:
        given: dict[str, Any] = {name: level for name in NOISES if (level := getattr(self, name)) is not None}
        if not given:
            raise ValueError(f"the table [sensors] of a vehicle is empty; give at least one of {', '.join(NOISES)}")
        Sensors(**given)  # checks them


@dataclass(frozen=True)
class Sensors:
    """Errors of the six measurements x, y, psi, u, v, r; the velocities are over ground.

    Noise is white: independent in each control step. Only that of the position may have a `correlation` time, see
    `CorrelatedNoise`. A level in an interval is drawn once an episode, with a uniform logarithm, since instruments
    differ by orders of magnitude. A bias is drawn once an episode for each measurement, and the correlation time once
    for both axes. During an outage of the position fix, x and y keep their last measured values. With `reckoning`,
    position fixes are rare: they have the errors of x and y, dead reckoning from measured heading and velocities gives
    the position between them, and fixes within an outage are omitted.
    """

    position: Interval = 0.0  # [m] standard deviation of the noise on x and on y
    heading: Interval = 0.0  # [rad] on psi
    velocity: Interval = 0.0  # [m/s] on u and on v
    yaw_rate: Interval = 0.0  # [rad/s] on r
    position_bias: Interval = 0.0  # [m]
    heading_bias: Interval = 0.0  # [rad]
    velocity_bias: Interval = 0.0  # [m/s]
    yaw_rate_bias: Interval = 0.0  # [rad/s]
    outages: float = 0.0  # [1/min] mean rate of outages of the position fix
    outage_time: Interval = (2.0, 10.0)  # [s] duration of an outage
    reckoning: RandomReckoning | None = None  # dead reckoning between rare fixes; None: a fix in each control step
    low_pass: float | None = None  # [Hz] cut-off of the filter on the measured tracking errors; None: no filter
    correlation: Interval = 0.0  # [s] correlation time of the noise of the position; 0: white

    def __post_init__(self) -> None:
        for name in NOISES:
            level = getattr(self, name)
            check_interval(f"sensors {name}", level, 0, 1e3)
            if isinstance(level, tuple) and not level[0] > 0:
                raise ValueError(f"sensors {name} is {level!r}; its logarithm is uniform, so low must be positive")
            check_interval(f"sensors {name}_bias", getattr(self, f"{name}_bias"), -1e3, 1e3)
        check_interval("sensors correlation", self.correlation, 0, 1e4)
        check_number("sensors outages", self.outages, 0, 60)
        check_interval("sensors outage_time", self.outage_time, 0, 1e4)
        if not isinstance(self.reckoning, RandomReckoning | None):
            raise ValueError(f"sensors reckoning is {self.reckoning!r}; it must be a RandomReckoning or None")
        if self.reckoning is not None and self.correlation != 0:
            raise ValueError(
                f"sensors correlation is {self.correlation!r}, but the fixes of dead reckoning have white noise; "
                "set correlation to 0, or leave out reckoning"
            )
        if self.low_pass is not None:
            check_number("sensors low_pass", self.low_pass, 1e-6, 1e6)

    @property
    def noise(self) -> State:
        """Standard deviations of the six measurements; the geometric mean of an interval."""
        return self.draw_noise(lambda: 0.5)

    @property
    def draws_noise(self) -> bool:
        """Whether a level of the noise differs from episode to episode."""
        return any(isinstance(getattr(self, name), tuple) for name in NOISES)

    def draw_noise(self, uniform: Uniform) -> State:
        """Return the standard deviations of the six measurements in an episode."""
        position, heading, velocity, yaw_rate = (draw_log(getattr(self, name), uniform) for name in NOISES)
        return position, position, heading, velocity, velocity, yaw_rate

    def draw_bias(self, uniform: Uniform) -> State:
        """Return one bias for each of the six measurements."""
        p, v = self.position_bias, self.velocity_bias
        x, y, psi, u, v_, r = (draw(b, uniform) for b in (p, p, self.heading_bias, v, v, self.yaw_rate_bias))
        return x, y, psi, u, v_, r

    def draw_outages(self, rng: np.random.Generator, duration: float) -> tuple[tuple[float, float], ...]:
        """Return begin and end [s] of the outages in an episode, ordered by their begin; they may overlap."""
        count = int(rng.poisson(self.outages * duration / 60))
        begins = np.sort(rng.uniform(0.0, duration, count)).tolist()
        return tuple((begin, begin + draw(self.outage_time, rng.random)) for begin in begins)

    def fix_filter(self, noise: State, dt: float, duration: float) -> FixFilter:
        """Return the filter of the position fixes for an episode.

        Args:
            noise: standard deviations of the six measurements.
            dt: control period [s].
            duration: of the episode [s].
        """
        drift = self.reckoning.mean_square_drift(self.heading_bias, duration) if self.reckoning else 0.0
        return FixFilter(noise[0], drift, mean_square(self.velocity_bias), noise[3] ** 2 * dt)

    def filter_gain(self, dt: float) -> float:
        """Return the weight of a new measurement in the low-pass filter, for a control period of dt [s]."""
        return 1.0 if self.low_pass is None else -math.expm1(-2 * math.pi * self.low_pass * dt)


def low_pass(filtered: State, measured: State, gain: Number, ns: Namespace) -> State:
    """Return the filtered tracking errors after one control step; the heading error is wrapped."""
    x, y, psi, u, v, r = filtered
    x_m, y_m, psi_m, u_m, v_m, r_m = measured
    return (
        x + gain * (x_m - x),
        y + gain * (y_m - y),
        wrap_angle(psi + gain * wrap_angle(psi_m - psi, ns), ns),
        u + gain * (u_m - u),
        v + gain * (v_m - v),
        r + gain * (r_m - r),
    )


class LowPass(Effect):
    """A first-order low-pass on the measured tracking errors: `Sensors.low_pass`. It starts at its input."""

    entry = ("sensors.low_pass", None)

    class Constants(NamedTuple):
        """Its numbers in an episode."""

        gain: Number = 1.0  # weight of a new measurement

    class Memory(NamedTuple):
        """The filtered errors."""

        x: Number  # [m]
        y: Number  # [m]
        psi: Number  # [rad]
        u: Number  # [m/s]
        v: Number  # [m/s]
        r: Number  # [rad/s]

    @classmethod
    def constants(cls, scenario: Any, _: Any) -> tuple[Number, ...]:
        """Return the gain of the filter."""
        return (scenario.sensors.filter_gain(scenario.control_dt),)

    @staticmethod
    def errors(errors: State, memory: Memory, at: At) -> tuple[State, Memory]:
        """Return the filtered errors."""
        filtered = low_pass(memory, errors, 1.0 if at.begins else at.own.gain, at.ns)
        return filtered, LowPass.Memory(*filtered)


class CorrelatedNoise(Effect):
    """The noise of the position is a stationary first-order Gauss-Markov process: `Sensors.correlation`.

    n_k = a n_(k-1) + sqrt(1 - a^2) w_k on each axis, with n_0 = w_0 and white noise w. Then n has the standard
    deviation s of w, and the autocovariance s^2 a^k at a lag of k control periods. Here a = exp(-dt / correlation).
    """

    what = "a correlated noise of the position"
    entry, drawn = ("sensors.correlation", 0), ("correlation", 0)

    class Constants(NamedTuple):
        """Its numbers in an episode."""

        decay: Number = 0.0  # a
        gain: Number = 1.0  # sqrt(1 - a^2)
        bias_x: Number = 0.0  # [m] of the position, which is not filtered
        bias_y: Number = 0.0  # [m]

    class Memory(NamedTuple):
        """The errors of the position, noise and bias."""

        x: Number  # [m]
        y: Number  # [m]

    @classmethod
    def constants(cls, scenario: Any, episode: Any) -> tuple[Number, ...]:
        """Return the numbers of the process."""
        dt = scenario.control_dt
        decay = by_library(lambda time: math.exp(-dt / time) if time > 0 else 0.0)(episode.correlation)
        return decay, by_library(lambda a: math.sqrt(1 - a * a))(decay), *episode.bias[:2]

    @staticmethod
    def noise(noise: State, memory: Memory, at: At) -> tuple[State, Memory]:
        """Return the errors of the measurements with correlated noise of the position."""
        if not at.begins:
            axes = zip(memory, noise[:2], (at.own.bias_x, at.own.bias_y), strict=True)
            x, y = (b + at.own.decay * (last - b) + at.own.gain * (now - b) for last, now, b in axes)
            noise = (x, y, *noise[2:])
        return noise, CorrelatedNoise.Memory(*noise[:2])
