"""How a law with memory that is written on components becomes a controller that runs as a compiled kernel."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, TypeAlias

import numpy as np

from auv_gym.codegen.graph import SYMBOLS, Symbol
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.dynamics import rk4_step
from auv_gym.physics.namespaces import Array, Namespace, Number
from auv_gym.physics.vehicle import Coefficients, Vehicle
from auv_gym.task.observation import Observation
from baselines.estimation.kalman import VEHICLE_ROWS, repeated
from baselines.policy import Memory

LawEquation: TypeAlias = Callable[[Observation, Any, Any, Coefficients, Namespace], tuple[Any, tuple[Number, Number]]]
"""Takes the observation in SI units, what is remembered, the gains, the vehicle as it is known and the namespace of the
numbers; returns what is to be remembered, and F_u [N], F_r [N m]."""


@dataclass(frozen=True)
class TracedLaw:
    """A law: its equation, and the `NamedTuple` of its gains and of what it remembers, which is zeros at first."""

    equation: LawEquation
    gains: Any
    memory: Any


class TracedController:
    """A traced law with gains for a vehicle, a `Controller`; its memory has shape (N, entries).

    A class for each law names it as `law`.
    """

    law: ClassVar[TracedLaw]

    def __init__(self, gains: Mapping[str, float], vehicle: Vehicle) -> None:
        """Make the controller; its gains are the fields of `law.gains`."""
        self._known = np.array((*vehicle.coefficients, *self.law.gains(**gains)))[:, None]

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return (np.zeros((len(self.law.memory._fields), n)).T,)

    def forces(self, o: Observation, memory: Memory, extra: Array) -> tuple[Array, Array, Memory]:
        """Return F_u [N], F_r [N m], shape (N,), and the memory to hand in next."""
        terms = np.array(o)
        known = repeated(self._known, terms.shape[1])
        found = _law_kernel(self.law)(o=terms, known=known, memory=memory[0].T)
        F_u, F_r = found["force"]
        return F_u, F_r, (found["after"].T,)


@cache
def _law_kernel(law: TracedLaw) -> Kernel:
    """Return the kernel of a law, which takes observation, vehicle and gains, and what is remembered."""

    def equation(o: Sequence[Symbol], known: Sequence[Symbol], memory: Sequence[Symbol]) -> Mapping[str, Sequence[Any]]:
        vehicle, gains = Coefficients(*known[:VEHICLE_ROWS]), law.gains(*known[VEHICLE_ROWS:])
        after, force = law.equation(Observation(*o), law.memory(*memory), gains, vehicle, SYMBOLS)
        return {"after": after, "force": force}

    rows = {"o": len(Observation._fields), "known": VEHICLE_ROWS + len(law.gains._fields)}
    return Kernel.traced(equation, {**rows, "memory": len(law.memory._fields)}, structural=True, blocked=True)


def foreseen_velocities(
    o: Observation,
    last: Sequence[Number],
    accelerations: Sequence[Number],
    vehicle: Coefficients,
    ns: Namespace,
) -> tuple[Number, ...]:
    """Return u, v [m/s], r [rad/s] that the model in still water has made of the last ones under the last command.

    Args:
        o: the observation in SI units.
        last: u, v, r at the last observation.
        accelerations: of surge, sway and yaw by loads beyond the model [m/s^2], [rad/s^2].
        vehicle: as it is known.
        ns: the namespace of the numbers.
    """
    c, (X, Y, N) = vehicle, accelerations
    load = (o.a_u * o.F_u_max + c.m11 * X, c.m22 * Y, o.a_r * o.F_r_max + c.m33 * N)
    return rk4_step((0.0, 0.0, 0.0, *last), load, c, o.dt, ns=ns)[3:]


def effective_periods(dt: Number, vehicle: Coefficients, ns: Namespace) -> tuple[Number, Number, Number]:
    """Return for surge, sway and yaw what a constant acceleration changes the velocity by in a period, over it [s].

    It is less than dt, as the drag takes some of the change back meanwhile.

    Args:
        dt: control period [s].
        vehicle: as it is known; its linear drag counts.
        ns: the namespace of the numbers.
    """
    c = vehicle
    rates = c.d11 / c.m11, c.d22 / c.m22, c.d33 / c.m33
    surge, sway, yaw = ((1 - ns.exp(-rate * dt)) / rate for rate in rates)
    return surge, sway, yaw
