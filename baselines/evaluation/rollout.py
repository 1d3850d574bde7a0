"""Runs a policy through episodes: side by side in the vector environment, or one in the scalar environment."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol, runtime_checkable

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.episode import Episode
from auv_gym.paths import Line
from auv_gym.policy import Policy, preview_of
from auv_gym.scenario import Scenario
from baselines.evaluation.metrics import Array, Measures, Track, effort, rmse, settling_time, smoothness, tail_rmse

ENV_ID = "auv_gym:UnderactuatedAUVTrack-v0"
PATIENCE = 10
"""Control steps before a policy's speed is judged: the first ones may compile or load."""


@runtime_checkable
class Privileged(Protocol):
    """A policy that looks behind the observation, as no competitor may; whoever runs it lets it."""

    def prepare(self, scenario: Scenario, episodes: Sequence[Episode]) -> None:
        """Learn, before the reset, which N episodes are to run side by side."""

    def observe(self, env: Any) -> None:
        """Look at the vector environment before each `predict`: `state`, `force`, `current`, `time`."""


class PolicyError(Exception):
    """A policy gave no usable action, or not in time."""


@dataclass(frozen=True)
class Rollout:
    """What N episodes of a scenario gave, K steps each."""

    measures: Measures
    errors: NDArray[np.float32]  # [m], shape (K, N); where an episode was lost it keeps its last error
    track: Track  # of the first episode
    seconds: float  # wall time of all
    decision_seconds: float  # processor time of the policy for one vehicle and control step


def rollout(
    policy: Policy,
    scenario: Scenario,
    episodes: Sequence[Episode],
    step_limit: float,
    on_step: Callable[[int], None] = lambda _: None,
) -> Rollout:
    """Return N episodes of a policy, side by side; each ends where the scenario ends it.

    Args:
        policy: what acts; it gets its own memory back, and `episode_start`, True at the first step.
        scenario: what the episodes are of.
        episodes: what is to run.
        step_limit: largest time for a decision of one vehicle [s], on average since the start.
        on_step: called after each control step with their number so far.

    Raises:
        PolicyError: the policy's actions are not N pairs of finite numbers, or it is too slow.
    """
    begin, n = time.perf_counter(), len(episodes)
    # What an environment begins where an episode has ended is left alone: a straight line, which costs nothing to plan.
    env = UnderactuatedAUVTrackVectorEnv(
        n, replace(scenario, path=Line(episodes[0].path.speed)), preview=preview_of(policy)
    )
    privileged = policy if isinstance(policy, Privileged) else None
    if privileged:
        privileged.prepare(scenario, episodes)
    observation, _ = env.reset(seed=0, options={"episode": list(episodes)})
    log = _Log(scenario.steps, n, [_row(env)])
    memory, first, thinking, computing = None, np.ones(n, dtype=bool), 0.0, 0.0
    for k in range(scenario.steps):
        since, used = time.perf_counter(), time.process_time()
        if privileged:
            privileged.observe(env)
        action, memory = policy.predict(observation, memory, first)
        thinking, computing = thinking + time.perf_counter() - since, computing + time.process_time() - used
        decisions = n * (k + 1)
        if k >= PATIENCE and thinking / decisions > step_limit:
            raise PolicyError(f"a decision takes {thinking / decisions:.3g} s; allowed are {step_limit:g} s")
        command = _checked(action, log.running, k)
        observation, reward, terminated, truncated, info = env.step(command)
        first = terminated | truncated
        final = info["final_info"]["position_error"] if first.any() else 0.0
        log.add(k, command, np.where(first, final, info["position_error"]), reward, terminated)
        if log.running[0] and not first[0]:
            log.rows.append(_row(env))
        on_step(k + 1)
        if not log.running.any():
            break
    return Rollout(
        log.measures(scenario),
        log.errors.astype(np.float32),
        _track(log.rows),
        time.perf_counter() - begin,
        computing / decisions,
    )


