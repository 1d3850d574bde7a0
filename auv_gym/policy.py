"""What acts: the interface of a policy, and the rule that turns an expert and a correction into a command."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from auv_gym.namespaces import Namespace, Number


class Policy(Protocol):
    """Whatever acts: Stable-Baselines3's `predict`, for one observation (n,) or a batch (N, n)."""

    def predict(
        self,
        observation: NDArray[Any],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Return the action and the memory to hand in at the next call."""


def preview_of(policy: Any) -> tuple[int, ...]:
    """Return the preview that a policy's observations need, its attribute `preview`; most policies need none."""
    return tuple(getattr(policy, "preview", ()))


def corrected(base: Number, authority: Number, correction: Number, ns: Namespace) -> Number:
    """Return the command of residual control, clip(base + authority * clip(correction)): surge, yaw, or both at once.

    Args:
        base: the expert's action, in [-1, 1].
        authority: largest correction.
        correction: of the learner; 1 is the largest.
        ns: the namespace of the numbers, which may have any shapes that fit together.
    """
    return ns.clip(base + authority * ns.clip(correction, -1.0, 1.0), -1.0, 1.0)


def checked_authority(authority: float | Sequence[float]) -> tuple[float, float]:
    """Return the largest correction of surge and yaw command as a pair.

    Raises:
        ValueError: it is neither a number nor a pair, or not in (0, 2].
    """
    pair = tuple(authority) if isinstance(authority, Sequence) else (authority, authority)
    if len(pair) != 2 or not all(isinstance(a, (int, float)) and 0 < a <= 2 for a in pair):
        raise ValueError(f"authority is {authority!r}; it must be a number in (0, 2], or one each for surge and yaw")
    return float(pair[0]), float(pair[1])
