"""An expert whose action a network corrects, as a policy."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.envs.spaces import checked_actions
from auv_gym.physics.namespaces import ARRAYS
from auv_gym.task.policy import Policy, checked_authority, corrected, preview_of
from baselines.policy import Batched, Memory, Starts


class CorrectedPolicy(Batched):
    """The command of `UnderactuatedAUVTrackResidual-v0` as a policy of the tracking task.

    Args:
        expert: the policy that is corrected.
        network: a policy, a module of torch, or a function of a batch, of the observations of the residual environment,
            shape (N, n).
        authority: largest corrections.

    Raises:
        ValueError: an authority is not in (0, 2], or the network cannot be called.
    """

    def __init__(
        self, expert: Policy, network: Policy | Callable[[Any], Any], authority: float | Sequence[float]
    ) -> None:
        if isinstance(network, type) or not (callable(network) or hasattr(network, "predict")):
            raise ValueError(
                f"network is {network!r}; it must be a function of a batch of observations, a module of torch, or an "
                "object with the method predict"
            )
        self.expert, self.network, self.authority = expert, network, np.array(checked_authority(authority))
        self.preview, self.remembers = preview_of(expert), getattr(expert, "remembers", False)
        self._split = 0  # number of arrays of the expert's memory

    def actions(
        self, rows: NDArray[Any], state: Memory | None, episode_start: Starts, deterministic: bool
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return actions and the memory of expert and network, see `Batched`."""
        before, own = (state[: self._split] or None, state[self._split :] or None) if state else (None, None)
        base, before = self.expert.predict(rows, before, episode_start, deterministic)
        seen, self._split = np.concatenate((rows, base), axis=1), len(before or ())
        network: Any = self.network
        if hasattr(network, "predict"):
            correction, own = network.predict(seen, own, episode_start, deterministic)
        elif hasattr(network, "state_dict"):
            correction = _of_module(network, seen)
        else:
            correction = network(seen)
        if hasattr(correction, "detach"):
            correction = correction.detach().cpu().numpy()
        action = corrected(base, self.authority, checked_actions(correction, len(rows)), ARRAYS)
        return action.astype(np.float32), (*(before or ()), *(own or ())) or None


def _of_module(module: Any, seen: NDArray[Any]) -> Any:
    """Return the output of a module of torch, in the precision of its weights."""
    torch = importlib.import_module("torch")
    weights = next(module.parameters(), torch.zeros(1))
    with torch.no_grad():
        return module(torch.as_tensor(seen, dtype=weights.dtype, device=weights.device))
