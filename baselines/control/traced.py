"""Controllers that run as compiled kernels, from control laws with memory that are written on components."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar, TypeAlias

import numpy as np

from auv_gym.codegen.graph import SYMBOLS, Symbol
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.namespaces import Array, Namespace, Number
from auv_gym.physics.vehicle import Coefficients, Vehicle
from auv_gym.task.observation import Observation
from baselines.estimation.kalman import VEHICLE_ROWS, repeated
from baselines.policy import Memory

LawEquation: TypeAlias = Callable[[Observation, Any, Any, Coefficients, Namespace], tuple[Any, tuple[Number, Number]]]
"""Function of the observation in SI units, the memory, the gains, the nominal vehicle and the namespace of the numbers;
returns the memory for the next call, and F_u [N], F_r [N m]."""


@dataclass(frozen=True)
class TracedLaw:
    """A law: its equation, and the types of its gains and its memory."""

    equation: LawEquation
    gains: Any  # a subclass of `NamedTuple`
    memory: Any  # a subclass of `NamedTuple`; all entries are zero at the start of an episode


class TracedController:
    """A traced law with its gains and a nominal vehicle, a `Controller`; its memory has shape (N, entries).

    Each law has a subclass with the attribute `law`.
    """

    law: ClassVar[TracedLaw]

    def __init__(self, gains: Mapping[str, float], vehicle: Vehicle) -> None:
        """Make the controller; its gains are the fields of `law.gains`."""
        self._known = np.array((*vehicle.coefficients, *self.law.gains(**gains)))[:, None]

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return (np.zeros((len(self.law.memory._fields), n)).T,)

    def forces(self, o: Observation, memory: Memory, extra: Array) -> tuple[Array, Array, Memory]:
        """Return F_u [N], F_r [N m], shape (N,), and the memory for the next call."""
        terms = np.array(o)
        known = repeated(self._known, terms.shape[1])
        result = _law_kernel(self.law)(o=terms, known=known, memory=memory[0].T)
        F_u, F_r = result["force"]
        return F_u, F_r, (result["after"].T,)


@cache
def _law_kernel(law: TracedLaw) -> Kernel:
    """Return the kernel of a law; its inputs are observation, vehicle and gains, and memory."""

    def equation(o: Sequence[Symbol], known: Sequence[Symbol], memory: Sequence[Symbol]) -> Mapping[str, Sequence[Any]]:
        vehicle, gains = Coefficients(*known[:VEHICLE_ROWS]), law.gains(*known[VEHICLE_ROWS:])
        after, force = law.equation(Observation(*o), law.memory(*memory), gains, vehicle, SYMBOLS)
        return {"after": after, "force": force}

    rows = {"o": len(Observation._fields), "known": VEHICLE_ROWS + len(law.gains._fields)}
    return Kernel.traced(equation, {**rows, "memory": len(law.memory._fields)}, structural=True, blocked=True)
