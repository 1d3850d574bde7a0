"""No expert: the zero action, for learning from scratch."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

NO_EXPERT = "none"
"""Its name where an expert is named."""


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
