"""The planner's forces without feedback: what the plan alone is worth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.task import decode_observation


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
        action = np.array((o.F_uR / o.F_u_max, o.F_rR / o.F_r_max), dtype=np.float32).T
        return np.clip(action, -1.0, 1.0), state
