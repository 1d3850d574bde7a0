"""A simulator of vehicles with six degrees of freedom, in place of the planar equations of motion of the environments.

Only the dynamics differ: commanded forces, delays, current, waves, sensors and task are those of `simulation.step`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.namespaces import ARRAYS, Array, Namespace, Number
from auv_gym.physics.space import SpaceCoefficients, SpaceVehicle, axes
from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.vehicles import vehicle_model
from auv_gym.task.kernels import OUTCOMES, MakeSimulator, Outcome, Side
from auv_gym.task.simulation import Force, Parts, State, current_at, ordered, plant_row, step
from auv_gym.task.space import SPACE
from research.transfer.otter import OTTER, Otter
from research.transfer.remus100 import REMUS100, Remus100, SpaceRemus100
from research.transfer.six_dof import AS_PUBLISHED, Deviation, ModelInputs

_STEP = 0.02  # [s] longest integration step, as in the source
SIX_DOF_MODELS: Mapping[str, Remus100 | Otter] = {model.name: model for model in (REMUS100, OTTER)}
"""The models by the names of their vehicles."""
IN_SPACE: Mapping[str, Remus100 | Otter] = {"remus100": SpaceRemus100()}
"""The models for scenarios in space."""
_IN_NED = np.array([1.0 if name in ("F_u", "V_x", "X") else -1.0 for name in ModelInputs._fields])[:, None]
"""Signs of inputs in the axes of `physics.space` that are to be in north-east-down axes, see `to_ned`."""


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
        self._eps = known.eps
        motion = self._model.motion
        self._signs = _IN_NED if motion is SPACE else 1.0
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

    def place(self, indices: Any, states: Array, deviations: Array) -> None:
        """Set the states of n of the vehicles, with all other states in equilibrium.

        Args:
            indices: index of the vehicles.
            states: x, y, psi, u, v, r, shape (6, n), or in space shape (10, n).
            deviations: rows of a `six_dof.Deviation`, shape (10, n).
        """
        self.rows[:, indices] = self._model.placed(_of_point(states, -self._eps))
        self._arrays["deviation"][:, indices] = deviations

    def advance(self, inputs: Array, dt: float) -> tuple[Array, Array]:
        """Advance by dt [s] with the rows of `six_dof.ModelInputs`, shape (11, N).

        Returns:
            The states, see `place`, and F_u [N], F_r [N m] of the actuators, shape (2, N); in space F_u, F_q, F_r.
        """
        self._arrays["inputs"][:] = inputs * self._signs
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


class SimulatorBodies:
    """N vehicles of another simulator with the interface `kernels.Simulator`.

    The actuator lag of an episode is ignored: the other simulator has its own.

    Args:
        simulator: the vehicles, with `place` and `advance` as `SixDofSimulator`.
        known: the known model of the vehicle.
        parts: optional parts of the simulation that are in use.
        samples: array for the rows of `simulation.Sample`, shape (T, `Parts.sample_rows`, N).
        parameters: array for the rows of `simulation.Parameters`, shape (`Parts.parameter_rows`, N).
    """

    def __init__(
        self, simulator: SixDofSimulator, known: Vehicle | SpaceVehicle, parts: Parts, samples: Array, parameters: Array
    ) -> None:
        n = samples.shape[-1]
        self.parts, self.action, self.outcome = parts, np.zeros((len(parts.model.channels), n)), np.zeros((OUTCOMES, n))
        self.now = Side(np.zeros((parts.plant_rows, n)), np.zeros((parts.model.layout.size, n)))
        self._known, self._samples, self._rows, self._simulator = known, samples, parameters, simulator

    @property
    def plant(self) -> Any:
        """The present state of the plant: rows of shape (N,)."""
        return self.parts.plant(tuple(self.now.plant))

    def place(self, indices: Any, plant: Array, observation: Array) -> None:
        """Set the plant and the observation of the vehicles with these indices, see `kernels.started`."""
        self.now.plant[:, indices], self.now.observation[:, indices] = plant, observation
        true = self.parts.parameters(tuple(self._rows[:, indices])).coefficients
        rows = np.broadcast_arrays(*deviation(true, self._known.coefficients))
        self._simulator.place(indices, plant[: len(self.parts.model.state)], np.array(rows))

    def step(self, row: int) -> None:
        """Advance by a control step with `action` and a row of the samples."""
        p = self.parts.parameters(tuple(self._rows))
        with np.errstate(all="ignore"):  # vehicles that have failed may have NaN states
            plant, terms, (reward, failed, squared, saturated) = step(
                self.plant, tuple(self.action), tuple(self._samples[row]), p, ARRAYS, self._moved
            )
            observation = self.parts.model.layout.encode(terms, ARRAYS, self.parts.bound_factor)
        self.outcome[:] = Outcome(reward, failed, np.sqrt(squared), saturated)
        self.now = Side(np.stack(plant_row(plant)), np.asarray(observation))

    def undo(self) -> None:
        """Raise RuntimeError. Only an environment that cannot plan an episode undoes a step; `rollout` plans none."""
        raise RuntimeError("a step of another simulator cannot be undone")

    def _moved(
        self, state: State, force: Force, command: Force, sample: Sequence[Number], p: Any, ns: Namespace
    ) -> tuple[State, Force]:
        """Return state and actuator forces one control period later, see `simulation.moved`."""
        model = p.parts.model
        names = (*(f"F_{channel}" for channel in model.channels), *model.current, *model.load)
        current = current_at(state, sample, p, ns)
        values = *ordered(command, state, sample, p, ns), *current, *sample[model.load_rows]
        inputs = np.broadcast_arrays(*ModelInputs(**dict(zip(names, values, strict=True))))
        after, forces = self._simulator.advance(np.array(inputs), float(np.max(p.h)) * p.parts.substeps)
        return tuple(after), tuple(forces)


def bodies(factory: Callable[[int], SixDofSimulator], known: Vehicle | SpaceVehicle) -> MakeSimulator:
    """Return the argument `simulator` of `rollout` that makes a simulator move the vehicles.

    Args:
        factory: makes the simulator of N vehicles.
        known: the known model of the vehicle.
    """
    return lambda parts, samples, parameters: SimulatorBodies(
        factory(samples.shape[-1]), known, parts, samples, parameters
    )
