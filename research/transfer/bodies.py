"""The vehicles of another simulator in the environments: only the dynamics model differs, all else is shared."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from auv_gym.physics.actuators import ordered
from auv_gym.physics.dynamics import Force, State
from auv_gym.physics.namespaces import ARRAYS, Array, Namespace, Number
from auv_gym.physics.rows import flatten, unflatten
from auv_gym.physics.vehicle import Coefficients, Vehicle
from auv_gym.task.kernels import ACTIONS, OUTCOMES, MadeBodies, Outcome, Side
from auv_gym.task.observation import SIZE, encode
from auv_gym.task.simulation import PLANT, PLANT_ROWS, Parameters, Parts, Plant, current_at, step
from research.transfer.simulators import SixDofSimulator
from research.transfer.six_dof import Deviation, Inputs

SimulatorFactory = Callable[[int], SixDofSimulator]
"""Returns a simulator with N vehicles."""


def deviation(true: Coefficients, known: Coefficients) -> Deviation:
    """Return the deviation of a true planar vehicle from the known one, as floats or rows of shape (N,)."""
    factors = true.d11 / known.d11, true.d22 / known.d22, true.d33 / known.d33
    quadratic = true.X_uu, true.Y_vv, true.N_rr
    usual = known.X_uu, known.Y_vv, known.N_rr
    more = (drag - factor * own for drag, factor, own in zip(quadratic, factors, usual, strict=True))
    return Deviation(true.m11 / known.m11, true.m22 / known.m22, true.m33 / known.m33, *factors, *more)


class SimulatorBodies:
    """N vehicles of a simulator with the interface `kernels.Bodies`.

    Commanded forces, delays, current, waves, sensors and task are those of `simulation.step`. The actuator lag of an
    episode is ignored: the other simulator has its own.

    Args:
        factory: makes the simulator.
        known: the planar model of the vehicle.
        parts: optional parts of the simulation that are in use.
        samples: array for the rows of `simulation.Sample`, shape (T, SAMPLE_ROWS, N).
        parameters: array for the rows of `simulation.Parameters`, shape (PARAMETER_ROWS, N).
    """

    def __init__(
        self, factory: SimulatorFactory, known: Vehicle, parts: Parts, samples: Array, parameters: Array
    ) -> None:
        n = samples.shape[-1]
        self.parts, self.action = parts, np.zeros((ACTIONS, n))
        self.now = Side(*(np.zeros((rows, n)) for rows in (PLANT_ROWS, SIZE, OUTCOMES)))
        self._known, self._samples, self._rows, self._simulator = known, samples, parameters, factory(n)

    @property
    def plant(self) -> Plant:
        """The present state of the plant: rows of shape (N,)."""
        return unflatten(PLANT, tuple(self.now.plant))

    def place(self, indices: Any, plant: Array, seen: Array) -> None:
        """Set the plant and the observation of the vehicles with these indices, see `kernels.started`."""
        self.now.plant[:, indices], self.now.seen[:, indices] = plant, seen
        true = Parameters.of(tuple(self._rows[:, indices]), self.parts).coefficients
        self._simulator.place(indices, plant[:6], np.array(deviation(true, self._known.coefficients)))

    def step(self, row: int) -> None:
        """Advance by a control step with `action` and a row of the samples."""
        p = Parameters.of(tuple(self._rows), self.parts)
        with np.errstate(all="ignore"):  # vehicles that have failed may have NaN states
            plant, terms, (reward, failed, squared, saturated) = step(
                self.plant, tuple(self.action), tuple(self._samples[row]), p, ARRAYS, self._moved
            )
            seen = encode(terms, ARRAYS, self.parts.span)
        outcome = Outcome(reward, failed, np.sqrt(squared), saturated)
        self.now = Side(np.stack(flatten(plant)), np.asarray(seen), np.stack([np.asarray(x, float) for x in outcome]))

    def undo(self) -> None:
        """Raise RuntimeError. Only an environment that cannot plan an episode undoes a step; `rollout` plans none."""
        raise RuntimeError("a step of another simulator cannot be undone")

    def _moved(
        self, state: State, force: Force, command: Force, sample: Sequence[Number], p: Parameters, ns: Namespace
    ) -> tuple[State, Force]:
        """Return state and actuator forces one control period later, see `simulation.moved`."""
        x, y, _, u, *_ = state
        _, _, _, _, _, _, _, _, V_x, V_y, X, Y, N, *_ = sample
        inputs = Inputs(*ordered(command, u, p, ns), *current_at(x, y, (V_x, V_y), p, ns), X, Y, N)
        after, forces = self._simulator.advance(np.stack(inputs), float(np.max(p.h)) * p.parts.substeps)
        return (after[0], after[1], after[2], after[3], after[4], after[5]), (forces[0], forces[1])


def bodies(factory: SimulatorFactory, known: Vehicle) -> MadeBodies:
    """Return the argument `bodies` of `rollout` that makes a simulator move the vehicles.

    Args:
        factory: makes the simulator.
        known: the planar model of the vehicle.
    """
    return lambda parts, samples, parameters: SimulatorBodies(factory, known, parts, samples, parameters)
