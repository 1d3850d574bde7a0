"""What no competitor may know: all that the outside supplies to episodes, from the first step to the last."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from auv_gym.envs.lanes import plan_of, reference_tables
from auv_gym.physics.actuators import LONGEST_DELAY
from auv_gym.physics.dynamics import State
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.rows import filled, leaves
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.exogenous import Tape
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.simulation import PLANT, Parameters, step

BODY = 8  # the first entries of a `Plant`: the state and the forces that the actuators apply


def samples(scenario: Scenario, episodes: Sequence[Episode]) -> Array:
    """Return the samples (`simulation.Sample`) of N episodes at K + 1 control instants, shape (K + 1, SAMPLE, N).

    Raises:
        InfeasibleReferenceError: an episode's path cannot be followed.
    """
    n, instants = len(episodes), scenario.steps + 1
    tables = reference_tables(episodes, *plan_of(scenario))
    tape = Tape(n, instants)
    for i, (episode, table) in enumerate(zip(episodes, tables, strict=True)):
        tape.load(i, scenario, episode, table)
    return tape.read(np.arange(n), instants)


@dataclass(frozen=True)
class Truth:
    """The constants of N episodes and all samples of their tapes."""

    parameters: Parameters  # rows of shape (N,)
    samples: Array  # shape (K + 1, SAMPLE, N)

    @classmethod
    def of(cls, scenario: Scenario, episodes: Sequence[Episode]) -> Truth:
        """Return the truth about N episodes.

        Raises:
            InfeasibleReferenceError: an episode's path cannot be followed.
        """
        rows = np.array([leaves(scenario.parameters(episode)) for episode in episodes]).T
        return cls(Parameters.of(tuple(rows), scenario.parts), samples(scenario, episodes))

    def foretell(self, state: State, force: Array, sent: Array, k: NDArray[np.int64]) -> Array:
        """Return state and forces when the next command comes to act, shape (8, N): now, where there is no delay.

        Args:
            state: x, y, psi, u, v, r relative to the water, rows (N,).
            force: F_u, F_r of the actuators, shape (2, N).
            sent: the last `LONGEST_DELAY` actions, the latest first, shape (LONGEST_DELAY, 2, N).
            k: the control step of each episode, shape (N,).
        """
        nothing, (last, second, third) = np.zeros(len(k)), sent
        plant = filled(PLANT, (*state, *force, *last, *(nothing,) * 8, *second, *third))  # sensors remember nothing
        found = np.stack(plant[:BODY])
        for j in range(int(self.parameters.delay.max())):
            coming = self.samples[np.minimum(k + 1 + j, len(self.samples) - 1), :, np.arange(len(k))].T
            plant, _, _ = step(plant, (nothing, nothing), tuple(coming), self.parameters, ARRAYS)
            found = np.where(self.parameters.delay > j, np.stack(plant[:BODY]), found)
        return found


def nothing_sent(n: int) -> Array:
    """Return the actions sent before the start of N episodes, see `Truth.foretell`."""
    return np.zeros((LONGEST_DELAY, 2, n))
