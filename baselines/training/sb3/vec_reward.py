"""A reward that an agent still feels far off, as a wrapper of vector environments; rl_zoo3 takes it by name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvObs, VecEnvStepReturn, VecEnvWrapper

from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.task.observation import decode_observation
from baselines.policy import SPEED_FLOOR, reference_speed

LINEAR = 2.0  # [s] lag up to which the error costs in proportion; beyond, its logarithm does, with the same slope


class VecErrorCost(VecEnvWrapper):
    """Subtracts from each reward what the position error costs, measured in seconds that the reference is ahead.

    The task's own reward is bounded: it has little slope where a vehicle is far off, and a score is made of just those
    errors. With t the position error over the reference's speed, the cost is `weight` t up to t = `LINEAR`, and
    `weight` `LINEAR` (1 + ln(t / `LINEAR`)) from there. A lost vehicle's episode counts as cut off, not as ended:
    no more costs would be a gain.

    Args:
        venv: with the observation of `UnderactuatedAUVTrack-v0`, and perhaps more columns.
        weight: reward lost for each second [1/s].
        share: of the task's own reward that is kept. A critic has less to learn without: what an action is worth is a
            small part of a bounded reward that every step gives.
        lead: time [s] by which the measured error is extrapolated with the measured velocities before it costs; None
            takes the true error as it is. An action moves the velocities at once and the position only later: with a
            lead its worth shows within a few steps, far above what a critic gets wrong.
    """

    def __init__(self, venv: VecEnv, weight: float = 1.0, share: float = 1.0, lead: float | None = None) -> None:
        super().__init__(venv)
        self.weight, self.share, self.lead = weight, share, lead
        self._speed = np.full(self.num_envs, SPEED_FLOOR)

    def reset(self) -> VecEnvObs:
        """Start an episode everywhere."""
        observation = self.venv.reset()
        self._remember(observation)
        return observation

    def step_wait(self) -> VecEnvStepReturn:
        """Advance every vehicle; return observations, dearer rewards, dones and infos."""
        observation, reward, done, infos = self.venv.step_wait()
        for i in done.nonzero()[0].tolist():
            infos[i]["TimeLimit.truncated"] = True
        lag = self._error(np.asarray(observation), done, infos) / self._speed
        cost = np.minimum(lag, LINEAR) + LINEAR * np.log(np.maximum(lag / LINEAR, 1.0))
        self._remember(observation)
        return observation, (self.share * reward - self.weight * cost).astype(np.float32), done, infos

    def _error(self, observation: Array, done: NDArray[np.bool_], infos: Sequence[Mapping[str, Any]]) -> Array:
        """Return the position errors [m], shape (N,), that cost."""
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
        """Keep the reference's speeds [m/s], shape (N,), of this instant for the next step."""
        o = decode_observation(np.asarray(observation))
        self._speed = reference_speed(o.u_R, o.v_R, ARRAYS)
