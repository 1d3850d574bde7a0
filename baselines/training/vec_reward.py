"""A reward that an agent still feels far off, as a wrapper of vector environments; rl_zoo3 takes it by name."""

from __future__ import annotations

import numpy as np
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvObs, VecEnvStepReturn, VecEnvWrapper

from auv_gym.task import decode_observation
from baselines.backstepping import MIN_SPEED

LINEAR = 2.0
"""Lag [s] up to which it costs in proportion; beyond, its logarithm does, with the same slope there."""


class VecErrorCost(VecEnvWrapper):
    """Subtracts from each reward what the position error costs, measured in seconds that the reference is ahead.

    The task's own reward is bounded: it has little slope where a vehicle is far off, and a score is made of just those
    errors. With t the position error over the reference's speed, the cost is `weight` t up to t = `LINEAR`, and
    `weight` `LINEAR` (1 + ln(t / `LINEAR`)) from there.

    Args:
        venv: with the observation of `UnderactuatedAUVTrack-v0`, and perhaps more columns.
        weight: reward lost for each second [1/s].
        share: of the task's own reward that is kept. A critic has less to learn without: what an action is worth is a
            small part of a bounded reward that every step gives.
    """

    def __init__(self, venv: VecEnv, weight: float = 1.0, share: float = 1.0) -> None:
        super().__init__(venv)
        self.weight, self.share = weight, share
        self._speed = np.full(self.num_envs, MIN_SPEED)

    def reset(self) -> VecEnvObs:
        """Start an episode everywhere."""
        observation = self.venv.reset()
        self._remember(observation)
        return observation

    def step_wait(self) -> VecEnvStepReturn:
        """Advance every vehicle; return observations, dearer rewards, dones and infos."""
        observation, reward, done, infos = self.venv.step_wait()
        lag = np.array([info["position_error"] for info in infos]) / self._speed
        cost = np.minimum(lag, LINEAR) + LINEAR * np.log(np.maximum(lag / LINEAR, 1.0))
        self._remember(observation)
        return observation, (self.share * reward - self.weight * cost).astype(np.float32), done, infos

    def _remember(self, observation: VecEnvObs) -> None:
        """Keep the reference's speeds [m/s], shape (N,), of this instant for the next step."""
        o = decode_observation(np.asarray(observation))
        self._speed = np.maximum(np.hypot(o.u_R, o.v_R), MIN_SPEED)
