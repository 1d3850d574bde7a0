"""The vector environment interface of Gymnasium, under the same names for all supported releases."""

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
            """The wrapper of Gymnasium with type parameters, which are ignored."""

            def __class_getitem__(cls, _: Any) -> Any:
                return cls

    try:
        from gymnasium.vector import AutoresetMode
    except ImportError:  # before 1.1

        class AutoresetMode(Enum):
            """When a sub-environment begins the next episode after the end of one."""

            NEXT_STEP = "NextStep"
            SAME_STEP = "SameStep"
            DISABLED = "Disabled"


__all__ = ["Autoreset", "AutoresetMode", "VectorEnv", "VectorWrapper", "checked_mode"]


def checked_mode(mode: AutoresetMode | str) -> AutoresetMode:
    """Return an autoreset mode, for the mode itself or its value, such as "NextStep".

    Raises:
        ValueError: the mode does not exist.
    """
    try:
        return AutoresetMode(mode)
    except ValueError:
        allowed = ", ".join(repr(m.value) for m in AutoresetMode)
        raise ValueError(f"unknown autoreset_mode {mode!r}; allowed are {allowed}, or an AutoresetMode") from None


class Autoreset:
    """The sub-environments whose episodes are over, and those that a step resets in an autoreset mode.

    Args:
        num_envs: N, the number of sub-environments.
        mode: when the next episode begins after the end of one.

    Attributes:
        mode: the mode.
        over: whether an episode is over and the next one has not begun, shape (N,).
    """

    def __init__(self, num_envs: int, mode: AutoresetMode) -> None:
        self.mode = mode
        self.over: NDArray[np.bool_] = np.zeros(num_envs, dtype=bool)

    @property
    def resetting(self) -> NDArray[np.bool_] | None:
        """Whether the next step of each sub-environment is a reset, shape (N,); None if no step is one.

        Raises:
            ResetNeeded: the mode is DISABLED, and an episode is over.
        """
        if self.mode == AutoresetMode.SAME_STEP or not self.over.any():
            return None
        if self.mode == AutoresetMode.DISABLED:
            indices = np.flatnonzero(self.over).tolist()
            raise ResetNeeded(f"the episodes of sub-environments {indices} are over: reset them with 'reset_mask'")
        return self.over

    def to_reset(self, done: NDArray[np.bool_]) -> NDArray[Any]:
        """Return the indices of the sub-environments that a step resets, if it ends the episodes `done`, shape (N,)."""
        if self.mode == AutoresetMode.SAME_STEP:
            return done.nonzero()[0]
        return self.over.nonzero()[0] if self.mode == AutoresetMode.NEXT_STEP else np.zeros(0, dtype=np.int64)

    def advance(self, done: NDArray[np.bool_]) -> None:
        """Store which episodes a step has ended, shape (N,)."""
        if self.mode != AutoresetMode.SAME_STEP:
            self.over = done.copy()
