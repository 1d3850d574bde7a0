"""Without feedback: the planner's forces, or none at all, for learning from scratch."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.namespaces import ARRAYS
from auv_gym.task import action_of, decode_observation

NO_EXPERT = "none"
"""Name of `Zero` where an expert is named."""


class OpenLoop:
    """Applies F_uR and F_rR (16), whatever the errors are."""

    def predict(
        self,
        observation: NDArray[Any],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Return the action (2,) or actions (N, 2) for observations (18,) or (N, 18), and `state` untouched."""
        o = decode_observation(observation)
        return np.array(action_of((o.F_uR, o.F_rR), o, ARRAYS), dtype=np.float32).T, state


class Zero:
    """Commands nothing."""

    def predict(
        self,
        observation: NDArray[Any],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Return the zero action, shape (2,) or (N, 2), and `state` untouched."""
        return np.zeros((*observation.shape[:-1], 2), dtype=np.float32), state
