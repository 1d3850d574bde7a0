"""A policy whose memory is looked at or changed as it runs, and an untrained network beside the trained one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import Vehicle
from auv_gym.task.policy import Policy, preview_of
from baselines.agents.agent import Agent
from baselines.agents.names import agent_folder
from baselines.agents.networks import Layers, Network
from baselines.agents.residual_policy import BLOCK, ResidualPolicy
from baselines.policies import make_policy
from baselines.policy import Memory
from baselines.similar import made_for
from research.robustness.situations import PRECISION

AT_ONCE = BLOCK
"""Most vehicles at a time whose network is listened to."""
HIDDEN = 2
"""Which array of an agent's memory is that of its network, see `ResidualPolicy`."""
REMEMBERED = 0
"""Which array of an agent's memory is what its inputs remember: integrals, and filters if it has some."""

Watch = Callable[[int, Array, Memory], None]
"""Told of a control instant, its number, the observations, shape (N, terms), and the memory behind the decision."""
Swap = Callable[[Memory], Memory]
"""Returns the memory that a policy goes on with, in place of its own."""


class Tapped:
    """A policy, with Stable-Baselines3's `predict`, that is watched, and whose memory may be changed on the way.

    Args:
        policy: what acts.
        watch: told of each instant, behind the decision.
        swaps: what becomes of the memory in front of the decision at an instant, by its number.
    """

    def __init__(self, policy: Policy, watch: Watch | None = None, swaps: Mapping[int, Swap] | None = None) -> None:
        self.policy, self.preview = policy, preview_of(policy)
        self._watch, self._swaps, self._k = watch, swaps or {}, 0

    def predict(
        self,
        observation: NDArray[Any],
        state: Memory | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return what the policy does, and its memory."""
        if state is not None and self._k in self._swaps:
            state = self._swaps[self._k](state)
        action, memory = self.policy.predict(observation, state, episode_start, deterministic)
        if self._watch is not None:
            self._watch(self._k, observation, memory or ())
        self._k += 1
        return action, memory


def acting(name: str, vehicle: Vehicle) -> Policy:
    """Return a policy by name for a known vehicle; the network of an agent computes in `PRECISION`.

    Raises:
        OSError: an agent cannot be read.
        ValueError: there is no such policy.
    """
    if (folder := agent_folder(name)) is None:
        return make_policy(name, vehicle)
    return made_for(vehicle, lambda known: Agent.load(folder).policy(vehicle=known, precision=PRECISION))


def remembering(policy: Policy) -> ResidualPolicy | None:
    """Return the trained agent in a policy, perhaps wrapped in others, if its network remembers anything."""
    inner: Any = policy
    while not isinstance(inner, ResidualPolicy):
        inner = getattr(inner, "policy", None)
        if inner is None:
            return None
    return inner if inner.network.memory else None


class Beside:
    """A network, and one of its shape with untrained weights that is shown the same inputs.

    It takes the place of an agent's network: what it returns is the trained one's.

    Args:
        network: the agent's.
        seed: of the untrained weights.

    Attributes:
        inputs: what the network has been shown last, shape (inputs, N).
        hidden: what the untrained one remembers then, shape (memory, N).
    """

    def __init__(self, network: Network, seed: int = 0) -> None:
        self.network, self.memory = network, network.memory
        self._layers = network.prepared(untrained(network, np.random.default_rng(seed)), PRECISION)
        self.inputs, self.hidden = np.zeros((0, 0)), np.zeros((network.memory, 0))

    def forward(self, layers: Layers, x: Array, hidden: Array) -> tuple[Array, Array]:
        """Return what the trained network does, see `networks.Gru.forward`."""
        self.inputs = x.copy()
        if self.hidden.shape != hidden.shape:
            self.hidden = np.zeros_like(hidden)
        _, self.hidden = self.network.forward(self._layers, self.inputs, self.hidden)
        return self.network.forward(layers, x, hidden)


def untrained(network: Network, rng: np.random.Generator) -> dict[str, Array]:
    """Return weights as nobody has trained them: uniform, within one over the root of a unit's inputs; no biases."""
    return {
        name: rng.uniform(-1, 1, shape) / np.sqrt(shape[-1]) if len(shape) > 1 else np.zeros(shape)
        for name, shape in network.shapes.items()
    }
