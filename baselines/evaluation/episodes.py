"""Records whole episodes of a policy as arrays: observations, actions, rewards and positions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.presets import as_scenario
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.policy import Policy, preview_of
from baselines.evaluation.cells import drawn
from baselines.evaluation.policy_check import check_predict
from baselines.evaluation.rollout import beginning, play
from baselines.policies import make_policy
from baselines.policy import Privileged


@dataclass(frozen=True)
class EpisodeRecord:
    """One complete episode of K control steps."""

    scenario: str  # name of the scenario
    seed: int  # an environment that is reset with this seed runs the same episode
    times: Array  # [s], shape (K + 1,)
    positions: Array  # x, y [m] of the centre of mass, shape (K + 1, 2)
    references: Array  # x, y [m] of the reference, shape (K + 1, 2)
    observations: Array  # scaled as in the environment, shape (K + 1, terms)
    actions: NDArray[np.float32]  # surge and yaw command as fractions of the limits, shape (K, 2)
    rewards: Array  # shape (K,)
    errors: Array  # [m] distance to the reference, shape (K + 1,)
    saturated: NDArray[np.bool_]  # whether an actuator was commanded to its limit in the step before, shape (K + 1,)
    failed: bool  # whether it ended beyond the scenario's `lost_distance`, otherwise at the end of its time

    @property
    def total_reward(self) -> float:
        """The return: the sum of the rewards."""
        return float(self.rewards.sum())


def run_episode(
    policy: Policy | str, scenario: Scenario | str | Mapping[str, Any] = "paper-circle", seed: int = 0
) -> EpisodeRecord:
    """Run a policy in one episode and return the record; an environment reset with the seed runs the same episode.

    Args:
        policy: an object with the `predict` of Stable-Baselines3, or a name or path for `make_policy`. It gets its
            memory back at each step, and the preview of its attribute `preview`.
        scenario: a `Scenario`, its dict, or a preset's name.
        seed: seed of the episode.

    Raises:
        OSError: the policy's file cannot be read.
        ValueError: policy or scenario is invalid.
        PolicyError: the policy gives no usable action, see `baselines.evaluation.rollout`.
    """
    return run_episodes(policy, scenario, 1, seed)[0]


def run_episodes(
    policy: Policy | str,
    scenario: Scenario | str | Mapping[str, Any] = "paper-circle",
    episodes: int = 20,
    seed: int = 0,
) -> list[EpisodeRecord]:
    """Run a policy in several parallel episodes and return the records; episode i has the seed `seed + i`.

    Args:
        policy: an object with the `predict` of Stable-Baselines3 for batches, or a name or path for `make_policy`.
        scenario: a `Scenario`, its dict, or a preset's name.
        episodes: number of episodes.
        seed: seed of the first episode.

    Raises:
        OSError: the policy's file cannot be read.
        ValueError: policy, scenario or number of episodes is invalid.
        PolicyError: the policy gives no usable action, see `baselines.evaluation.rollout`.
    """
    if isinstance(episodes, bool) or not isinstance(episodes, int) or episodes < 1:
        raise ValueError(f"episodes is {episodes!r}; it must be an integer of at least 1")
    scenario = as_scenario(scenario)
    made: Any = make_policy(policy, scenario.known) if isinstance(policy, str) else policy
    check_predict(made)
    cell = drawn(scenario, episodes, seed)
    if isinstance(made, Privileged):
        made.prepare(scenario, cell.episodes)
    env, observation = beginning([(scenario, cell.episodes)], preview_of(made))
    positions, observations, steps = [_positions(env)], [observation], []
    for step in play(made, (env, observation), scenario.steps):
        positions.append(_positions(env))
        observations.append(step.following)
        steps.append(step)
    places, seen = np.array(positions), np.array(observations)
    errors = np.vstack((np.hypot(*(places[0, :, :2] - places[0, :, 2:]).T), [step.error for step in steps]))
    lengths = np.sum([step.running for step in steps], axis=0).tolist()
    return [
        EpisodeRecord(
            scenario=scenario.name,
            seed=seed + i,
            times=np.arange(n + 1, dtype=np.float64) * scenario.control_dt,
            positions=places[: n + 1, i, :2],
            references=places[: n + 1, i, 2:],
            observations=seen[: n + 1, i],
            actions=np.clip([step.command[i] for step in steps[:n]], -1.0, 1.0).astype(np.float32),
            rewards=np.array([step.reward[i] for step in steps[:n]]),
            errors=errors[: n + 1, i],
            saturated=np.array([False, *(bool(step.saturated[i]) for step in steps[:n])]),
            failed=bool(steps[n - 1].failed[i]),
        )
        for i, n in enumerate(lengths)
    ]


def _positions(env: UnderactuatedAUVTrackVectorEnv) -> Array:
    """Return x, y [m] of the vehicles and of their references, shape (N, 4)."""
    return np.hstack((env.pose[:, :2], np.transpose(env.reference[:2])))
