"""Checked actions, spaces of observations with actions, and references."""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray


def checked_action(action: Any, channels: int = 2) -> list[float]:
    """Return an action as Python floats, one for each channel.

    Raises:
        ValueError: it is not a numeric array or sequence of shape (channels,), or is not finite.
    """
    array = np.asarray(action)
    if array.dtype.kind in "fiu" and array.shape == (channels,) and not np.ma.is_masked(action):
        command: list[float] = array.tolist()
        if all(map(math.isfinite, command)):
            return command
    shown = " ".join(repr(action).split())  # in one line
    raise ValueError(f"action is {shown}; it must be {finite_numbers(channels)} in [-1, 1], shape ({channels},)")


def finite_numbers(channels: int) -> str:
    """Return the words for the numbers of an action, for messages."""
    return f"{({2: 'two', 3: 'three'}).get(channels, channels)} finite numbers"


def checked_actions(actions: Any, num_envs: int, channels: int = 2) -> NDArray[Any]:
    """Return actions as an array of numbers, shape (N, channels).

    Raises:
        ValueError: they are not numbers of this shape, or not finite; the message names the first bad sub-environment.
    """
    array = np.asarray(actions)
    if array.dtype.kind not in "fiu" or array.shape != (num_envs, channels):
        raise ValueError(
            f"actions have shape {array.shape} and type {array.dtype}; they must be numbers of shape "
            f"({num_envs}, {channels})"
        )
    valid = np.isfinite(array)
    if type(actions) is not np.ndarray:
        valid = valid & ~np.ma.getmaskarray(actions)
    if not valid.all():
        i = int(np.argmin(valid.all(axis=1)))
        raise ValueError(
            f"action of sub-environment {i} is {actions[i]}; it must be {finite_numbers(channels)} in [-1, 1]"
        )
    return array


def with_action(space: Any, channels: int = 2) -> Any:
    """Return the space of observations with an action appended."""
    bounds = np.append(space.high, np.ones(channels, dtype=space.dtype))
    return gym.spaces.Box(-bounds, bounds, dtype=space.dtype)
