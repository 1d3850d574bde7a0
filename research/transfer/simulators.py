"""A simulator of vehicles with six degrees of freedom, for `research.transfer.bodies`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, Protocol

import numpy as np

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.namespaces import Array, Namespace
from auv_gym.scenarios.vehicles import vehicle_model
from research.transfer.otter import OTTER
from research.transfer.remus100 import REMUS100
from research.transfer.six_dof import AS_PUBLISHED, Deviation, Inputs, Vector

STEP = 0.02  # [s] longest integration step, as in the source
_PLANAR = 6  # x, y, psi, u, v, r
_FORCES = 2  # F_u, F_r


class _Model(Protocol):
    """The equations of a vehicle whose state is a row of `size` numbers."""

    def __hash__(self) -> int:
        """Return a hash: equations are compiled once for each model."""

    @property
    def name(self) -> str:
        """Name of the vehicle, as in `scenarios.vehicles.vehicle_model`."""

    @property
    def size(self) -> int:
        """Number of state variables."""

    def placed(self, states: Array) -> Array:
        """Return the rows, shape (size, n), for x, y, psi, u, v, r of shape (6, n); all else is in equilibrium."""

    def seen(self, rows: Vector, ns: Namespace) -> tuple[Vector, Vector]:
        """Return x, y, psi, u, v, r, level and relative to the water, and F_u [N], F_r [N m] of the actuators."""

    def orders(self, first: Vector, inputs: Inputs, ns: Namespace) -> Sequence[Any]:
        """Return the commands of the inner loops to the actuators, from the rows at the beginning of a step."""

    def rates(self, rows: Vector, orders: Vector, inputs: Inputs, d: Deviation, ns: Namespace) -> Sequence[Any]:
        """Return the time derivative of the rows."""


SIX_DOF_MODELS: Mapping[str, _Model] = {model.name: model for model in (REMUS100, OTTER)}
"""The models by the names of their vehicles."""


RATES_ROWS = {
    "inputs": len(Inputs._fields),
    "deviation": len(Deviation._fields),
    "level": _PLANAR,
    "forces": _FORCES,
}
"""Numbers of rows of the arrays of a `rates_kernel`; the other arrays have those of the vehicle's state."""


@cache
def rates_kernel(model: _Model) -> Kernel:
    """Return the kernel of a vehicle's rates, planar state and forces.

    The commands to its actuators follow from the rows `began` at the beginning of a step.
    """

    def equation(began: Any, rows: Any, inputs: Any, deviation: Any) -> Mapping[str, Sequence[Any]]:
        acting = Inputs(*inputs)
        orders = model.orders(began, acting, SYMBOLS)
        level, forces = model.seen(rows, SYMBOLS)
        rates = model.rates(rows, orders, acting, Deviation(*deviation), SYMBOLS)
        return {"rates": rates, "level": level, "forces": forces}

    sizes = {array: RATES_ROWS[array] for array in ("inputs", "deviation")}
    return Kernel.traced(equation, {"began": model.size, "rows": model.size, **sizes})


def _of_point(states: Array, eps: float) -> Array:
    """Return x, y, psi, u, v, r of a point that is eps [m] ahead of the point of the given ones, shape (6, n)."""
    x, y, psi, u, v, r = states
    return np.array([x + eps * np.cos(psi), y + eps * np.sin(psi), psi, u, v + eps * r, r])


class SixDofSimulator:
    """N vehicles of one of the `SIX_DOF_MODELS`, whose equations are compiled.

    Positions and velocities are those of the tracked point of the planar model: positions in the plane, seen from
    above; u, v relative to the water, level and along the heading.

    Args:
        vehicle: its name.
        n: N.

    Raises:
        ValueError: there is no such vehicle.
    """

    def __init__(self, vehicle: str, n: int) -> None:
        if vehicle not in SIX_DOF_MODELS:
            raise ValueError(
                f"{vehicle!r} is no vehicle with six degrees of freedom; allowed are {', '.join(SIX_DOF_MODELS)}"
            )
        self._model = SIX_DOF_MODELS[vehicle]
        known = vehicle_model(vehicle).vehicle
        self._eps, self._side = known.eps, known.eps * known.m22 / known.m33
        size = self._model.size
        rows = {**RATES_ROWS, "began": size, "rows": size, "rates": size}
        self._arrays = {array: np.zeros((count, n)) for array, count in rows.items()}
        self._arrays["deviation"][:] = np.array(AS_PUBLISHED)[:, None]
        self._run = rates_kernel(self._model).bound(**self._arrays)

    @property
    def rows(self) -> Array:
        """States of the vehicles, shape (size, N)."""
        return self._arrays["began"]

    def place(self, indices: Any, states: Array, deviations: Array) -> None:
        """Set the states of n of the vehicles, with all other states in equilibrium.

        Args:
            indices: index of the vehicles.
            states: x, y, psi, u, v, r, shape (6, n).
            deviations: rows of a `six_dof.Deviation`, shape (9, n).
        """
        self.rows[:, indices] = self._model.placed(_of_point(states, -self._eps))
        self._arrays["deviation"][:, indices] = deviations

    def advance(self, inputs: Array, dt: float) -> tuple[Array, Array]:
        """Advance by dt [s] with the rows of `six_dof.Inputs`, shape (7, N).

        Returns:
            x, y, psi, u, v, r, shape (6, N), and F_u [N], F_r [N m] of the actuators, shape (2, N).
        """
        acting = Inputs(*inputs)  # a yaw moment from outside comes with a side force, as in the planar model
        self._arrays["inputs"][:] = acting._replace(Y=acting.Y - self._side * acting.N)
        steps = math.ceil(dt / STEP - 1e-9)
        for _ in range(steps):
            self._step(dt / steps)
        self._rates(0.0)
        return _of_point(self._arrays["level"], self._eps), self._arrays["forces"].copy()

    def _step(self, h: float) -> None:
        """Advance by a classical Runge-Kutta step of h [s]."""
        slope = self._rates(0.0).copy()
        for share, weight in ((0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
            slope += weight * self._rates(share * h)
        self.rows[:] += h / 6 * slope

    def _rates(self, ahead: float) -> Array:
        """Return the rates at the rows that the last rates lead to in a time [s] from the beginning of the step."""
        arrays = self._arrays
        np.multiply(arrays["rates"], ahead, out=arrays["rows"])
        arrays["rows"] += arrays["began"]
        self._run(0, 1)
        return arrays["rates"]
