"""Extended Kalman filter for vehicle, actuators and disturbances; its only input is the observation.

`sea_model` has its model, `filter_equations` its equations. It estimates the measurement noise online. It is
independent of the control law: `start`, then `update` with each observation return an `Estimate` for a control law, an
optimiser or a trained policy.
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
from auv_gym.physics.intervals import check_number
from auv_gym.physics.namespaces import ARRAYS, Array, Namespace, Number
from auv_gym.physics.vehicle import Coefficients, Vehicle, with_names
from auv_gym.task.observation import Observation
from baselines.estimation.faults import FAULTS, LATE, Faults, after_delay
from baselines.estimation.filter_equations import PLANE_FILTER, Belief, FilterModel, split, updated
from baselines.estimation.sea_model import STATE_SIZE, Estimate
from baselines.policy import Memory

VEHICLE_ROWS = len(Coefficients._fields)
"""Number of rows of a kernel's input that describe a vehicle without cross terms."""


@dataclass(frozen=True)
class Tuning:
    """Standard deviations of the process noise.

    With the reference speed U, speeds are in units of U and loads in units of the drag d11 U, d22 U, d33 U / (1 m).
    A drift is the standard deviation of a random walk after one second.
    """

    acceleration: float  # drift of u and v beyond the model; that of r is in [rad/s]
    current: float  # drift
    gust: float  # [1/s] of the current's rate
    surge_bias: float  # drift of the slowly varying load
    sway_bias: float
    yaw_bias: float
    surge_waves: float  # of the wave load
    sway_waves: float
    yaw_waves: float
    calm: float  # factor on all of these in the filter for calm water

    def __post_init__(self) -> None:
        for field in fields(self):
            check_number(f"tuning {field.name}", getattr(self, field.name), 0, 1e6)


@dataclass(frozen=True)
class FaultTuning(Tuning):
    """Tuning of a filter that estimates faults, with the faults' standard deviations before the first measurement."""

    heading_bias: float  # [rad]
    velocity_bias: float  # [m/s]
    turn_bias: float  # [rad/s]
    loss: float  # [1] of the actuators' effectiveness
    delay: float  # control periods


FILTER_TUNING = tuple(field.name for field in fields(Tuning))
"""Names of the fields of `Tuning`."""
FAULT_TUNING = tuple(field.name for field in fields(FaultTuning))
"""Names of the fields of `FaultTuning`."""
_SCALED = slice(0, FILTER_TUNING.index("calm"))  # entries of a tuning that `calm` multiplies
ODDS = 10.0  # log-odds of rough water before the first measurement; they are not forgotten
FAULT_FILTER_ROWS = STATE_SIZE + FAULTS + 2 * LATE  # rows that a filter with faults returns
HYPOTHESES = 2  # rough water and calm water


def tuning_of(gains: Mapping[str, float]) -> Tuning:
    """Return the filter's tuning, which is a part of a controller's gains."""
    kind, names = (FaultTuning, FAULT_TUNING) if FAULT_TUNING[-1] in gains else (Tuning, FILTER_TUNING)
    return kind(**{name: gains[name] for name in names})


