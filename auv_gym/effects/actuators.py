"""Thruster and rudder: limits, first-order lag, rate limit, delay and loss of the surge force and the yaw torque."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from auv_gym.effects.base import At, Effect
from auv_gym.physics.dynamics import Force
from auv_gym.physics.intervals import Interval, check_interval, check_number
from auv_gym.physics.namespaces import Namespace, Number

LONGEST_DELAY = 3
"""Largest delay of a command, in control periods."""
LARGEST_FORCE = 1e9
"""Largest limit of an actuator, in its SI unit."""
LEAST_SHARE = 1 / 64
"""Lower bound of the fins' share of F_r_max in observations and laws; at rest the true share is zero."""


@dataclass(frozen=True)
class Actuators:
    """Limits and speed of the two actuators; an action of +-1 commands the limit."""

    F_u_max: float = 400.0  # [N]
    F_r_max: float = 200.0  # [N m]
    lag: Interval = 0.0  # [s] time constant of the first-order response of both
    F_u_rate: float = math.inf  # [N/s]
    F_r_rate: float = math.inf  # [N m/s]
    effectiveness: Interval = 1.0  # acting share of the command, drawn for each actuator; unknown to policies
    reach: Interval = 1.0  # action at which an actuator saturates, drawn for each actuator; unknown to policies
    delay: Interval = 0.0  # control periods until a command acts, drawn and rounded; unknown to policies
    fin: float = 0.0  # [kg] yaw torque of full fins per squared speed through water, up to F_r_max; 0: no fins, F_r_max
    astern: float = 1.0  # share of F_u_max that the thruster gives astern

    def __post_init__(self) -> None:
        check_number("actuators F_u_max", self.F_u_max, 1e-3, LARGEST_FORCE)
        check_number("actuators F_r_max", self.F_r_max, 1e-3, LARGEST_FORCE)
        check_interval("actuators lag", self.lag, 0, 1e3)
        check_number("actuators F_u_rate", self.F_u_rate, 1e-3)
        check_number("actuators F_r_rate", self.F_r_rate, 1e-3)
        check_interval("actuators effectiveness", self.effectiveness, 1e-3, 1)
        check_interval("actuators reach", self.reach, 1e-3, 1)
        check_interval("actuators delay", self.delay, 0, LONGEST_DELAY)
        check_number("actuators fin", self.fin, 0, LARGEST_FORCE)
        check_number("actuators astern", self.astern, 0, 1)


def fin_share(u: Number, fin: Number, F_r_max: Number, ns: Namespace) -> Number:
    """Return the share of F_r_max that full fins give at a surge speed u [m/s] through water; 1 without fins."""
    share = fin * u * u / F_r_max
    return ns.where((fin > 0.0) & (share < 1.0), share, 1.0)


def known_torque(u: Number, fin: Number, F_r_max: Number, ns: Namespace) -> Number:
    """Return the nominal yaw torque [N m] of full fins at a measured surge speed u [m/s] over ground."""
    share = fin_share(u, fin, F_r_max, ns)
    return F_r_max * ns.where(share < LEAST_SHARE, LEAST_SHARE, share)


class Response(NamedTuple):
    """One control step of the actuators: floats, or rows of shape (N,)."""

    gain: Number  # share of the difference to the command that one step removes, 1 - exp(-dt/lag)
    mean: Number  # mean of the change over the step, as a share of the change at its end
    slew_u: Number  # [N] largest change in one step
    slew_r: Number  # [N m]

    @staticmethod
    def of(lag: Number, F_u_rate: float, F_r_rate: float, dt: float) -> Response:
        """Return the exact discrete response for a command held over dt [s]; without lag a step acts at once."""
        if isinstance(lag, np.ndarray):
            return Response(*np.array([Response.of(one, F_u_rate, F_r_rate, dt) for one in lag.tolist()]).T)
        if lag == 0:
            return Response(1.0, 1.0, F_u_rate * dt, F_r_rate * dt)
        gain = -math.expm1(-dt / lag)
        return Response(gain, (1 - lag / dt * gain) / gain, F_u_rate * dt, F_r_rate * dt)


