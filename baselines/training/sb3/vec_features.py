"""The features of a network as a `VecEnvWrapper` of Stable-Baselines3; rl_zoo3 can use it by name."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvStepReturn, VecEnvWrapper

from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.task.observation import SIZE, decode_observation
from baselines.agents.features import FEATURES, INTEGRALS, LARGEST_FEATURE, STANDARD
from baselines.agents.networks import OUTPUTS


class VecFeatures(VecEnvWrapper):
    """Converts observations to `baselines.agents.features.FEATURES`; their memory is reset with every episode.

    At the end of an episode `terminal_observation` has the features of the last observation of the episode.

    Args:
        venv: of `UnderactuatedAUVTrackResidual-v0`; a preview for its expert is not included in the features.

    Raises:
        ValueError: `venv` is another environment.
    """

    def __init__(self, venv: VecEnv) -> None:
        shape = venv.observation_space.shape or ()
        if len(shape) != 1 or shape[0] < SIZE + OUTPUTS:
            allowed = f"({SIZE + OUTPUTS},), or more with a preview"
            raise ValueError(f"observations have shape {shape}; those of the residual environment have {allowed}")
        space = gym.spaces.Box(-LARGEST_FEATURE, LARGEST_FEATURE, (len(FEATURES),), np.float32)
        super().__init__(venv, observation_space=space)
        self._integrals, self._correction = np.zeros((self.num_envs, INTEGRALS)), np.zeros((self.num_envs, OUTPUTS))

    def reset(self) -> NDArray[np.float32]:
        """Start an episode everywhere; return the features, shape (N, features)."""
        observation = np.asarray(self.venv.reset())
        self._integrals, self._correction = np.zeros((self.num_envs, INTEGRALS)), np.zeros((self.num_envs, OUTPUTS))
        features, self._integrals = _features(observation, self._correction, self._integrals)
        return features

    def step_async(self, actions: NDArray[Any]) -> None:
        """Pass the corrections, shape (N, 2), to the environment, and store them for the features."""
        self._correction = np.clip(actions, -1.0, 1.0).astype(np.float64)
        self.venv.step_async(actions)

    def step_wait(self) -> VecEnvStepReturn:
        """Advance every vehicle; return features, rewards, dones and infos."""
        observation, reward, done, infos = self.venv.step_wait()
        for i in done.nonzero()[0].tolist():
            last = np.asarray(infos[i]["terminal_observation"])[None]
            features, _ = _features(last, self._correction[i : i + 1], self._integrals[i : i + 1])
            infos[i]["terminal_observation"] = features[0]
        self._correction[done], self._integrals[done] = 0.0, 0.0
        features, self._integrals = _features(np.asarray(observation), self._correction, self._integrals)
        return features, reward, done, infos


def _features(observation: Array, correction: Array, integrals: Array) -> tuple[NDArray[np.float32], Array]:
    """Return the features (N, features) and the new integrals (N, INTEGRALS) of observations that end in an action."""
    o, base = decode_observation(observation), observation[:, -OUTPUTS:].T
    rows, sums = STANDARD.update(o, (), base, correction.T, integrals.T, ARRAYS)
    return np.array(rows, dtype=np.float32).T, np.array(sums).T
