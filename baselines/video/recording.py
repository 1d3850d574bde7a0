"""Runs a policy through an episode and records the trajectory for a video."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from auv_gym.physics.errors import to_world
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.space import axes
from auv_gym.rendering.planes import two_planes
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
    side: Any = None  # of motion in space, an `Instant` from the side


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
    side: RecordedEpisode | None = None  # of motion in space, the same from the side, see `rendering.two_planes`

    @property
    def error(self) -> Array:
        """Distance to the reference [m], shape (K,)."""
        level = np.hypot(*(self.state[:, :2] - self.reference[:, :2]).T)
        up = 0.0 if self.side is None else self.side.state[:, 1] - self.side.reference[:, 1]
        return np.asarray(np.hypot(level, up))

    def at(self, time: float) -> Instant:
        """Return the linear interpolation at a time [s]; after the end of the episode, its last instant."""
        k = min(int(np.searchsorted(self.time, time, side="right")) - 1, len(self.time) - 2)
        share = min((time - self.time[k]) / (self.time[k + 1] - self.time[k]), 1.0)
        rows = self.state, self.reference, self.current, self.waves
        state, reference, current, waves = ((1.0 - share) * row[k] + share * row[k + 1] for row in rows)
        side = self.side and self.side.at(time)
        up = side.state[1] - side.reference[1] if side else 0.0
        error = float(np.hypot(np.hypot(*(state[:2] - reference[:2])), up))
        return Instant(state, reference, current, waves, error, side)


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
        state = env.state[0].copy()
        return state, np.ravel(env.reference[: len(state) // 2]), env.current[0].copy(), env.load[0]

    rows, failed = [row()], False
    try:
        for k, moment in enumerate(play(policy, (env, observation), scenario.steps)):
            failed = bool(moment.failed[0])
            if not failed and k + 1 < scenario.steps:
                rows.append(row())
    except Exception as error:
        raise PolicyError(failure(error, name)) from error
    state, reference, current, load = (np.array(column) for column in zip(*rows, strict=True))
    heading = reference.shape[1] - 1
    for pose in (state, reference):
        pose[:, heading] = np.unwrap(pose[:, heading])
    planes, time = _planes(state, reference, current, load), scenario.control_dt * np.arange(float(len(rows)))
    above, *side = (RecordedEpisode(name, time, *plane, failed) for plane in planes)
    return replace(above, side=side[0] if side else None)


def _planes(state: Array, reference: Array, current: Array, load: Array) -> list[tuple[Array, Array, Array, Array]]:
    """Return state, reference, current and wave force in the plane, or as seen from above and from the side."""
    X, Y, Z, *_ = load.T
    if reference.shape[1] == 3:
        cos, sin = np.cos(state[:, 2]), np.sin(state[:, 2])
        return [(state, reference, current, np.stack(to_world(X, Y, cos, sin), axis=1))]
    body = zip(*axes(state[:, 3], state[:, 4], ARRAYS), strict=True)
    force = np.stack([a * X + b * Y + c * Z for a, b, c in body], axis=1)
    moving, pushed = two_planes(state, reference, current), two_planes(state, reference, force)
    return [(*plane, waves.vectors) for plane, waves in zip(moving, pushed, strict=True)]
