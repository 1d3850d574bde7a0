"""Checked actions, spaces of observations with actions, and references."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray


class ReferencePoint(NamedTuple):
    """The reference at one time."""

    x: float  # [m]
    y: float  # [m]
    psi: float  # [rad]
    u: float  # [m/s]
    v: float  # [m/s]
    r: float  # [rad/s]
    F_u: float  # [N]
    F_r: float  # [N m]


def checked_action(action: Any) -> list[float]:
    """Return an action as two Python floats.

    Raises:
        ValueError: it is not a numeric array or sequence of shape (2,), or is not finite.
    """
    array = np.asarray(action)
    if array.dtype.kind in "fiu" and array.shape == (2,) and not np.ma.is_masked(action):
        command: list[float] = array.tolist()
        if math.isfinite(command[0]) and math.isfinite(command[1]):
            return command
    shown = " ".join(repr(action).split())  # in one line
    raise ValueError(f"action is {shown}; it must be two finite numbers in [-1, 1], shape (2,)")


def checked_actions(actions: Any, num_envs: int) -> NDArray[Any]:
    """Return actions as an array of numbers, shape (N, 2).

    Raises:
        ValueError: they are not numbers of this shape, or not finite; the message names the first bad sub-environment.
    """
    array = np.asarray(actions)
    if array.dtype.kind not in "fiu" or array.shape != (num_envs, 2):
        raise ValueError(
            f"actions have shape {array.shape} and type {array.dtype}; they must be numbers of shape ({num_envs}, 2)"
        )
    valid = np.isfinite(array)
    if type(actions) is not np.ndarray:
        valid = valid & ~np.ma.getmaskarray(actions)
    if not valid.all():
        i = int(np.argmin(valid.all(axis=1)))
        raise ValueError(f"action of sub-environment {i} is {actions[i]}; it must be two finite numbers in [-1, 1]")
    return array


def with_action(space: Any) -> Any:
    """Return the space of observations with an action appended."""
    bounds = np.append(space.high, np.ones(2, dtype=space.dtype))
    return gym.spaces.Box(-bounds, bounds, dtype=space.dtype)
