"""What a network is trained on: the features of the agents, and a reward with a gradient far from the reference."""

from __future__ import annotations

import inspect
from functools import reduce
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvStepReturn, VecEnvWrapper

from auv_gym.physics.namespaces import ARRAYS, Array
from baselines.agents.features import LARGEST_FEATURE, STANDARD, Inputs
from baselines.agents.space_features import SpaceInputs
from baselines.policy import SPEED_FLOOR

LINEAR = 2.0  # [s] lag up to which the cost is linear; beyond, it is logarithmic, with a continuous slope


class VecFeatures(VecEnvWrapper):
    """Converts observations to `baselines.agents.features.FEATURES`, and adds a cost of the error to the reward.

    The memory of the features is reset with every episode. At the end of an episode `terminal_observation` has the
    features of its last observation, and `episode` has the sum of the task's rewards and the number of steps.

    The reward of the task is bounded, so its slope is small far from the reference; but large errors dominate the
    score. With the lag t, the position error over the reference's speed, the cost is `error_weight` t up to
    t = `LINEAR`, and `error_weight` `LINEAR` (1 + ln(t / `LINEAR`)) beyond. With a cost the end of a failed episode
    counts as a truncation, not as a termination, because an end without further costs would be an advantage.

    Args:
        venv: of `UnderactuatedAUVTrackResidual-v0`; a preview for its expert is not included in the features.
        error_weight: cost for each second of lag [1/s]; 0: no cost.
        reward_share: factor of the task's reward. With 0 the critic learns more easily, because the effect of an
            action on the bounded reward is small compared with the reward itself.
        lead: time [s] by which the measured error is extrapolated with the measured velocities. An action changes the
            velocities immediately and the position later. With a lead its effect on the reward is visible within a
            few steps, and larger than the error of the critic.
        inputs: the features, without a preview; in space `SpaceInputs`.

    Raises:
        ValueError: `venv` is another environment.
    """

    def __init__(
        self,
        venv: VecEnv,
        error_weight: float = 0.0,
        reward_share: float = 1.0,
        lead: float = 1.0,
        inputs: Inputs | SpaceInputs = STANDARD,
    ) -> None:
        shape, model = venv.observation_space.shape or (), inputs.model
        if len(shape) != 1 or shape[0] < (size := model.layout.size + len(model.channels)):
            raise ValueError(
                f"observations have shape {shape}; those of the residual environment have ({size},), or more with a "
                "preview"
            )
        space = gym.spaces.Box(-LARGEST_FEATURE, LARGEST_FEATURE, (len(inputs.features),), np.float32)
        super().__init__(venv, observation_space=space)
        self._inputs = inputs
        self.error_weight, self.reward_share, self.lead = error_weight, reward_share, lead
        self._start()

    @property
    def _channels(self) -> int:
        return len(self._inputs.model.channels)

    def _start(self) -> None:
        """Set the memory of new episodes everywhere."""
        n = self.num_envs
        self._integrals, self._correction = np.zeros((n, self._inputs.memory)), np.zeros((n, self._channels))
        self._returns, self._lengths = np.zeros(n, dtype=np.float32), np.zeros(n, dtype=np.int64)
        self._speed = np.full(n, SPEED_FLOOR)  # [m/s] of the reference at the last control instant

    def reset(self) -> NDArray[np.float32]:
        """Start an episode everywhere; return the features, shape (N, features)."""
        self._start()
        return self._observed(np.asarray(self.venv.reset()))

    def step_async(self, actions: NDArray[Any]) -> None:
        """Pass the corrections, shape (N, channels), to the environment, and store them for the features."""
        self._correction = np.clip(actions, -1.0, 1.0).astype(np.float64)
        self.venv.step_async(actions)

    def step_wait(self) -> VecEnvStepReturn:
        """Advance every vehicle; return features, rewards minus costs, dones and infos."""
        observation, reward, done, infos = self.venv.step_wait()
        self._returns += reward
        self._lengths += 1
        reached = np.array(observation)  # at the end of the step, also where the next episode has begun
        for i in done.nonzero()[0].tolist():
            reached[i] = infos[i]["terminal_observation"]
            last, _ = self._features(reached[i : i + 1], self._correction[i : i + 1], self._integrals[i : i + 1])
            infos[i]["terminal_observation"] = last[0]
            infos[i]["episode"] = {"r": self._returns[i], "l": self._lengths[i]}
            if self.error_weight:
                infos[i]["TimeLimit.truncated"] = True
        if self.error_weight:
            lag = self._error(reached) / self._speed
            cost = np.minimum(lag, LINEAR) + LINEAR * np.log(np.maximum(lag / LINEAR, 1.0))
            reward = (self.reward_share * reward - self.error_weight * cost).astype(np.float32)
        for memory in (self._integrals, self._correction, self._returns, self._lengths):
            memory[done] = 0
        return self._observed(np.asarray(observation)), reward, done, infos

    def _observed(self, observation: Array) -> NDArray[np.float32]:
        """Return the features of observations, and store the memory and the reference's speed for the next step."""
        o = self._terms(observation)
        squares = (getattr(o, f"{name}_R") ** 2 for name in self._inputs.model.velocity)
        self._speed = np.sqrt(np.maximum(sum(squares), SPEED_FLOOR**2))
        features, self._integrals = self._features(observation, self._correction, self._integrals)
        return features

    def _terms(self, observation: Array) -> Any:
        layout = self._inputs.model.layout
        return layout.named(layout.terms_of(observation))

    def _error(self, observation: Array) -> Array:
        """Return the extrapolated position errors [m], shape (N,)."""
        o, lead = self._terms(observation), self.lead
        # Velocity errors are differences of components, each in its own body frame; the angles are between them.
        c, s = np.cos(o.psi_e), np.sin(o.psi_e)
        ahead, aside = c * o.u_R + s * o.v_R, c * o.v_R - s * o.u_R
        errors = [o.e_y + lead * (o.v_e + o.v_R - aside)]
        if "w" in self._inputs.model.velocity:
            c, s = np.cos(o.theta_e), -np.sin(o.theta_e)
            ahead, up = c * ahead + s * o.w_R, c * o.w_R - s * ahead
            errors.append(o.e_z + lead * (o.w_e + o.w_R - up))
        error: Array = reduce(np.hypot, errors, o.e_x + lead * (o.u_e + o.u_R - ahead))
        return error

    def _features(self, observation: Array, correction: Array, integrals: Array) -> tuple[NDArray[np.float32], Array]:
        """Return features (N, features) and new integrals of observations (N, n) that end in an action."""
        o, base = self._terms(observation), observation[:, -self._channels :].T
        rows, sums = self._inputs.update(o, (), base, correction.T, integrals.T, ARRAYS)
        return np.array(rows, dtype=np.float32).T, np.array(sums).T

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "class_attributes"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, class_attributes=dict(inspect.getmembers(type(self))))
