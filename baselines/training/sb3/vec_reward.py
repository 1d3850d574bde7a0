"""A reward with a gradient far from the reference, as a wrapper of vector environments; rl_zoo3 can use it by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvObs, VecEnvStepReturn, VecEnvWrapper

from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.task.observation import decode_observation
from baselines.policy import SPEED_FLOOR, reference_speed

LINEAR = 2.0  # [s] lag up to which the cost is linear; beyond, it is logarithmic, with a continuous slope


class VecErrorCost(VecEnvWrapper):
    """Subtracts a cost of the position error from each reward.

    The reward of the task is bounded, so its slope is small far from the reference; but large errors dominate the
    score. With the lag t, the position error over the reference's speed, the cost is `weight` t up to t = `LINEAR`, and
    `weight` `LINEAR` (1 + ln(t / `LINEAR`)) beyond. The end of a failed episode counts as a truncation, not as a
    termination, because an end without further costs would be an advantage.

    Args:
        venv: with the observation of `UnderactuatedAUVTrack-v0`; it may have more columns.
        weight: cost for each second of lag [1/s].
        share: factor of the task's reward. With 0 the critic learns more easily, because the effect of an action on the
            bounded reward is small compared with the reward itself.
        lead: time [s] by which the measured error is extrapolated with the measured velocities; None uses the true
            error. An action changes the velocities immediately and the position later. With a lead its effect on the
            reward is visible within a few steps, and larger than the error of the critic.
    """

    def __init__(self, venv: VecEnv, weight: float = 1.0, share: float = 1.0, lead: float | None = None) -> None:
        super().__init__(venv)
        self.weight, self.share, self.lead = weight, share, lead
        self._speed = np.full(self.num_envs, SPEED_FLOOR)

    def reset(self) -> VecEnvObs:
        """Reset all sub-environments."""
        observation = self.venv.reset()
        self._remember(observation)
        return observation

    def step_wait(self) -> VecEnvStepReturn:
        """Advance every vehicle; return observations, rewards minus costs, dones and infos."""
        observation, reward, done, infos = self.venv.step_wait()
        for i in done.nonzero()[0].tolist():
            infos[i]["TimeLimit.truncated"] = True
        lag = self._error(np.asarray(observation), done, infos) / self._speed
        cost = np.minimum(lag, LINEAR) + LINEAR * np.log(np.maximum(lag / LINEAR, 1.0))
        self._remember(observation)
        return observation, (self.share * reward - self.weight * cost).astype(np.float32), done, infos

    def _error(self, observation: Array, done: NDArray[np.bool_], infos: Sequence[Mapping[str, Any]]) -> Array:
        """Return the position errors [m] of the cost, shape (N,)."""
        if self.lead is None:
            return np.array([info["position_error"] for info in infos])
        reached = observation.copy()
        for i in done.nonzero()[0].tolist():
            reached[i] = infos[i]["terminal_observation"]
        o = decode_observation(reached)
        # Velocity errors are differences of components, each in its own body frame; psi_e is the angle between them.
        c, s = np.cos(o.psi_e) - 1.0, np.sin(o.psi_e)
        ahead = o.e_x + self.lead * (o.u_e - c * o.u_R - s * o.v_R)
        aside = o.e_y + self.lead * (o.v_e + s * o.u_R - c * o.v_R)
        error: Array = np.hypot(ahead, aside)
        return error

    def _remember(self, observation: VecEnvObs) -> None:
        """Store the reference's speeds [m/s], shape (N,), for the next step."""
        o = decode_observation(np.asarray(observation))
        self._speed = reference_speed(o.u_R, o.v_R, ARRAYS)
