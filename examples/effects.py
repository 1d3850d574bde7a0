"""Four effects of a user: a dead zone, a drifting compass, a towed body, and a reward with a forbidden area."""

from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np

from auv_gym.effects import At, Effect, Force, Interval, Number, State, effect


@effect
class DeadZone(Effect):
    """The thruster gives nothing for small commands."""

    width: Annotated[Interval, "1", 0.0, 1.0, "share of F_u_max below which it gives nothing"] = 0.1

    @staticmethod
    def share(share: Force, at: At) -> Force:
        """Return the shares of the limits that the actuators give."""
        return at.ns.where(abs(share[0]) < at.own.width, 0.0 * share[0], share[0]), share[1]


@effect
class DriftingCompass(Effect):
    """The error of the measured heading grows: at a constant rate, and as a random walk."""

    rate: Annotated[Interval, "rad/s", -1.0, 1.0, "constant rate"] = (-0.002, 0.002)
    walk: Annotated[Interval, "rad", 0.0, 1.0, "standard deviation that a control step adds"] = 0.002
    normals = 1

    class Memory(NamedTuple):
        """The error [rad]."""

        angle: Number

    @staticmethod
    def measured(measured: State, memory: Memory, at: At) -> tuple[State, Memory]:
        """Return the measurements with the error."""
        angle = memory.angle if at.begins else memory.angle + at.own.rate * at.dt + at.own.walk * at.inputs.n_0
        return (*measured[:2], measured[2] + angle, *measured[3:]), memory._replace(angle=angle)


@effect
class TowedBody(Effect):
    """A towed body pulls astern, the more the faster the vehicle is, until its cable is reeled in."""

    drag: Annotated[Interval, "kg/m", 0.0, 1e4, "quadratic drag"] = (5.0, 30.0)
    reeled: Annotated[Interval, "s", 1.0, 1e5, "time until the cable is reeled in"] = 60.0

    class Inputs(NamedTuple):
        """The share of the cable that is out."""

        out: Number

    def inputs(self, drawn: Any, times: Any, rng: Any) -> Any:
        """Return the share at the control instants."""
        return np.clip(1.0 - times / drawn.reeled, 0.0, 1.0)[None]

    @staticmethod
    def load(load: Any, at: At) -> Any:
        """Return the load on the vehicle, X, Y, N."""
        u = at.state[3]
        return load[0] - at.inputs.out * at.own.drag * u * abs(u), *load[1:]


@effect
class Wall(Effect):
    """A full surge action costs reward, and the episode fails behind a wall."""

    weight: Annotated[Interval, "1", 0.0, 1e3, "cost of a full surge action"] = 0.1
    x: Annotated[Interval, "m", -1e6, 1e6, "position of the wall"] = 1e6
    neutral: ClassVar = {"x": 1e9}

    @staticmethod
    def reward(reward: Number, at: At) -> Number:
        """Return the reward less the cost."""
        return reward - at.own.weight * at.action[0] * at.action[0]

    @staticmethod
    def failed(failed: Any, at: At) -> Any:
        """Return whether the episode has failed."""
        return failed | (at.state[0] > at.own.x)
