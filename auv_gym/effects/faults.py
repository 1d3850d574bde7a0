"""Faults of actuators and measurements that begin and end within an episode; at most one acts at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from auv_gym.effects.base import At, Effect, Measured
from auv_gym.physics.dynamics import Force, State
from auv_gym.physics.intervals import Interval, check_interval, check_number, draw
from auv_gym.physics.namespaces import Array, Number

FAULT_KINDS = (
    "surge stuck", "surge dead", "surge one way", "yaw stuck", "yaw dead", "yaw one way",
    "all frozen", "heading frozen", "velocity frozen", "yaw rate frozen", "velocity missing", "position jump",
    "velocity offset",
)  # fmt: skip
"""Kinds of faults. A stuck actuator repeats its last command, a dead one gives no force, one that works one way gives
no force astern or no torque to port. A frozen measurement keeps its last value; missing velocities u, v read zero. A
jump adds a constant error to the measured position, an offset one to the measured velocities u, v over ground."""
_ACTUATORS = {"u": "surge", "r": "yaw"}  # names of the channels in the kinds of faults
_JUMP, _OFFSET = "position jump", "velocity offset"  # kinds with a drawn size
_CODE = {name: float(code) for code, name in enumerate(FAULT_KINDS, 1)}


class Fault(NamedTuple):
    """A fault of an episode."""

    kind: str  # one of `FAULT_KINDS`
    begin: float  # [s]
    end: float  # [s]
    jump: tuple[float, float] = (0.0, 0.0)  # x, y [m] of a position jump; u, v [m/s] of a velocity offset


@dataclass(frozen=True)
class RandomFaults:
    """Faults at random times, or one that begins in a given interval; each of the `kinds` has equal probability.

    Raises:
        ValueError: a kind is unknown or there is none, or a number is out of range.
    """

    kinds: tuple[str, ...]
    rate: float = 2.0  # [1/min] mean rate
    time: Interval = (3.0, 10.0)  # [s] duration of a fault
    jump: Interval = (1.0, 3.0)  # [m] size of a position jump
    offset: Interval = (0.0, 0.1)  # [m/s] size of a velocity offset
    begin: Interval | None = None  # [s] begin of the only fault of an episode; None: faults at the mean rate

    def __post_init__(self) -> None:
        if not isinstance(self.kinds, tuple) or not self.kinds or not set(self.kinds) <= set(FAULT_KINDS):
            raise ValueError(f"faults kinds is {self.kinds!r}; it must be a tuple of some of: {', '.join(FAULT_KINDS)}")
        check_number("faults rate", self.rate, 0, 60)
        check_interval("faults time", self.time, 0, 1e4)
        check_interval("faults jump", self.jump, 0, 1e4)
        check_interval("faults offset", self.offset, 0, 1e3)
        if self.begin is not None:
            check_interval("faults begin", self.begin, 0, 1e6)

    def draw(self, rng: np.random.Generator, duration: float) -> tuple[Fault, ...]:
        """Return the faults of an episode of a duration [s], ordered by their begin."""
        if self.begin is None:
            begins = np.sort(rng.uniform(0.0, duration, rng.poisson(self.rate * duration / 60))).tolist()
        else:
            begins = [draw(self.begin, rng.random)]
        faults, sizes = [], {_JUMP: self.jump, _OFFSET: self.offset}
        for begin in begins:
            kind, angle = self.kinds[rng.integers(len(self.kinds))], rng.uniform(0.0, 2 * np.pi)
            size = draw(sizes[kind], rng.random) if kind in sizes else 0.0
            x, y = float(size * np.cos(angle)), float(size * np.sin(angle))
            faults.append(Fault(kind, begin, begin + draw(self.time, rng.random), (x, y)))
        return tuple(faults)


def fault_rows(faults: Sequence[Fault], dt: float, instants: int) -> Array:
    """Return the code of the fault and its `Fault.jump` at each control instant, shape (3, instants).

    The code is 0 without a fault, and at the first instant. A fault ends when the next one begins.
    """
    times, rows = dt * np.arange(instants, dtype=np.float64), np.zeros((3, instants))
    for fault in faults:
        rows[:, times >= fault.begin] = 0.0
        during = (times >= fault.begin) & (times < fault.end)
        rows[:, during] = np.array([_CODE[fault.kind], *fault.jump])[:, None]
    rows[:, 0] = 0.0
    return rows


def _during(kind: str, rows: Array) -> Array:
    """Return the last two of the rows of `fault_rows` during faults of a kind, else zero."""
    return np.where(_is(rows[0], kind), rows[1:], 0.0)


def _is(fault: Number, kind: str) -> Number:
    """Return whether a code is that of a kind."""
    return abs(fault - _CODE[kind]) < 0.5


class Faults(Effect):
    """An actuator or a measurement fails for some time: `Scenario.faults`."""

    what = "faults"
    entry, drawn = ("faults", None), ("faults", ())
    remembers = Measured._fields

    repeated = ("Memory",)

    class Memory(NamedTuple):
        """Its memory for a channel."""

        executed: Number  # command that the actuator executed

    class Inputs(NamedTuple):
        """Its inputs."""

        code: Number  # of the fault; 0 without one
        jump_x: Number  # [m] jump of the measured position
        jump_y: Number  # [m]

    @classmethod
    def series(cls, scenario: Any, episode: Any, table: Array) -> Array | None:
        """Return code and jump at each control instant."""
        if not episode.faults:
            return None
        rows = fault_rows(episode.faults, scenario.control_dt, len(table))
        return np.concatenate((rows[:1], _during(_JUMP, rows)))

    @staticmethod
    def command(command: Force, memory: tuple[Memory, ...], at: At) -> tuple[tuple[Number, ...], tuple[Memory, ...]]:
        """Return the command that the actuators execute."""
        ns, code = at.ns, at.inputs.code

        def executed(channel: str, now: Number, before: Number) -> Number:
            if channel not in _ACTUATORS:
                return now
            stuck, dead, one_way = (_is(code, f"{_ACTUATORS[channel]} {how}") for how in ("stuck", "dead", "one way"))
            return ns.where(stuck, before, ns.where(dead, 0.0 * now, ns.where(one_way, ns.clip(now, 0.0, 1.0), now)))

        each = zip(at.channels, command, memory, strict=True)
        done = tuple(executed(channel, now, before.executed) for channel, now, before in each)
        return done, tuple(map(Faults.Memory, done))

    @staticmethod
    def noise(noise: State, memory: tuple[Memory, ...], at: At) -> tuple[State, tuple[Memory, ...]]:
        """Return the errors of the measurements with the jump of the position."""
        x, y, *rest = noise
        return (x + at.inputs.jump_x, y + at.inputs.jump_y, *rest), memory

    @staticmethod
    def measured(measured: State, memory: tuple[Memory, ...], at: At) -> tuple[Any, tuple[Memory, ...]]:
        """Return the measurements; frozen ones keep the value of the previous control instant."""
        ns, code = at.ns, at.inputs.code
        frozen, missing = _is(code, "all frozen"), _is(code, "velocity missing")
        heading, velocity, yaw_rate = (
            frozen | _is(code, f"{name} frozen") for name in ("heading", "velocity", "yaw rate")
        )
        held = {"psi": heading, "u": velocity, "v": velocity, "w": velocity, "r": yaw_rate}
        seen = {
            name: ns.where(held.get(name, frozen), getattr(at.last, name), now)
            for name, now in zip(at.names, measured, strict=True)
        }
        lost = {name: ns.where(missing, 0.0 * seen[name], seen[name]) for name in ("u", "v", "w") if name in seen}
        return tuple((seen | lost).values()), memory


class OffsetFaults(Effect):
    """Faults "velocity offset", an effect of its own so that other faults need no inputs for it."""

    what = "a velocity offset"

    class Inputs(NamedTuple):
        """Its inputs."""

        u: Number  # [m/s] offset of the measured velocity over ground
        v: Number  # [m/s]

    @classmethod
    def used(cls, scenario: Any) -> bool:
        """Return whether the scenario has faults of this kind."""
        return scenario.faults is not None and _OFFSET in scenario.faults.kinds

    @classmethod
    def there(cls, episode: Any) -> bool:
        """Return whether the episode has a fault of this kind."""
        return any(fault.kind == _OFFSET for fault in episode.faults)

    @classmethod
    def series(cls, scenario: Any, episode: Any, table: Array) -> Array | None:
        """Return the offset at each control instant."""
        return _during(_OFFSET, fault_rows(episode.faults, scenario.control_dt, len(table)))

    @staticmethod
    def noise(noise: State, at: At) -> tuple[Number, ...]:
        """Return the errors of the measurements with the offset of the velocity."""
        errors = dict(zip(at.names, noise, strict=True))
        return tuple((errors | {"u": errors["u"] + at.inputs.u, "v": errors["v"] + at.inputs.v}).values())