def respond(
    force: Sequence[Number], command: Sequence[Number], response: Sequence[Number], ns: Namespace
) -> tuple[tuple[Number, ...], tuple[Number, ...]]:
    """Return the mean force of each channel over one control step, and the force at its end.

    The mean keeps the impulse of the exponential response exact although the integrator holds the force.
    """
    gain, mean, *slews = response
    both = zip(force, command, slews, strict=True)
    changes = [ns.clip(gain * (now - before), -slew, slew) for before, now, slew in both]
    middle = tuple(before + mean * change for before, change in zip(force, changes, strict=True))
    return middle, tuple(before + change for before, change in zip(force, changes, strict=True))


class Delay(Effect):
    """A command acts some control periods later: `Actuators.delay`."""

    what = "a delay"
    entry, drawn, numbers = ("actuators.delay", 0), ("delay", 0), "episode.delay"

    class Constants(NamedTuple):
        """Its numbers in an episode."""

        periods: Number  # control periods until a command acts

    repeated = ("Memory",)

    class Memory(NamedTuple):
        """Earlier actions of a channel; the last one is in the plant."""

        second: Number  # two control steps ago
        third: Number  # three control steps ago

    @staticmethod
    def command(command: Force, memory: tuple[Memory, ...], at: At) -> tuple[tuple[Number, ...], tuple[Memory, ...]]:
        """Return the command that was sent `periods` earlier."""
        periods, ns = at.own.periods, at.ns

        def late(now: Number, one: Number, two: Number, three: Number) -> Number:
            return ns.where(periods < 0.5, now, ns.where(periods < 1.5, one, ns.where(periods < 2.5, two, three)))

        each = [*zip(command, at.last_action, memory, strict=True)]
        following = tuple(Delay.Memory(last, earlier.second) for _, last, earlier in each)
        return tuple(late(now, last, *earlier) for now, last, earlier in each), following


class Reach(Effect):
    """An actuator saturates at a smaller command: `Actuators.reach`."""

    what = "actuators that saturate early"
    entry, numbers = ("actuators.reach", 1), "episode.reach"

    repeated = ("Constants",)

    class Constants(NamedTuple):
        """Its number for a channel in an episode."""

        level: Number = 1.0  # command at which the actuator saturates

    @classmethod
    def there(cls, episode: Any) -> bool:
        """Return whether an actuator of the episode saturates early."""
        return any(level != 1.0 for level in episode.reach)

    @staticmethod
    def command(command: Force, at: At) -> tuple[Number, ...]:
        """Return the command within the reach of the actuators."""
        return tuple(at.ns.clip(a, -own.level, own.level) for a, own in zip(command, at.own, strict=True))


class Astern(Effect):
    """The thruster gives less astern than ahead: `Actuators.astern`."""

    entry, numbers = ("actuators.astern", 1), "scenario.actuators.astern"

    class Constants(NamedTuple):
        """Its numbers in an episode."""

        share: Number = 1.0  # largest thrust astern over that ahead

    @staticmethod
    def share(share: Force, at: At) -> tuple[Number, ...]:
        """Return the shares of the limits that the thruster can give."""
        return at.ns.clip(share[0], -at.own.share, 1.0), *share[1:]


class Fins(Effect):
    """The yaw torque of fins grows with the squared speed through water: `Actuators.fin`."""

    entry, numbers = ("actuators.fin", 0), "scenario.actuators.fin"

    class Constants(NamedTuple):
        """Its numbers in an episode."""

        fin: Number  # [kg] see `Actuators`

    @staticmethod
    def thrust(thrust: Force, at: At) -> tuple[Number, ...]:
        """Return force and torques at action 1 for the speed through water."""
        u, (surge, *torques), (_, *most) = at.true("u"), thrust, at.limits
        each = zip(torques, at.own, most, strict=True)
        return surge, *(torque * fin_share(u, fin, limit, at.ns) for torque, fin, limit in each)

    @staticmethod
    def limits(limits: Force, at: At) -> tuple[Number, ...]:
        """Return the limits for the measured speed over ground."""
        u, (surge, *most) = at.true("u"), limits
        return surge, *(known_torque(u, fin, limit, at.ns) for fin, limit in zip(at.own, most, strict=True))
