"""The vehicles of another simulator in the environments: only what moves them is another, everything else is shared."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from auv_gym.physics.actuators import ordered
from auv_gym.physics.dynamics import Force, State
from auv_gym.physics.namespaces import ARRAYS, Array, Namespace, Number
from auv_gym.physics.rows import filled, leaves
from auv_gym.physics.vehicle import Coefficients, Vehicle
from auv_gym.task.kernels import ACTIONS, OUTCOMES, MadeBodies, Outcome, Side
from auv_gym.task.observation import SIZE, encode
from auv_gym.task.simulation import PLANT, PLANT_ROWS, Parameters, Parts, Plant, current_at, step
from research.transfer.six_dof import Deviation, Outside
from research.transfer.worlds import World

MadeWorld = Callable[[int], World]
"""Makes N vehicles of a simulator."""


def deviation(true: Coefficients, known: Coefficients) -> Deviation:
    """Return how a true vehicle in the plane differs from the known one; floats, or rows of shape (N,)."""
    factors = true.d11 / known.d11, true.d22 / known.d22, true.d33 / known.d33
    quadratic = true.X_uu, true.Y_vv, true.N_rr
    usual = known.X_uu, known.Y_vv, known.N_rr
    more = (mine - factor * own for mine, factor, own in zip(quadratic, factors, usual, strict=True))
    return Deviation(true.m11 / known.m11, true.m22 / known.m22, true.m33 / known.m33, *factors, *more)


class WorldBodies:
    """N vehicles of a `World`, as `kernels.Bodies`.

    The forces that the actuators are asked for, the delays, the current, the waves, what the sensors say and what the
    task makes of it are those of `simulation.step`. A lag of the episode is ignored: the other simulator has its own.

    Args:
        made: makes the vehicles.
        known: the vehicle in the plane that stands for the published one.
        parts: what is in use of the simulation.
        samples: where the rows of `simulation.Sample` will be, shape (T, SAMPLE_ROWS, N).
        parameters: where the rows of `simulation.Parameters` will be, shape (PARAMETER_ROWS, N).
    """

    def __init__(self, made: MadeWorld, known: Vehicle, parts: Parts, samples: Array, parameters: Array) -> None:
        n = samples.shape[-1]
        self.parts, self.action = parts, np.zeros((ACTIONS, n))
        self.now = Side(*(np.zeros((rows, n)) for rows in (PLANT_ROWS, SIZE, OUTCOMES)))
        self._known, self._samples, self._rows, self._world = known, samples, parameters, made(n)
        self._before: tuple[Side, Any] = (self.now, self._world.kept())

    @property
    def plant(self) -> Plant:
        """What is now: rows of shape (N,)."""
        return filled(PLANT, tuple(self.now.plant))

    def place(self, lanes: Any, plant: Array, seen: Array) -> None:
        """Put n of the vehicles, an index of which is given, where `kernels.begun` says, now."""
        self.now.plant[:, lanes], self.now.seen[:, lanes] = plant, seen
        true = Parameters.of(tuple(self._rows[:, lanes]), self.parts).coefficients
        differs = deviation(true, self._known.coefficients)
        self._world.place(lanes, plant[:6], np.array(differs))

    def step(self, row: int) -> None:
        """Go on by a control step, with `action` and a row of the samples."""
        self._before = self.now, self._world.kept()
        p = Parameters.of(tuple(self._rows), self.parts)
        with np.errstate(all="ignore"):  # what is lost may be no number any more
            plant, terms, (reward, failed, squared, saturated) = step(
                self.plant, tuple(self.action), tuple(self._samples[row]), p, ARRAYS, self._moved
            )
            seen = encode(terms, ARRAYS, self.parts.span)
        outcome = Outcome(reward, failed, np.sqrt(squared), saturated)
        self.now = Side(np.stack(leaves(plant)), np.asarray(seen), np.stack([np.asarray(x, float) for x in outcome]))

    def undo(self) -> None:
        """Take the last step back."""
        self.now, kept = self._before
        self._world.restore(kept)

    def _moved(
        self, state: State, force: Force, command: Force, sample: Sequence[Number], p: Parameters, ns: Namespace
    ) -> tuple[State, Force]:
        """Return state and actuators' forces one control period later, see `simulation.moved`."""
        x, y, _, u, *_ = state
        _, _, _, _, _, _, _, _, V_x, V_y, X, Y, N, *_ = sample
        outside = Outside(*ordered(command, u, p, ns), *current_at(x, y, (V_x, V_y), p, ns), X, Y, N)
        after, forces = self._world.advance(np.stack(outside), float(np.max(p.h)) * p.parts.substeps)
        return (after[0], after[1], after[2], after[3], after[4], after[5]), (forces[0], forces[1])


def bodies(made: MadeWorld, known: Vehicle) -> MadeBodies:
    """Return what `rollout` takes to let a simulator move the vehicles.

    Args:
        made: makes its vehicles.
        known: the vehicle in the plane that stands for the published one.
    """
    return lambda parts, samples, parameters: WorldBodies(made, known, parts, samples, parameters)
