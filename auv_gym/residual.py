"""Residual control: the expert's action plus a bounded correction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from auv_gym.envs.track_env import checked_action
from auv_gym.task import BOUNDS


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


class ResidualAction(gym.Wrapper[NDArray[np.float64], NDArray[np.float32], NDArray[np.float64], NDArray[np.float32]]):
    """The action becomes a correction: command = clip(expert(observation) + authority * action).

    The expert's action is appended to the observation. A zero action reproduces the expert bit for bit.

    Args:
        env: an environment with this package's observation and action space.
        expert: a policy; its memory, if any, is reset with the episode.
        authority: largest correction of surge and yaw command, as fractions of the actuators' limits; one number for
            both or a pair.

    Raises:
        ValueError: an authority is not in (0, 2].
    """

    def __init__(self, env: gym.Env[Any, Any], expert: Policy, authority: float | Sequence[float] = 0.5) -> None:
        super().__init__(env)
        self.expert = expert
        self.authority = checked_authority(authority)
        bounds = np.append(BOUNDS, (1.0, 1.0))
        self.observation_space = gym.spaces.Box(-bounds, bounds, dtype=np.float64)
        self._memory: tuple[NDArray[Any], ...] | None = None
        self._base = np.zeros(2, dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Start an episode; see the wrapped environment."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._memory = None
        return self._extended(observation, True), info

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float64], float, bool, bool, dict[str, Any]]:
        """Apply the expert's action plus the correction.

        Raises:
            ValueError: the correction is not two finite numbers; nothing has changed then.
        """
        correction_u, correction_r = checked_action(action)
        (base_u, base_r), (authority_u, authority_r) = self._base.tolist(), self.authority
        command = np.array((base_u + authority_u * correction_u, base_r + authority_r * correction_r))
        observation, reward, terminated, truncated, info = self.env.step(command)
        return self._extended(observation, False), float(reward), terminated, truncated, info

    def _extended(self, observation: NDArray[np.float64], first: bool) -> NDArray[np.float64]:
        self._base, self._memory = self.expert.predict(observation, self._memory, np.array([first]))
        return np.concatenate((observation, self._base))


def checked_authority(authority: float | Sequence[float]) -> tuple[float, float]:
    """Return the authority as a pair.

    Raises:
        ValueError: it is neither a number nor a pair, or not in (0, 2].
    """
    pair = tuple(authority) if isinstance(authority, Sequence) else (authority, authority)
    if len(pair) != 2 or not all(isinstance(a, (int, float)) and 0 < a <= 2 for a in pair):
        raise ValueError(f"authority is {authority!r}; it must be a number in (0, 2], or one each for surge and yaw")
    return float(pair[0]), float(pair[1])
