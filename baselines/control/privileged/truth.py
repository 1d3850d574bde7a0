"""Full information: all exogenous inputs of episodes from first step to last, and a policy that acts on them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.envs.sub_environments import plan_of, reference_tables
from auv_gym.physics.actuators import LONGEST_DELAY
from auv_gym.physics.dynamics import State
from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.rows import filled, leaves
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.exogenous import ExogenousInputs
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.simulation import PLANT, Parameters, step
from baselines.policy import Memory

BODY = 8  # the first entries of a `Plant`: the state and the forces that the actuators apply


def samples(scenario: Scenario, episodes: Sequence[Episode]) -> Array:
    """Return the samples (`simulation.Sample`) of N episodes at K + 1 control instants, shape (K + 1, SAMPLE, N).

    Raises:
        InfeasibleReferenceError: an episode's path cannot be followed.
    """
    n, instants = len(episodes), scenario.steps + 1
    tables = reference_tables(episodes, *plan_of(scenario))
    inputs = ExogenousInputs(n, instants)
    for i, (episode, table) in enumerate(zip(episodes, tables, strict=True)):
        inputs.load(i, scenario, episode, table)
    return inputs.read(np.arange(n), instants)


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


class FullInformation(ABC):
    """A policy that decides on the true state, a `baselines.policy.Privileged`; what is observed does not count."""

    _truth: Truth | None = None

    @abstractmethod
    def _planned(self, scenario: Scenario, episodes: Sequence[Episode]) -> Truth:
        """Plan for N episodes, and return the truth about them."""

    @abstractmethod
    def _decided(self, state: State, force: Array, sent: Array, k: NDArray[np.int64]) -> Array:
        """Return the actions of N vehicles, shape (2, N); the arguments are those of `Truth.foretell`."""

    def prepare(self, scenario: Scenario, episodes: Sequence[Episode]) -> None:
        """Plan for N episodes that are to run side by side.

        Raises:
            InfeasibleReferenceError: an episode's path cannot be followed in still water.
        """
        self._truth = self._planned(scenario, episodes)
        self._dt, self._sent = scenario.control_dt, nothing_sent(len(episodes))

    def observe(self, env: Any) -> None:
        """Decide on the true state of the vector environment.

        Raises:
            RuntimeError: there is no plan, as `prepare` was not called.
        """
        self._check()
        k = np.rint(env.time / self._dt).astype(int)
        x, y, psi, u, v, r = env.state.T
        V_x, V_y = env.current.T
        V_u, V_v = to_body(V_x, V_y, np.cos(psi), np.sin(psi))
        action = self._decided((x, y, psi, u - V_u, v - V_v, r), env.force.T, self._sent, k)
        self._sent = np.concatenate((action[None], self._sent[:-1]))
        self._action = action.T.astype(np.float32)

    def predict(
        self,
        observation: NDArray[Any],
        state: Memory | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return the actions (N, 2) decided by the last `observe`, whatever the observation (N, 18) is.

        Raises:
            RuntimeError: there is no plan, as `prepare` was not called.
        """
        self._check()
        return self._action, state

    def _check(self) -> None:
        if self._truth is None:
            raise RuntimeError(
                "this policy needs prepare() before the reset and observe() before predict(), as evaluate.py calls them"
            )
