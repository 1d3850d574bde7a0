"""A simulator of vehicles with six degrees of freedom, a `Plant` in place of the equations of motion."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.namespaces import Array
from auv_gym.physics.space import SpaceCoefficients, axes
from auv_gym.scenarios.vehicles import vehicle_model
from auv_gym.task.space import SPACE
from baselines.evaluation.plants import input_names
from research.transfer.otter import OTTER, Otter
from research.transfer.remus100 import REMUS100, Remus100, SpaceRemus100
from research.transfer.six_dof import AS_PUBLISHED, Deviation, ModelInputs

_STEP = 0.02  # [s] longest integration step, as in the source
SIX_DOF_MODELS: Mapping[str, Remus100 | Otter] = {model.name: model for model in (REMUS100, OTTER)}
"""The models by the names of their vehicles."""
IN_SPACE: Mapping[str, Remus100 | Otter] = {"remus100": SpaceRemus100()}
"""The models for scenarios in space."""
_SAME_IN_NED = ("F_u", "V_x", "X")
"""Inputs in the axes of `physics.space` whose sign is the same in north-east-down axes, see `to_ned`."""


@cache
def rates_kernel(model: Remus100 | Otter) -> Kernel:
    """Return the kernel of a vehicle's rates, planar state and forces.

    The commands to its actuators follow from the rows `began` at the beginning of a step.
    """

    def equation(began: Any, rows: Any, inputs: Any, deviation: Any) -> Mapping[str, Sequence[Any]]:
        acting = ModelInputs(*inputs)
        orders = model.orders(began, acting, SYMBOLS)
        level, forces = model.seen(rows, SYMBOLS)
        rates = model.rates(rows, orders, acting, Deviation(*deviation), SYMBOLS)
        return {"rates": rates, "level": level, "forces": forces}

    inputs = {"inputs": len(ModelInputs._fields), "deviation": len(Deviation._fields)}
    return Kernel.traced(equation, {"began": model.size, "rows": model.size, **inputs})


def _of_point(states: Array, eps: float) -> Array:
    """Return the states of a point that is eps [m] ahead of that of the given ones: (6, n), or in space (10, n)."""
    if len(states) == len(SPACE.state):
        x, y, z, theta, psi, u, v, w, q, r = states
        a_x, a_y, a_z = axes(theta, psi, np)[0]
        return np.array([x + eps * a_x, y + eps * a_y, z + eps * a_z, theta, psi, u, v + eps * r, w - eps * q, q, r])
    x, y, psi, u, v, r = states
    return np.array([x + eps * np.cos(psi), y + eps * np.sin(psi), psi, u, v + eps * r, r])


class SixDofSimulator:
    """N vehicles of one of the `SIX_DOF_MODELS`, whose equations are compiled.

    Positions and velocities are those of the tracked point of the planar model: positions in the plane, seen from
    above; u, v relative to the water, level and along the heading. In space they are a `space.State`.

    Args:
        vehicle: its name.
        n: N.
        models: `SIX_DOF_MODELS`, or `IN_SPACE`.

    Raises:
        ValueError: there is no such vehicle.
    """

    def __init__(self, vehicle: str, n: int, models: Mapping[str, Remus100 | Otter] = SIX_DOF_MODELS) -> None:
        if vehicle not in models:
            allowed = ", ".join(models)
            raise ValueError(f"{vehicle!r} is no vehicle with six degrees of freedom; allowed are {allowed}")
        self._model, known = models[vehicle], vehicle_model(vehicle).vehicle
        self._eps, motion = known.eps, self._model.motion
        self._known = vehicle_model(vehicle).in_space if motion is SPACE else known
        names = input_names(motion)
        self._order = [ModelInputs._fields.index(name) for name in names]
        kept = names if motion is not SPACE else _SAME_IN_NED
        self._signs = np.array([[1.0 if name in kept else -1.0] for name in names])
        rows = {"inputs": len(ModelInputs._fields), "deviation": len(Deviation._fields)}
        rows |= {"level": len(motion.state), "forces": len(motion.channels)}
        rows |= dict.fromkeys(("began", "rows", "rates"), self._model.size)
        self._arrays = {array: np.zeros((count, n)) for array, count in rows.items()}
        self._arrays["deviation"][:] = np.array(AS_PUBLISHED)[:, None]
        self._run = rates_kernel(self._model).bound(**self._arrays)

    @property
    def rows(self) -> Array:
        """States of the vehicles, shape (size, N)."""
        return self._arrays["began"]

    def place(self, indices: Any, states: Array, true: Any = None) -> None:
        """Set the states of n of the vehicles, with all other states in equilibrium.

        Args:
            indices: index of the vehicles.
            states: x, y, psi, u, v, r, shape (6, n), or in space shape (10, n).
            true: coefficients of the vehicles, see `deviation`; None: as published.
        """
        self.rows[:, indices] = self._model.placed(_of_point(states, -self._eps))
        rows = AS_PUBLISHED if true is None else deviation(true, self._known.coefficients)
        self._arrays["deviation"][:, indices] = [np.broadcast_to(x, states.shape[1]) for x in rows]

    def advance(self, inputs: Array, dt: float) -> tuple[Array, Array]:
        """Advance by dt [s] with rows of `plants.input_names`.

        Returns:
            The states, see `place`, and F_u [N], F_r [N m] of the actuators, shape (2, N); in space F_u, F_q, F_r.
        """
        self._arrays["inputs"][self._order] = inputs * self._signs
        steps = math.ceil(dt / _STEP - 1e-9)
        h = dt / steps
        for _ in range(steps):  # classical Runge-Kutta steps
            slope = self._rates(0.0).copy()
            for share, weight in ((0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
                slope += weight * self._rates(share * h)
            self.rows[:] += h / 6 * slope
        self._rates(0.0)
        return _of_point(self._arrays["level"], self._eps), self._arrays["forces"].copy()

    def _rates(self, ahead: float) -> Array:
        """Return the rates at the rows that the last rates lead to in a time [s] from the beginning of the step."""
        arrays = self._arrays
        np.multiply(arrays["rates"], ahead, out=arrays["rows"])
        arrays["rows"] += arrays["began"]
        self._run(0, 1)
        return arrays["rates"]


def deviation(true: Any, known: Any) -> Deviation:
    """Return the deviation of a true vehicle from the known one, as floats or rows of shape (N,).

    Both are `Coefficients`, or in space `SpaceCoefficients`, whose planes have the same factors.
    """
    if isinstance(true, SpaceCoefficients):
        return deviation(true.level, known.level)._replace(stiffness=true.stiffness / known.stiffness)
    drag = d_u, d_v, d_r = true.d11 / known.d11, true.d22 / known.d22, true.d33 / known.d33
    pairs = (true.X_uu, known.X_uu), (true.Y_vv, known.Y_vv), (true.N_rr, known.N_rr)
    quadratic = (own - factor * usual for (own, usual), factor in zip(pairs, drag, strict=True))
    return Deviation(true.m11 / known.m11, true.m22 / known.m22, true.m33 / known.m33, d_u, d_v, d_r, *quadratic)
