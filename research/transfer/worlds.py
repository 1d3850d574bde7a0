"""Simulators of vehicles in six degrees of freedom, side by side: what an environment needs of one, and our own."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, Protocol

import numpy as np

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.namespaces import Array, Namespace
from research.transfer.otter import OTTER, OTTER_VARIANTS
from research.transfer.remus100 import REMUS100, REMUS100_VARIANTS
from research.transfer.six_dof import AS_PUBLISHED, Deviation, Outside, Vector

STEP = 0.02  # [s] longest integration step, that of the source
_LEVEL = 6  # x, y, psi, u, v, r
_FORCES = 2  # F_u, F_r


class _Model(Protocol):
    """The equations of a vehicle whose state is a row of `size` numbers."""

    def __hash__(self) -> int:
        """Tell it from others: equations are compiled once for each."""

    @property
    def name(self) -> str:
        """What `vehicle_names.vehicle_model` calls it."""

    @property
    def size(self) -> int:
        """How many numbers its state has."""

    def placed(self, states: Array) -> Array:
        """Return the rows, shape (size, n), of vehicles at rest but for x, y, psi, u, v, r, shape (6, n)."""

    def seen(self, rows: Vector, ns: Namespace) -> tuple[Vector, Vector]:
        """Return x, y, psi, u, v, r, level and relative to the water, and F_u [N], F_r [N m] of the actuators."""

    def orders(self, first: Vector, outside: Outside, ns: Namespace) -> Sequence[Any]:
        """Return what the inner loops order of the actuators, for the rows at the beginning of a step."""

    def rates(self, rows: Vector, orders: Vector, outside: Outside, d: Deviation, ns: Namespace) -> Sequence[Any]:
        """Return the time derivative of the rows."""


SIX_DOF_MODELS: Mapping[str, _Model] = {model.name: model for model in (REMUS100, OTTER)}
"""The vehicles by their names in the fleet."""
WORLD_VARIANTS: Mapping[str, Mapping[str, _Model]] = {"remus100": REMUS100_VARIANTS, "otter": OTTER_VARIANTS}
"""What each is without parts of itself, to see what makes a difference; the first is the vehicle."""


class World(Protocol):
    """N vehicles of another simulator.

    Positions are in the plane, seen from above; u, v are relative to the water, level and along the heading.
    """

    def place(self, lanes: Any, states: Array, deviations: Array) -> None:
        """Put n of the vehicles, an index of which is given, somewhere, everything else at rest.

        Args:
            lanes: which.
            states: x, y, psi, u, v, r, shape (6, n).
            deviations: rows of a `six_dof.Deviation`, shape (9, n).
        """

    def advance(self, outside: Array, dt: float) -> tuple[Array, Array]:
        """Go on by dt [s] with the rows of an `Outside`, shape (7, N).

        Returns:
            x, y, psi, u, v, r, shape (6, N), and F_u [N], F_r [N m] that the actuators give, shape (2, N).
        """

    def kept(self) -> Any:
        """Return a copy of all that it remembers."""

    def restore(self, kept: Any) -> None:
        """Be as when `kept` was asked."""


RATES_ROWS = {
    "outside": len(Outside._fields),
    "deviation": len(Deviation._fields),
    "level": _LEVEL,
    "forces": _FORCES,
}
"""Rows of the arrays of a `rates_kernel`, but for those that have as many as the vehicle's state."""


@cache
def rates_kernel(model: _Model) -> Kernel:
    """Return the kernel of a vehicle's rates and of what is seen of it.

    Orders to its actuators hold since the rows with which a step `began`.
    """

    def equation(began: Any, rows: Any, outside: Any, deviation: Any) -> Mapping[str, Sequence[Any]]:
        acting = Outside(*outside)
        orders = model.orders(began, acting, SYMBOLS)
        level, forces = model.seen(rows, SYMBOLS)
        rates = model.rates(rows, orders, acting, Deviation(*deviation), SYMBOLS)
        return {"rates": rates, "level": level, "forces": forces}

    sizes = {array: RATES_ROWS[array] for array in ("outside", "deviation")}
    return Kernel.traced(equation, {"began": model.size, "rows": model.size, **sizes})


class Own:
    """N vehicles of one of the `SIX_DOF_MODELS`, whose equations are compiled.

    Args:
        vehicle: its name, or its equations.
        n: N.

    Raises:
        ValueError: there is no such vehicle.
    """

    def __init__(self, vehicle: str | _Model, n: int) -> None:
        if isinstance(vehicle, str) and vehicle not in SIX_DOF_MODELS:
            raise ValueError(
                f"{vehicle!r} is no vehicle of six degrees of freedom; allowed are {', '.join(SIX_DOF_MODELS)}"
            )
        self._model = SIX_DOF_MODELS[vehicle] if isinstance(vehicle, str) else vehicle
        size = self._model.size
        rows = {**RATES_ROWS, "began": size, "rows": size, "rates": size}
        self._arrays = {array: np.zeros((count, n)) for array, count in rows.items()}
        self._arrays["deviation"][:] = np.array(AS_PUBLISHED)[:, None]
        self._run = rates_kernel(self._model).bound(**self._arrays)

    @property
    def rows(self) -> Array:
        """The vehicles' rows, shape (size, N)."""
        return self._arrays["began"]

    def place(self, lanes: Any, states: Array, deviations: Array) -> None:
        """See `World.place`."""
        self.rows[:, lanes], self._arrays["deviation"][:, lanes] = self._model.placed(states), deviations

    def advance(self, outside: Array, dt: float) -> tuple[Array, Array]:
        """See `World.advance`."""
        self._arrays["outside"][:] = outside
        steps = math.ceil(dt / STEP - 1e-9)
        for _ in range(steps):
            self._step(dt / steps)
        self._rates(0.0)
        return self._arrays["level"].copy(), self._arrays["forces"].copy()

    def _step(self, h: float) -> None:
        """Go on by a classical Runge-Kutta step of h [s]."""
        slope = self._rates(0.0).copy()
        for share, weight in ((0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
            slope += weight * self._rates(share * h)
        self.rows[:] += h / 6 * slope

    def _rates(self, ahead: float) -> Array:
        """Return the rates where the last ones lead to in a time [s] from the beginning of the step."""
        arrays = self._arrays
        np.multiply(arrays["rates"], ahead, out=arrays["rows"])
        arrays["rows"] += arrays["began"]
        self._run(0, 1)
        return arrays["rates"]

    def kept(self) -> Any:
        """See `World.kept`."""
        return {array: values.copy() for array, values in self._arrays.items()}

    def restore(self, kept: Any) -> None:
        """See `World.restore`."""
        for array, values in kept.items():
            self._arrays[array][:] = values
