"""Decoding of observations, in the plane and in space."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from auv_gym.task.observation import Observation, decoded_terms
from auv_gym.task.space import SPACE


def decode_observation(observation: NDArray[Any], space: bool = False) -> Any:
    """Return the physical terms of an observation of shape (SIZE,) as floats, or of (N, SIZE) as arrays (N,).

    They are an `Observation`, of motion in `space` a `task.space.Observation`.

    It is exact except for clipped terms. Further columns, such as those of the residual environment, are ignored.

    Raises:
        ValueError: see `Layout.terms_of`.
    """
    if space:
        return SPACE.layout.named(SPACE.layout.terms_of(observation))
    return Observation._make(decoded_terms(observation))
