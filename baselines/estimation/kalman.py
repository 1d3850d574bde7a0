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

from auv_gym.codegen.graph import Symbol
from auv_gym.codegen.kernel import Kernel
from auv_gym.codegen.matrices import symmetric
from auv_gym.intervals import check_number
from auv_gym.task import Observation
from auv_gym.vehicle import PAPER_VEHICLE, Coefficients, Vehicle
from baselines.estimation.filter_equations import BELIEF_ROWS, FIRST_NOISE, Belief, updated
from baselines.estimation.sea_model import Estimate
from baselines.policy import Array, Memory

VEHICLE_ROWS = len(Coefficients._fields)  # how many rows tell a kernel of the vehicle


@dataclass(frozen=True)
class Tuning:
    """How much is believed to change, as standard deviations.

    With the reference speed U, speeds are in units of U and loads in units of the drag d11 U, d22 U, d33 U / (1 m).
    What drifts like a random walk has its deviation after one second.
    """

    acceleration: float = 0.006  # drift of u, v that nothing else explains; that of r is in [rad/s]
    current: float = 0.005  # drift
    gust: float = 0.012  # [1/s] of the current's rate
    surge_bias: float = 0.2  # drift of the slowly varying load
    sway_bias: float = 0.1
    yaw_bias: float = 0.15
    surge_waves: float = 0.15  # of the wave load
    sway_waves: float = 0.4
    yaw_waves: float = 0.12

    def __post_init__(self) -> None:
        for field in fields(self):
            check_number(f"tuning {field.name}", getattr(self, field.name), 0, 1e6)


TUNING = tuple(field.name for field in fields(Tuning))
"""Names of the fields of `Tuning`."""


class ExtendedKalmanFilter:
    """The filter, for N vehicles at once.

    Its memory is one array, the rows of a `filter_equations.Belief`, shape (N, BELIEF_ROWS); `believed` tells them
    apart.
    """

    def __init__(self, vehicle: Vehicle = PAPER_VEHICLE, tuning: Tuning | None = None) -> None:
        """Make the filter for a vehicle as it is known."""
        self.vehicle, self.tuning = vehicle, tuning or Tuning()
        self._known = np.array((*vehicle.coefficients, *astuple(self.tuning)))[:, None]

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes, which must not be changed in place."""
        return (_first_belief(n),)

    def update(self, memory: Memory, o: Array) -> tuple[Memory, Array]:
        """Return the memory and the state after one more observation.

        Args:
            memory: as `start` or the last call returned it.
            o: the rows of an `Observation` in SI units, shape (SIZE, N).

        Returns:
            The memory, and the rows of an `Estimate`, shape (22, N).
        """
        known = repeated(self._known, o.shape[1])
        after = filter_kernel()(o=o, known=known, memory=memory[0].T)["after"]
        return (after.T,), Belief.of(after).state


def believed(memory: Memory) -> Belief:
    """Return the parts of a filter's memory as rows, count (N,), state (22, N), ..., covariance (N, 22, 22)."""
    belief = Belief.of(memory[0].T)
    covariance = np.array(symmetric(list(belief.covariance))).transpose(2, 0, 1)
    return belief._replace(count=belief.count[0], state=Estimate(*belief.state), covariance=covariance)


def repeated(column: Array, n: int) -> Array:
    """Return rows (rows, n) that hold the same for n vehicles, from a column (rows, 1)."""
    return column if n == 1 else np.repeat(column, n, axis=1)


@lru_cache(maxsize=4)
def _first_belief(n: int) -> Array:
    rows = np.zeros((BELIEF_ROWS, n))
    Belief.of(rows).noise[:] = np.square(FIRST_NOISE)[:, None]
    rows.setflags(write=False)
    return rows.T


@cache
def filter_kernel() -> Kernel:
    """Return the kernel of one update, which takes observation, vehicle and tuning, and memory."""

    def equation(o: Sequence[Symbol], known: Sequence[Symbol], memory: Sequence[Symbol]) -> Mapping[str, Sequence[Any]]:
        tuning = SimpleNamespace(**dict(zip(TUNING, known[VEHICLE_ROWS:], strict=True)))
        after = updated(Observation(*o), Coefficients(*known[:VEHICLE_ROWS]), tuning, Belief.of(memory))
        return {"after": [row for part in after for row in part]}

    rows = {"o": len(Observation._fields), "known": VEHICLE_ROWS + len(TUNING), "memory": BELIEF_ROWS}
    return Kernel.traced(equation, rows, structural=True, blocked=True)