class _Log:
    """What K steps of N episodes give, each until its own end."""

    def __init__(self, steps: int, n: int, rows: list[Array]) -> None:
        self.errors, self._rewards, self._actions = np.zeros((steps, n)), np.zeros((steps, n)), np.zeros((steps, n, 2))
        self.rows = rows  # of the first episode's track
        self.running, self._lost, self._length = np.ones(n, dtype=bool), np.zeros(n, dtype=bool), np.full(n, steps)

    def add(self, k: int, actions: Array, errors: Array, rewards: Array, lost: NDArray[np.bool_]) -> None:
        """Take up step k; episodes that have ended keep their last error."""
        running, lost = self.running, self.running & lost
        self._actions[k], self._rewards[k] = np.clip(actions, -1.0, 1.0), np.where(running, rewards, 0.0)
        self.errors[k] = np.where(running, errors, self.errors[k - 1])
        self._lost |= lost
        self._length[lost] = k + 1
        self.running = running & ~lost
        if not self.running.any():
            self.errors[k + 1 :] = self.errors[k]

    def measures(self, scenario: Scenario) -> Measures:
        """Return what is measured of the episodes."""
        commands = [self._actions[:n, i] for i, n in enumerate(self._length.tolist())]
        return Measures(
            rmse=rmse(self.errors),
            tail=tail_rmse(self.errors),
            settling=settling_time(self.errors, scenario.error_scale, scenario.control_dt),
            effort=np.array([effort(c) for c in commands]),
            smoothness=np.array([smoothness(c) for c in commands]),
            saturation=np.array([np.mean((np.abs(c) >= 1).any(axis=1)) for c in commands]),
            total_reward=self._rewards.sum(axis=0),
            steps=self._length.astype(np.float64),
            lost=self._lost,
        )


def _checked(action: Any, running: NDArray[np.bool_], k: int) -> Array:
    """Return the actions of step k, shape (N, 2), zero where an episode has ended."""
    n = len(running)
    array = np.asarray(action)
    if array.dtype.kind not in "fiu" or array.shape != (n, 2):
        raise PolicyError(
            f"step {k}: actions have shape {array.shape} and type {array.dtype}; "
            f"for {n} observations they must be numbers of shape ({n}, 2)"
        )
    finite = np.isfinite(array).all(axis=1) | ~running
    if not finite.all():
        i = int(np.argmin(finite))
        raise PolicyError(f"step {k}, episode {i}: action is {array[i]}; it must be two finite numbers in [-1, 1]")
    return np.where(running[:, None], array, 0.0).astype(np.float64)


def make_env(scenario: Scenario) -> gym.Env[Any, Any]:
    """Return the scalar environment of a scenario.

    Raises:
        ValueError: the scenario's path cannot be followed.
    """
    return gym.make(ENV_ID, scenario=scenario, disable_env_checker=True)


@dataclass(frozen=True)
class EpisodeRecord:
    """What is kept of one episode that ran for n control steps, n < N if it was lost."""

    seed: int
    errors: Array  # e_k [m], shape (n,)
    actions: Array  # a_k, shape (n, 2)
    lost: bool
    track: Track


def run_episode(env: gym.Env[Any, Any], policy: Policy, seed: int) -> EpisodeRecord:
    """Return one episode of a policy in a scalar environment."""
    observation, _ = env.reset(seed=seed)
    memory, first, over, lost = None, np.array([True]), False, False
    errors, actions, rows = [], [], [_row(env.unwrapped)]
    while not over:
        action, memory = policy.predict(observation, memory, first)
        observation, _, lost, truncated, info = env.step(action)
        errors.append(info["position_error"])
        actions.append(action)
        rows.append(_row(env.unwrapped))
        first, over = np.array([False]), lost or truncated
    commands = np.clip(np.array(actions, dtype=np.float64), -1.0, 1.0)
    return EpisodeRecord(seed, np.array(errors), commands, lost, _track(rows))


def _row(env: Any) -> Array:
    """Return x, y, x_R, y_R [m] and V_x, V_y [m/s] at this time, of the first vehicle."""
    first = (env.state.T[:2], env.reference[:2], env.current.T)
    return np.concatenate([np.reshape([np.ravel(value)[0] for value in part], -1) for part in first])


def _track(rows: Sequence[Array]) -> Track:
    table = np.array(rows)
    return Track(table[:, :2], table[:, 2:4], table[:, 4:].mean(axis=0))
