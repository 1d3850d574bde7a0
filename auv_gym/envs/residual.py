"""Residual control: the action of an expert plus a bounded correction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from auv_gym.envs.spaces import checked_action, checked_actions, with_action
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.namespaces import ARRAYS
from auv_gym.task.policy import Policy, checked_authority, corrected, traceable


class ResidualAction(gym.Wrapper[NDArray[np.float64], NDArray[np.float32], NDArray[np.float64], NDArray[np.float32]]):
    """A wrapper whose action is a correction: command = clip(expert(observation) + authority * clip(action)).

    The expert's action is appended to the observation. A zero action gives the expert's action, bit for bit.

    Args:
        env: an environment with this package's observation and action space.
        expert: a policy; its memory is reset at the start of an episode.
        authority: largest correction of the surge and yaw command, as fractions of the actuator limits; one number for
            both, or a pair.

    Raises:
        ValueError: an authority is not in (0, 2].
    """

    def __init__(self, env: gym.Env[Any, Any], expert: Policy, authority: float | Sequence[float] = 0.5) -> None:
        super().__init__(env)
        (self._channels,) = env.action_space.shape or ()
        self.expert, self.authority = expert, checked_authority(authority, self._channels)
        self.observation_space = with_action(env.observation_space, self._channels)
        self._compiled = _added(expert, self.authority, env)
        self._memory: tuple[NDArray[Any], ...] | None = None
        self._base = np.zeros(self._channels, dtype=np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Start an episode; see the wrapped environment."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._memory = None
        return observation if self._compiled else self._extended(observation, True), info

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.float64], float, bool, bool, dict[str, Any]]:
        """Advance one control period with the expert's action plus the correction.

        Raises:
            ValueError: the correction is not two finite numbers; nothing has changed then.
        """
        if self._compiled:
            return self.env.step(action)  # type: ignore[return-value]
        correction = np.array(checked_action(action, self._channels))
        command = corrected(self._base, np.array(self.authority), correction, ARRAYS)
        observation, reward, terminated, truncated, info = self.env.step(command)
        return self._extended(observation, False), float(reward), terminated, truncated, info

    def _extended(self, observation: NDArray[np.float64], first: bool) -> NDArray[np.float64]:
        self._base, self._memory = self.expert.predict(observation, self._memory, np.array([first]))
        return np.concatenate((observation, self._base))


class VectorResidualAction(VectorWrapper):
    """`ResidualAction` for a vector environment in any autoreset mode, with one expert for all sub-environments.

    The expert's memory is None or a tuple of arrays whose first axis is that of the sub-environments.

    Arguments and errors are those of `ResidualAction`.
    """

    def __init__(self, env: VectorEnv[Any, Any, Any], expert: Policy, authority: float | Sequence[float] = 0.5) -> None:
        super().__init__(env)
        (self._channels,) = env.single_action_space.shape or ()
        self.expert, self.authority = expert, checked_authority(authority, self._channels)
        self.autoreset_mode: AutoresetMode = env.metadata["autoreset_mode"]
        self.single_observation_space = with_action(env.single_observation_space, self._channels)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)
        self._compiled = _added(expert, self.authority, env)
        self._memory: tuple[NDArray[Any], ...] | None = None
        self._base = np.zeros((env.num_envs, self._channels), dtype=np.float32)
        self._over = np.zeros(env.num_envs, dtype=bool)  # whether the next step begins an episode

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Start episodes; see the wrapped environment."""
        observation, info = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        if self._compiled:
            return observation, info
        started = np.asarray((options or {}).get("reset_mask", np.ones(self.num_envs, dtype=bool)))
        if started.all():
            self._over = np.zeros(self.num_envs, dtype=bool)
            self._base, self._memory = self.expert.predict(observation, None, started)
        else:  # the expert has acted on the observations of the others
            base, memory = self._predicted(observation[started], started, first=True)
            self._base, self._over = _replaced(self._base, started, base), self._over & ~started
            if self._memory is not None and memory is not None:
                self._memory = tuple(_replaced(m, started, new) for m, new in zip(self._memory, memory, strict=True))
        return np.concatenate((observation, self._base), axis=1), info

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Advance one control period with the expert's actions plus the corrections.

        Raises:
            ValueError: a correction is not two finite numbers; nothing has changed then.
        """
        if self._compiled:
            return self.env.step(actions)
        corrections = checked_actions(actions, self.num_envs, self._channels)
        command = corrected(self._base, np.array(self.authority), corrections, ARRAYS)
        observation, reward, terminated, truncated, info = self.env.step(command)
        done = terminated | truncated
        if "final_obs" in info:
            last = np.stack(info["final_obs"][done])
            bases, _ = self._predicted(last, done, first=False)
            for i, final, base in zip(done.nonzero()[0], last, bases, strict=True):
                info["final_obs"][i] = np.concatenate((final, base))
        same = self.autoreset_mode == AutoresetMode.SAME_STEP
        started, self._over = (done, self._over) if same else (self._over, done)
        self._base, self._memory = self.expert.predict(observation, self._memory, started)
        return np.concatenate((observation, self._base), axis=1), reward, terminated, truncated, info

    def _predicted(
        self, observation: NDArray[Any], mask: NDArray[np.bool_], *, first: bool
    ) -> tuple[NDArray[np.float32], tuple[NDArray[Any], ...] | None]:
        """Return the expert's actions and memory for n observations, those of the sub-environments in the mask (N,).

        `first` is whether they are the first ones of episodes.
        """
        memory = None if self._memory is None else tuple(m[mask] for m in self._memory)
        return self.expert.predict(observation, memory, np.full(len(observation), first))


def _added(expert: Policy, authority: tuple[float, ...], env: Any) -> bool:
    """Add a control law to the compiled step of an environment of this package; return whether that is possible."""
    possible = isinstance(env, (UnderactuatedAUVTrackEnv, UnderactuatedAUVTrackVectorEnv)) and traceable(expert)
    if possible:
        env.add_residual(expert, authority)
    return possible


def _replaced(old: NDArray[Any], where: NDArray[Any], new: NDArray[Any]) -> NDArray[Any]:
    """Return a copy of an array with new values where the mask is True."""
    result = old.copy()
    result[where] = new
    return result
