"""Full information about episodes, with all exogenous inputs, and the base class of policies that use it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.effects import PACKAGE, Autopilot
from auv_gym.effects.actuators import LONGEST_DELAY, Delay
from auv_gym.effects.space import SPACE_PACKAGE
from auv_gym.physics.dynamics import State
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.exogenous import ExogenousInputs
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.simulation import Parameters, constants_of, parameter_row, step
from baselines.policy import Memory


def samples(scenario: Scenario, episodes: Sequence[Episode]) -> Array:
    """Return the samples (`simulation.Sample`) of N episodes at K + 1 control instants, shape (K + 1, SAMPLE, N).

    Raises:
        InfeasibleReferenceError: an episode's path cannot be followed.
    """
    n, instants = len(episodes), scenario.steps + 1
    inputs = ExogenousInputs(n, instants, scenario.parts)
    for i, episode in enumerate(episodes):
        inputs.load(i, scenario, episode, scenario.planner.table(episode.path))
    return inputs.read(np.arange(n), instants)


@dataclass(frozen=True)
class Truth:
    """Constants and all exogenous inputs of N episodes."""

    parameters: Parameters  # rows of shape (N,)
    samples: Array  # shape (K + 1, SAMPLE, N)

    @classmethod
    def of(cls, scenario: Scenario, episodes: Sequence[Episode]) -> Truth:
        """Return the full information about N episodes.

        Raises:
            InfeasibleReferenceError: an episode's path cannot be followed.
            ValueError: the scenario has an effect that is not one of the package.
        """
        known = {*PACKAGE, *SPACE_PACKAGE} - {Autopilot}
        if own := [effect.name for effect in scenario.parts.effects if effect not in known]:
            raise ValueError(f"full information does not include the effect {own[0]!r}: leave this policy out")
        rows = np.array([parameter_row(scenario.parameters(episode)) for episode in episodes]).T
        return cls(scenario.parts.parameters(tuple(rows)), samples(scenario, episodes))

    @property
    def delay(self) -> Any:
        """Control periods until a command acts, a number or shape (N,)."""
        return constants_of(self.parameters, Delay).periods

    def state_after_delay(self, state: State, force: Array, sent: Array, k: NDArray[np.int64]) -> Array:
        """Return state and forces when the next command begins to act, shape (8, N); without delay, those of now.

        Args:
            state: x, y, psi, u, v, r relative to the water, rows (N,); in space those of its model.
            force: F_u, F_r of the actuators, shape (channels, N).
            sent: the last `LONGEST_DELAY` actions, the latest first, shape (LONGEST_DELAY, channels, N).
            k: the control step of each episode, shape (N,).
        """
        zero, (last, second, third), places = np.zeros(len(k)), sent, self.parameters.parts.places
        memory = [zero] * places.sizes[1]  # states of sensors do not matter
        if (place := places.memory.get(Delay)) is not None:
            memory[place] = [sent for channel in zip(second, third, strict=True) for sent in channel]
        model = self.parameters.parts.model
        body, idle = model.forces.stop, (zero,) * len(model.channels)
        plant = model.Plant._make((*state, *force, *last, tuple(memory)))
        after = np.stack(plant[:body])
        delay = np.broadcast_to(self.delay, len(k))
        for j in range(int(delay.max())):
            sample = self.samples[np.minimum(k + 1 + j, len(self.samples) - 1), :, np.arange(len(k))].T
            plant, _, _ = step(plant, idle, tuple(sample), self.parameters, ARRAYS)
            after = np.where(delay > j, np.stack(plant[:body]), after)
        return after


def no_actions(n: int, channels: int = 2) -> Array:
    """Return the argument `sent` of `Truth.state_after_delay` at the start of n episodes."""
    return np.zeros((LONGEST_DELAY, channels, n))


class FullInformationPolicy(ABC):
    """A policy that acts on the true state, a `baselines.policy.Privileged`; it does not use the observation."""

    _truth: Truth | None = None

    @abstractmethod
    def _prepared(self, scenario: Scenario, episodes: Sequence[Episode]) -> Truth:
        """Plan for N episodes, and return the full information about them."""

    @abstractmethod
    def _actions(self, state: State, force: Array, sent: Array, k: NDArray[np.int64]) -> Array:
        """Return the actions of N vehicles, shape (2, N); arguments as in `Truth.state_after_delay`."""

    def prepare(self, scenario: Scenario, episodes: Sequence[Episode]) -> None:
        """Plan for N episodes that will run side by side.

        Raises:
            InfeasibleReferenceError: an episode's path cannot be followed in still water.
        """
        self._truth = self._prepared(scenario, episodes)
        channels = len(scenario.parts.model.channels)
        self._dt, self._sent = scenario.control_dt, no_actions(len(episodes), channels)

    def observe(self, env: Any) -> None:
        """Compute the actions from the true state of the vector environment.

        Raises:
            RuntimeError: `prepare` was not called, so there is no plan.
        """
        self._check()
        assert self._truth is not None
        k = np.rint(env.time / self._dt).astype(int)
        ground = self._truth.parameters.parts.model.over_ground
        state = ground(tuple(env.state.T), tuple(-env.current.T), ARRAYS)  # relative to the water
        action = self._actions(state, env.force.T, self._sent, k)
        self._sent = np.concatenate((action[None], self._sent[:-1]))
        self._action = action.T.astype(np.float32)

    def predict(
        self,
        observation: NDArray[Any],
        state: Memory | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return the actions (N, 2) of the last `observe`; the observation (N, 18) is not used.

        Raises:
            RuntimeError: `prepare` was not called, so there is no plan.
        """
        self._check()
        return self._action, state

    def _check(self) -> None:
        if self._truth is None:
            raise RuntimeError(
                "this policy needs prepare() before the reset and observe() before predict(), as evaluate.py calls them"
            )
