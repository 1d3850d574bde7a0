"""A trained agent as a policy: an expert's action plus a bounded correction by a network, on NumPy alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.namespaces import ARRAYS
from auv_gym.policy import Policy, corrected, preview_of
from auv_gym.preview import shared_preview
from auv_gym.task import SIZE
from baselines.agents.features import INTEGRALS, STANDARD, Inputs, scaled_errors
from baselines.agents.networks import Network, Weights
from baselines.policy import Array, Memory, batched, renewed


class ResidualPolicy:
    """command = clip(expert + authority * network(features)), with Stable-Baselines3's `predict`.

    Its memory: the integrals of the features, (N, INTEGRALS); the last correction, (N, 2); the network's hidden state,
    (N, hidden); and behind them whatever the expert remembers. A network that gives zero leaves the expert's actions as
    they are, bit for bit.
    """

    OWN = 3
    """Arrays of its memory in front of the expert's."""

    def __init__(
        self,
        expert: Policy,
        network: Network,
        weights: Weights,
        authority: tuple[float, float],
        region: Sequence[float] | None = None,
        inputs: Inputs = STANDARD,
    ) -> None:
        """Make the policy of checked weights; with a region, see `trust`, corrections fade outside of it."""
        self.region, self.inputs = None if region is None else np.array(region), inputs
        self.preview, self._seen, self._seen_by_expert = shared_preview(inputs.preview, preview_of(expert))
        self.expert, self.network, self.authority = expert, network, np.array(authority)
        self.weights = {name: np.asarray(w, dtype=np.float64) for name, w in weights.items()}

    def predict(
        self,
        observation: NDArray[Any],
        state: Memory | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return the action (2,) or actions (N, 2) and the memory, its arrays with leading axis N (1 for one).

        Memory begins anew where `state` is None or `episode_start`, shape (N,), is True.

        Raises:
            ValueError: the observation has the wrong shape, or `state` is of another number of vehicles.
        """
        rows, o, extra = batched(observation, self.preview)
        n = len(rows)
        fresh = np.zeros((n, INTEGRALS)), np.zeros((n, 2)), np.zeros((n, self.network.memory))
        integrals, correction, hidden = renewed(state and state[: self.OWN], fresh, episode_start)
        past: Memory | None = state[self.OWN :] if state else ()
        seen = np.hstack((rows[:, :SIZE], extra[:, self._seen_by_expert]))
        action, past = self.expert.predict(seen, past or None, episode_start)
        base = action.astype(np.float64)
        features, sums = self.inputs.update(o, tuple(extra[:, self._seen].T), base.T, correction.T, integrals.T, ARRAYS)
        correction, hidden = self.network.forward(self.weights, np.array(features).T, hidden)
        if self.region is not None:
            correction *= trust(np.array(scaled_errors(o, ARRAYS)), self.region)[:, None]
        action = corrected(base, self.authority, correction, ARRAYS).astype(np.float32)
        memory = np.array(sums).T, correction, hidden, *(past or ())
        return (action[0] if observation.ndim == 1 else action), memory


def trust(errors: Array, region: Array) -> Array:
    """Return the share of a correction that is applied, shape (N,): 1 inside a region, falling to 0 at twice its size.

    Args:
        errors: the first features, `features.ERRORS` rows of shape (N,).
        region: the largest magnitude of each that the network has learned from, shape (ERRORS,).
    """
    farthest = (np.abs(errors) / region[:, None]).max(axis=0)
    return np.asarray(np.clip(2.0 - farthest, 0.0, 1.0))
