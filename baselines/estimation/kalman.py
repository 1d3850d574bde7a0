"""An extended Kalman filter for the vehicle, its actuators and the sea, fed with nothing but the observation.

What it believes is in `sea_model`, how it goes about it in `filter_equations`. How noisy the sensors are it finds out
as it runs. It knows no control law: `start` and then `update` with each observation give an `Estimate` for a law, an
optimiser or a trained policy to act on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, fields
from functools import cache, lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from auv_gym.codegen.graph import SYMBOLS, Symbol
from auv_gym.codegen.kernel import Kernel
from auv_gym.codegen.matrices import symmetric
from auv_gym.physics.intervals import check_number
from auv_gym.physics.namespaces import ARRAYS, Array, Namespace, Number
from auv_gym.physics.vehicle import Coefficients, Vehicle
from auv_gym.task.observation import Observation
from baselines.estimation.faults import FAULTS, LATE, Faults, arrived
from baselines.estimation.filter_equations import FIRST_NOISE, Belief, split, updated
from baselines.estimation.sea_model import STATE_SIZE, Estimate
from baselines.policy import Memory

VEHICLE_ROWS = len(Coefficients._fields)  # how many rows tell a kernel of the vehicle


@dataclass(frozen=True)
class Tuning:
    """How much is believed to change, as standard deviations.

    With the reference speed U, speeds are in units of U and loads in units of the drag d11 U, d22 U, d33 U / (1 m).
    What drifts like a random walk has its deviation after one second.
    """

    acceleration: float  # drift of u, v that nothing else explains; that of r is in [rad/s]
    current: float  # drift
    gust: float  # [1/s] of the current's rate
    surge_bias: float  # drift of the slowly varying load
    sway_bias: float
    yaw_bias: float
    surge_waves: float  # of the wave load
    sway_waves: float
    yaw_waves: float
    calm: float  # all of this in a calm sea, as a share of what it is in a rough one

    def __post_init__(self) -> None:
        for field in fields(self):
            check_number(f"tuning {field.name}", getattr(self, field.name), 0, 1e6)


@dataclass(frozen=True)
class FaultTuning(Tuning):
    """The same, and how wrong sensors and actuators may be: standard deviations before the first measurement."""

    heading_bias: float  # [rad]
    velocity_bias: float  # [m/s]
    turn_bias: float  # [rad/s]
    loss: float  # [1] of the share of a command that acts
    delay: float  # control periods


FILTER_TUNING = tuple(field.name for field in fields(Tuning))
"""Names of the fields of `Tuning`."""
FAULT_TUNING = tuple(field.name for field in fields(FaultTuning))
"""Names of the fields of `FaultTuning`."""
_SCALED = slice(0, FILTER_TUNING.index("calm"))  # of the rows of a tuning, those that are less in a calm sea
ODDS = 10.0  # logarithm of the odds of a rough sea before the first measurement, which do not fade
BELIEVED = STATE_SIZE + FAULTS + 2 * LATE  # how many rows a filter returns that believes in faults
HYPOTHESES = 2  # a rough sea, a calm one


def tuning_of(gains: Mapping[str, float]) -> Tuning:
    """Return the filter's tuning from among the gains of a controller."""
    kind, names = (FaultTuning, FAULT_TUNING) if FAULT_TUNING[-1] in gains else (Tuning, FILTER_TUNING)
    return kind(**{name: gains[name] for name in names})


