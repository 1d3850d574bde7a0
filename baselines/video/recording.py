"""Runs a policy through an episode and records the trajectory for a video."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from auv_gym.physics.errors import to_world
from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.policy import preview_of
from baselines.evaluation.rollout import PolicyError, beginning, play
from baselines.evaluation.runner import failure
from baselines.policies import make_policy
from baselines.policy import Privileged


class Instant(NamedTuple):
    """A trajectory at one time, in SI units."""

    state: Array  # x, y [m], psi [rad], u, v [m/s] over ground, r [rad/s], shape (6,)
    reference: Array  # x, y [m], psi [rad], shape (3,)
    current: Array  # V_x, V_y [m/s], shape (2,)
    waves: Array  # wave force in the world [N], shape (2,)
    error: float  # [m] distance to the reference


@dataclass(frozen=True)
class RecordedEpisode:
    """One episode of a policy, one row for each of K control instants."""

    policy: str
    time: Array  # [s], shape (K,)
    state: Array  # as in `Instant`, psi without jumps, shape (K, 6)
    reference: Array  # as in `Instant`, shape (K, 3)
    current: Array  # [m/s], shape (K, 2)
    waves: Array  # [N], shape (K, 2)
    failed: bool  # whether it ended beyond the scenario's `lost_distance`

    @property
    def error(self) -> Array:
        """Distance to the reference [m], shape (K,)."""
        return np.asarray(np.hypot(*(self.state[:, :2] - self.reference[:, :2]).T))

    def at(self, time: float) -> Instant:
        """Return the linear interpolation at a time [s]; after the end of the episode, its last instant."""
        k = min(int(np.searchsorted(self.time, time, side="right")) - 1, len(self.time) - 2)
        share = min((time - self.time[k]) / (self.time[k + 1] - self.time[k]), 1.0)
        rows = self.state, self.reference, self.current, self.waves
        state, reference, current, waves = ((1.0 - share) * row[k] + share * row[k + 1] for row in rows)
        return Instant(state, reference, current, waves, float(np.hypot(*(state[:2] - reference[:2]))))


def trajectory_of(name: str, scenario: Scenario, episode: Episode) -> RecordedEpisode:
    """Return the trajectory of a policy, named as in `baselines.make_policy`, in an episode of a scenario.

    Raises:
        OSError: the policy's file cannot be read.
        ValueError: there is no such policy.
        PolicyError: the policy gave no usable action, or raised an exception.
    """
    policy = make_policy(name, scenario.known)
    if isinstance(policy, Privileged):
        policy.prepare(scenario, [episode])
    env, observation = beginning([(scenario, [episode])], preview_of(policy))

    def row() -> tuple[Array, Array, Array, Array]:
        """Return state, reference, current and wave load of the only vehicle."""
        return env.state[0].copy(), np.ravel(env.reference[:3]), env.current[0].copy(), env.load[0]

    rows, failed = [row()], False
    try:
        for k, moment in enumerate(play(policy, (env, observation), scenario.steps)):
            failed = bool(moment.failed[0])
            if not failed and k + 1 < scenario.steps:
                rows.append(row())
    except Exception as error:
        raise PolicyError(failure(error, name)) from error
    state, reference, current, load = (np.array(column) for column in zip(*rows, strict=True))
    state[:, 2], reference[:, 2] = np.unwrap(state[:, 2]), np.unwrap(reference[:, 2])
    cos, sin = np.cos(state[:, 2]), np.sin(state[:, 2])
    waves = np.stack(to_world(load[:, 0], load[:, 1], cos, sin), axis=1)
    return RecordedEpisode(
        name, scenario.control_dt * np.arange(float(len(rows))), state, reference, current, waves, failed
    )
