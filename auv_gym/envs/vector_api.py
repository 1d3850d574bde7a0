"""Gymnasium's interface of vector environments, under one name in each of its releases that are supported."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Any

import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

if TYPE_CHECKING:
    from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
else:
    try:
        from gymnasium.vector import VectorEnv, VectorWrapper
    except ImportError:  # before 1.0
        from gymnasium.experimental.vector import VectorEnv, VectorWrapper
    if not VectorWrapper.__parameters__:  # before 1.2

        class VectorWrapper(VectorWrapper):
            """The same, which takes the types of observations and actions and forgets them."""

            def __class_getitem__(cls, _: Any) -> Any:
                return cls

    try:
        from gymnasium.vector import AutoresetMode
    except ImportError:  # before 1.1

        class AutoresetMode(Enum):
            """When a sub-environment whose episode has ended begins the next one."""

            NEXT_STEP = "NextStep"
            SAME_STEP = "SameStep"
            DISABLED = "Disabled"


__all__ = ["AutoresetMode", "Ends", "VectorEnv", "VectorWrapper", "checked_mode"]


def checked_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """Return an autoreset mode that is given as it is, or by its value such as "NextStep".

    Raises:
        ValueError: there is no such mode.
    """
    try:
        return AutoresetMode(mode)
    except ValueError:
        allowed = ", ".join(repr(m.value) for m in AutoresetMode)
        raise ValueError(f"unknown autoreset_mode {mode!r}; allowed are {allowed}, or an AutoresetMode") from None


class Ends:
    """Which of N episodes have ended, and which of them begin anew with a step, as an autoreset mode says.

    Args:
        num_envs: N.
        mode: when an episode that has ended is followed by the next one.

    Attributes:
        mode: the same.
        over: where an episode has ended and none has begun since, shape (N,).
    """

    def __init__(self, num_envs: int, mode: AutoresetMode) -> None:
        self.mode = mode
        self.over: NDArray[np.bool_] = np.zeros(num_envs, dtype=bool)

    @property
    def waiting(self) -> NDArray[np.bool_] | None:
        """Where the coming step is a reset, shape (N,); None if nowhere.

        Raises:
            ResetNeeded: nothing resets by itself, and an episode is over.
        """
        if self.mode == AutoresetMode.SAME_STEP or not self.over.any():
            return None
        if self.mode == AutoresetMode.DISABLED:
            lanes = np.flatnonzero(self.over).tolist()
            raise ResetNeeded(f"the episodes of sub-environments {lanes} are over: reset them by options['reset_mask']")
        return self.over

    def renewed(self, done: NDArray[np.bool_]) -> NDArray[Any]:
        """Return the indices of those that begin anew with a step which ends episodes where `done` says."""
        if self.mode == AutoresetMode.SAME_STEP:
            return done.nonzero()[0]
        return self.over.nonzero()[0] if self.mode == AutoresetMode.NEXT_STEP else np.zeros(0, dtype=np.int64)

    def advance(self, done: NDArray[np.bool_]) -> None:
        """Take note of what a step has ended."""
        if self.mode != AutoresetMode.SAME_STEP:
            self.over = done.copy()