class ExtendedKalmanFilter:
    """The filter, for N vehicles at once: one for a rough sea and one for a calm one.

    What they believe is averaged with their likelihoods. Its memory is two arrays, one of each filter, the rows of a
    `filter_equations.Belief`, shape (N, rows); `believed` tells them apart.
    """

    def __init__(self, vehicle: Vehicle, tuning: Tuning) -> None:
        """Make the filter for a vehicle as it is known; with a `FaultTuning` it believes in `Faults` too."""
        self.vehicle, self.tuning = vehicle, tuning
        self.faults = isinstance(tuning, FaultTuning)
        rough = np.array(astuple(tuning))
        calm = rough.copy()
        calm[_SCALED] *= tuning.calm
        self.known = [np.array((*vehicle.coefficients, *values))[:, None] for values in (rough, calm)]

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes, which must not be changed in place."""
        return (_first_belief(n, self.faults),) * HYPOTHESES

    def update(self, memory: Memory, o: Array) -> tuple[Memory, Array]:
        """Return the memory and the state after one more observation.

        Args:
            memory: as `start` or the last call returned it.
            o: the rows of an `Observation` in SI units, shape (SIZE, N).

        Returns:
            The memory, and the rows of an `Estimate`, shape (22, N); if faults are believed in, those of `Faults`
            and the last actions, the last one first, are behind them, shape (`BELIEVED`, N).
        """
        kernel, n = filter_kernel(self.faults), o.shape[1]
        rows = [
            kernel(o=o, known=repeated(known, n), memory=before.T)["after"]
            for known, before in zip(self.known, memory, strict=True)
        ]
        rough, calm = (Belief.of(after, self.faults) for after in rows)
        state = np.array(averaged((rough.fit[0], calm.fit[0]), (rough.state, calm.state), ARRAYS))
        return tuple(after.T for after in rows), np.concatenate((state, rough.actions)) if self.faults else state


def averaged(fits: Sequence[Number], states: Sequence[Sequence[Number]], ns: Namespace) -> list[Number]:
    """Return the state that two filters believe in together, that of a rough sea and that of a calm one.

    Args:
        fits: logarithms of the likelihoods of what was measured.
        states: rows of their states.
        ns: the namespace of the numbers.
    """
    share = 1.0 / (1.0 + ns.exp(ns.clip(fits[0] - fits[1] + ODDS, -50.0, 50.0)))
    return [rough + share * (calm - rough) for rough, calm in zip(*states, strict=True)]


def arrival(o: Array, z: Array, vehicle: Vehicle) -> Array:
    """Return the rows of the `Estimate` when what is commanded now begins to act, shape (22, N); see `faults.arrived`.

    Args:
        o: the rows of an `Observation` in SI units, shape (SIZE, N).
        z: what a filter that believes in faults returns with it, shape (`BELIEVED`, N).
        vehicle: as it is known.
    """
    known = repeated(np.array(vehicle.coefficients)[:, None], o.shape[1])
    return arrival_kernel()(o=o, z=z, known=known)["after"]


@cache
def arrival_kernel() -> Kernel:
    """Return the kernel of `faults.arrived`, which takes observation, what a filter believes, and vehicle."""

    def equation(o: Sequence[Symbol], z: Sequence[Symbol], known: Sequence[Symbol]) -> Mapping[str, Sequence[Any]]:
        terms, (estimate, faults, actions) = Observation(*o), parts(z)
        limits = terms.F_u_max, terms.F_r_max
        return {"after": arrived(estimate, faults, actions, limits, terms.dt, Coefficients(*known), SYMBOLS)}

    rows = {"o": len(Observation._fields), "z": BELIEVED, "known": VEHICLE_ROWS}
    return Kernel.traced(equation, rows, structural=True, blocked=True)


def parts(z: Sequence[Any]) -> tuple[Estimate, Faults, list[tuple[Any, Any]]]:
    """Return what a filter believes: the estimate, the faults, and the actions that may be on their way."""
    estimate, faults = split(z[: STATE_SIZE + FAULTS])
    actions = z[STATE_SIZE + FAULTS :]
    return estimate, faults, list(zip(actions[::2], actions[1::2], strict=True))


def believed(memory: Memory) -> tuple[Belief, ...]:
    """Return the parts of the memory of each filter as rows, count (N,), state (22, N), covariance (N, 22, 22), ..."""
    beliefs = []
    for rows in memory:
        belief = Belief.of(rows.T, rows.shape[1] != sum(Belief.sizes()))
        covariance = np.array(symmetric(list(belief.covariance))).transpose(2, 0, 1)
        beliefs.append(belief._replace(count=belief.count[0], covariance=covariance))
    return tuple(beliefs)


def repeated(column: Array, n: int) -> Array:
    """Return rows (rows, n) that hold the same for n vehicles, from a column (rows, 1)."""
    return column if n == 1 else np.repeat(column, n, axis=1)


@lru_cache(maxsize=8)
def _first_belief(n: int, faults: bool) -> Array:
    rows = np.zeros((sum(Belief.sizes(faults)), n))
    Belief.of(rows, faults).noise[:] = np.square(FIRST_NOISE)[:, None]
    rows.setflags(write=False)
    return rows.T


@cache
def filter_kernel(faults: bool = False) -> Kernel:
    """Return the kernel of one update, which takes observation, vehicle and tuning, and memory."""
    names = FAULT_TUNING if faults else FILTER_TUNING

    def equation(o: Sequence[Symbol], known: Sequence[Symbol], memory: Sequence[Symbol]) -> Mapping[str, Sequence[Any]]:
        tuning = SimpleNamespace(**dict(zip(names, known[VEHICLE_ROWS:], strict=True)))
        after = updated(Observation(*o), Coefficients(*known[:VEHICLE_ROWS]), tuning, Belief.of(memory, faults))
        return {"after": [row for part in after for row in part]}

    rows = {"o": len(Observation._fields), "known": VEHICLE_ROWS + len(names), "memory": sum(Belief.sizes(faults))}
    return Kernel.traced(equation, rows, structural=True, blocked=True)
