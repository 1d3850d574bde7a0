"""The ocean current: a mean that may turn, gusts, and a shear in space."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from auv_gym.effects.base import At, Effect
from auv_gym.physics.dynamics import CurrentVelocity
from auv_gym.physics.intervals import Interval, Uniform, by_library, check_interval, check_number, draw
from auv_gym.physics.namespaces import Namespace, Number

_cos, _sin = by_library(math.cos), by_library(math.sin)


@dataclass(frozen=True)
class Current:
    """A current: a mean that may turn, a first-order Gauss-Markov gust on each axis, and a shear in space.

    The gust is an Ornstein-Uhlenbeck process smoothed by a first-order filter, as Fossen (2021, section 10.3) models
    slowly varying currents. The shear is a parallel flow whose speed is a sine across it, so that it is free of
    divergence. Its wave length is large, so the current at the centre of the vehicle acts. The change of the water's
    velocity along the path of the vehicle does not enter the inertia forces, see `dynamics`.
    """

    V_x: float = 0.0  # [m/s] mean, in the world
    V_y: float = 0.0  # [m/s]
    gust: float = 0.0  # [m/s] standard deviation of the process on each axis, before smoothing
    gust_time: float = 20.0  # [s] its correlation time
    smoothing: float = 2.0  # [s] time constant of the smoothing filter
    cap: float = math.inf  # largest speed of mean plus gust, as a fraction of the path's slowest speed
    turn: float = 0.0  # [rad/s] rate of turn of the mean
    shear: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)  # see `Shear.Constants`
    V_z: float = 0.0  # [m/s] upward, in space


@dataclass(frozen=True)
class RandomCurrent:
    """Distribution of the current; speeds are fractions of the path's nominal speed, or [m/s] if not `relative`."""

    speed: Interval = 0.0  # mean speed
    direction: Interval = (-math.pi, math.pi)  # [rad] direction in which the mean flows
    gust: float = 0.0  # standard deviation of the gust on each axis
    gust_time: float = 20.0  # [s]
    smoothing: float = 2.0  # [s]
    cap: float = math.inf  # largest speed of mean plus gust, always as a fraction of the path's slowest speed
    relative: bool = True
    turn: Interval = 0.0  # [rad/s] how fast the mean turns
    shear: Interval = 0.0  # amplitude of a parallel flow that varies like a sine across its direction
    wavelength: Interval = 40.0  # [m] of the shear

    def __post_init__(self) -> None:
        check_interval("current speed", self.speed, 0, 1e3)
        check_interval("current turn", self.turn, -10, 10)
        check_interval("current shear", self.shear, 0, 1e3)
        check_interval("current wavelength", self.wavelength, 1.0, 1e6)
        check_interval("current direction", self.direction, -1e3, 1e3)
        check_number("current gust", self.gust, 0, 1e3)
        check_number("current gust_time", self.gust_time, 1e-3, 1e6)
        check_number("current smoothing", self.smoothing, 0, 1e6)
        check_number("current cap", self.cap, 0)
        if not isinstance(self.relative, bool):
            raise ValueError(f"current relative is {self.relative!r}; it must be true or false")

    def draw(self, uniform: Uniform, speed: Number) -> Current:
        """Return one current for a path of this nominal speed [m/s]."""
        unit = speed if self.relative else 1.0
        V, direction = draw(self.speed, uniform) * unit, draw(self.direction, uniform)
        drawn: dict[str, Any] = {}
        if self.turn != 0:
            drawn["turn"] = draw(self.turn, uniform)
        if self.shear != 0:
            amplitude, across = draw(self.shear, uniform) * unit, 2 * math.pi * uniform()
            k, phase = 2 * math.pi / draw(self.wavelength, uniform), 2 * math.pi * uniform()
            c, s = _cos(across), _sin(across)
            drawn["shear"] = (-amplitude * s, amplitude * c, k * c, k * s, phase)
        return Current(
            V * _cos(direction),
            V * _sin(direction),
            self.gust * unit,
            self.gust_time,
            self.smoothing,
            self.cap,
            **drawn,
        )


class Shear(Effect):
    """A parallel flow whose speed is a sine across it: `RandomCurrent.shear`."""

    what = "a sheared current"
    entry, numbers = ("current.shear", 0), "episode.current.shear"

    class Constants(NamedTuple):
        """A current V(p) = amplitude sin(k p + phase)."""

        V_x: Number = 0.0  # [m/s] amplitude
        V_y: Number = 0.0  # [m/s]
        k_x: Number = 0.0  # [rad/m] wave number
        k_y: Number = 0.0  # [rad/m]
        phase: Number = 0.0  # [rad]

        def velocity(self, x: Number, y: Number, ns: Namespace) -> CurrentVelocity:
            """Return its velocity [m/s] at a position [m]."""
            s = ns.sin(self.k_x * x + self.k_y * y + self.phase)
            return self.V_x * s, self.V_y * s

    @classmethod
    def there(cls, episode: Any) -> bool:
        """Return whether the current of the episode has a shear."""
        return any(episode.current.shear[:2])

    @staticmethod
    def current(current: Sequence[Number], at: At) -> tuple[Number, ...]:
        """Return the current with the shear at the position."""
        x, y, *_ = at.state
        shear_x, shear_y = at.own.velocity(x, y, at.ns)
        return current[0] + shear_x, current[1] + shear_y, *current[2:]