class ExtendedKalmanFilter:
    """Two filters for N vehicles: one with the process noise of rough water, one with that of calm water.

    Their estimates are averaged with their likelihoods as weights. The memory is two arrays, one for each filter, with
    the rows of a `filter_equations.Belief`, shape (N, rows).
    """

    def __init__(self, vehicle: Any, tuning: Tuning, model: FilterModel = PLANE_FILTER) -> None:
        """Make the filter for a nominal vehicle; with a `FaultTuning` it estimates `Faults` as well, in the plane."""
        self.vehicle, self.tuning, self.model = vehicle, tuning, model
        self.faults = isinstance(tuning, FaultTuning)
        rough = np.array(astuple(tuning))
        calm = rough.copy()
        calm[_SCALED] *= tuning.calm
        self.known = [np.array((*vehicle.all_coefficients, *values))[:, None] for values in (rough, calm)]
        self._kernel = filter_kernel(self.faults, len(vehicle.all_coefficients), model)

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes; it must not be changed in place."""
        return (_initial_memory(n, self.faults, self.model),) * HYPOTHESES

    def update(self, memory: Memory, o: Array) -> tuple[Memory, Array]:
        """Return the memory and the state after one more observation.

        Args:
            memory: as `start` or the last call returned it.
            o: the rows of an `Observation` in SI units, shape (SIZE, N).

        Returns:
            The memory, and the rows of an `Estimate`, shape (22, N). If faults are estimated, the rows of `Faults` and
            the last actions, the latest first, follow: shape (`FAULT_FILTER_ROWS`, N).
        """
        n = o.shape[1]
        rows = [
            self._kernel(o=o, known=repeated(known, n), memory=before.T)["after"]
            for known, before in zip(self.known, memory, strict=True)
        ]
        rough, calm = (Belief.of(after, self.faults, self.model) for after in rows)
        state = np.array(averaged((rough.fit[0], calm.fit[0]), (rough.state, calm.state), ARRAYS))
        return tuple(after.T for after in rows), np.concatenate((state, rough.actions)) if self.faults else state


def averaged(fits: Sequence[Number], states: Sequence[Sequence[Number]], ns: Namespace) -> list[Number]:
    """Return the weighted mean of the states of the filters for rough and for calm water.

    Args:
        fits: log-likelihoods of the measurements in the two filters.
        states: rows of their states.
        ns: the namespace of the numbers.
    """
    share = 1.0 / (1.0 + ns.exp(ns.clip(fits[0] - fits[1] + ODDS, -50.0, 50.0)))
    return [rough + share * (calm - rough) for rough, calm in zip(*states, strict=True)]


def estimate_after_delay(o: Array, z: Array, vehicle: Vehicle) -> Array:
    """Return the rows of the `Estimate` when the present command begins to act, shape (22, N); see `after_delay`.

    Args:
        o: the rows of an `Observation` in SI units, shape (SIZE, N).
        z: the rows that a filter with faults returns for it, shape (`FAULT_FILTER_ROWS`, N).
        vehicle: the nominal one.
    """
    known = repeated(np.array(vehicle.all_coefficients)[:, None], o.shape[1])
    return delay_kernel(len(known))(o=o, z=z, known=known)["after"]


@cache
def delay_kernel(size: int = VEHICLE_ROWS) -> Kernel:
    """Return the kernel of `faults.after_delay`; its inputs are observation, rows of a filter and vehicle.

    Args:
        size: number of rows of the vehicle, see `Vehicle.all_coefficients`.
    """

    def equation(o: Sequence[Symbol], z: Sequence[Symbol], known: Sequence[Symbol]) -> Mapping[str, Sequence[Any]]:
        terms, (estimate, faults, actions) = Observation(*o), parts(z)
        limits = terms.F_u_max, terms.F_r_max
        return {"after": after_delay(estimate, faults, actions, limits, terms.dt, with_names(known), SYMBOLS)}

    rows = {"o": len(Observation._fields), "z": FAULT_FILTER_ROWS, "known": size}
    return Kernel.traced(equation, rows, structural=True, blocked=True)


def parts(z: Sequence[Any]) -> tuple[Estimate, Faults, list[tuple[Any, Any]]]:
    """Return the parts of a filter's result: the estimate, the faults, and the last actions, which may not act yet."""
    estimate, faults = split(z[: STATE_SIZE + FAULTS])
    actions = z[STATE_SIZE + FAULTS :]
    return estimate, faults, list(zip(actions[::2], actions[1::2], strict=True))


def repeated(column: Array, n: int) -> Array:
    """Return a column (rows, 1) repeated for n vehicles, shape (rows, n)."""
    return column if n == 1 else np.repeat(column, n, axis=1)


@lru_cache(maxsize=8)
def _initial_memory(n: int, faults: bool, model: FilterModel) -> Array:
    rows = np.zeros((sum(Belief.sizes(faults, model)), n))
    Belief.of(rows, faults, model).noise[:] = np.square(model.first_noise)[:, None]
    rows.setflags(write=False)
    return rows.T


@cache
def filter_kernel(faults: bool = False, size: int = VEHICLE_ROWS, model: FilterModel = PLANE_FILTER) -> Kernel:
    """Return the kernel of one update; its inputs are observation, vehicle and tuning, and memory.

    Args:
        faults: whether faults are estimated.
        size: number of rows of the vehicle, see `Vehicle.all_coefficients`.
        model: the kind of motion.
    """
    seen, names = model.sea.model.Observation, FAULT_TUNING if faults else FILTER_TUNING

    def equation(o: Sequence[Symbol], known: Sequence[Symbol], memory: Sequence[Symbol]) -> Mapping[str, Sequence[Any]]:
        tuning = SimpleNamespace(**dict(zip(names, known[size:], strict=True)))
        before = Belief.of(memory, faults, model)
        after = updated(seen(*o), with_names(known[:size]), tuning, before, model)
        return {"after": [row for part in after for row in part]}

    rows = {"o": len(seen._fields), "known": size + len(names), "memory": sum(Belief.sizes(faults, model))}
    return Kernel.traced(equation, rows, structural=True, blocked=True)
