"""Agents whose network fails in the middle of an episode: dead, held, stuck, or with its weights shuffled."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import Vehicle
from auv_gym.task.policy import Policy, preview_of
from baselines.agents.agent import Agent
from baselines.agents.networks import OUTPUTS, Layers, Network
from baselines.agents.residual_policy import ResidualPolicy
from baselines.policy import Memory

SHUFFLE = 0
"""Seed of the order that shuffled weights are in: the same for every agent with a network of that size."""
_CORRECTION = 1
"""Which array of an agent's memory is its last correction, shape (N, OUTPUTS)."""


class Forward(Protocol):
    """What a `ResidualPolicy` asks of its network."""

    memory: int

    def forward(self, layers: Layers, x: Array, hidden: Array) -> tuple[Array, Array]:
        """Return actions and hidden state, see `baselines.agents.networks.Gru.forward`."""


class Told:
    """A network that says what it was told, whatever it sees; its hidden state stays as it is."""

    def __init__(self, network: Network, output: Array) -> None:
        """Take the place of a network for N vehicles, which may come block by block; output has shape (OUTPUTS, N)."""
        self.memory, self._output, self._next = network.memory, output, 0

    def forward(self, layers: Layers, x: Array, hidden: Array) -> tuple[Array, Array]:
        """Return the output for the vehicles whose turn it is, and the hidden state untouched."""
        del layers
        first, n = self._next, x.shape[1]
        self._next = (first + n) % self._output.shape[1]
        return self._output[:, first : first + n], hidden


class Shuffled:
    """A network with every array of its weights in a random order; the hidden state goes on as that makes it."""

    def __init__(self, agent: Agent, precision: str) -> None:
        rng = np.random.default_rng(SHUFFLE)
        self._network, self.memory = agent.network, agent.network.memory
        weights = {name: rng.permutation(w.ravel()).reshape(w.shape) for name, w in sorted(agent.weights.items())}
        self._layers = agent.network.prepared(weights, precision)

    def forward(self, layers: Layers, x: Array, hidden: Array) -> tuple[Array, Array]:
        """Return actions and hidden state of the shuffled weights."""
        del layers
        return self._network.forward(self._layers, x, hidden)


def _told(value: float | None) -> Callable[[Agent, Array, str], Forward]:
    """Return what makes a network that says one number for all, or None: the last correction."""

    def make(agent: Agent, correction: Array, precision: str) -> Forward:
        del precision
        return Told(agent.network, correction if value is None else np.full_like(correction, value))

    return make


def _shuffled(agent: Agent, correction: Array, precision: str) -> Forward:
    del correction
    return Shuffled(agent, precision)


FAILURES: Mapping[str, Callable[[Agent, Array, str], Forward]] = {
    "dead": _told(0.0),
    "held": _told(None),
    "stuck at +1": _told(1.0),
    "stuck at -1": _told(-1.0),
    "shuffled": _shuffled,
}
"""What takes the network's place, of the agent, the last correction (OUTPUTS, N) and the precision, by failure."""
SATURATED = ("stuck at +1", "stuck at -1")
"""The failures that ask for all of an authority."""


class Failing:
    """An agent whose network fails after some control steps of an episode, with Stable-Baselines3's `predict`.

    Its expert, if there is one, goes on, and so does all else: what a dead network leaves is the expert's action, bit
    for bit. It counts the steps of one rollout at a time.

    Raises:
        ValueError: there is no such failure.
    """

    def __init__(
        self, agent: Agent, failure: str, after: int, vehicle: Vehicle | None = None, precision: str = "float64"
    ) -> None:
        """Make the policy; vehicle and precision are those of `Agent.policy`."""
        if failure not in FAILURES:
            raise ValueError(f"unknown failure {failure!r}; allowed are {', '.join(FAILURES)}")
        policy: Policy = agent.policy(vehicle=vehicle, precision=precision)
        assert isinstance(policy, ResidualPolicy)
        self._agent, self._policy, self._precision = agent, policy, precision
        self.failure, self.after, self.preview, self._steps = failure, after, preview_of(policy), 0

    def predict(
        self,
        observation: NDArray[Any],
        state: Memory | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return the actions (N, 2) for observations (N, n) and the agent's memory; see `ResidualPolicy.predict`."""
        if state is None:
            self._steps, self._policy.network = 0, self._agent.network
        if self._steps == self.after:
            n = len(observation)
            last = np.zeros((n, OUTPUTS)) if state is None else state[_CORRECTION]
            broken: Any = FAILURES[self.failure](self._agent, last.T.copy(), self._precision)
            self._policy.network = broken
        self._steps += 1
        return self._policy.predict(observation, state, episode_start, deterministic)
