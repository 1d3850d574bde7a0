"""The loop that runs a policy through parallel episodes in the vector environment."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple, TypeAlias

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from auv_gym.envs.space import UnderactuatedAUVTrack3DVectorEnv
from auv_gym.envs.spaces import finite_numbers
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.namespaces import Array
from auv_gym.planning.paths import Line
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.kernels import MakeSimulator
from auv_gym.task.policy import Policy, preview_of
from baselines.agents.programs import ProgramPolicy
from baselines.evaluation.metrics import Measures, Track, effort, rmse, settling_time, smoothness, steady_rmse
from baselines.policy import Privileged

EVALUATED_ENV = "auv_gym:UnderactuatedAUVTrack-v0"  # id of the environment of evaluations
TRACED = 3
"""Number of episodes of a rollout whose trajectories are recorded: the first ones."""
_WARM_UP_STEPS = 10
"""Control steps before those that count for the time limit, since the first ones may compile or load code."""
_TIMED_STEPS = 10
"""Smallest number of control steps whose mean time is compared with the limit: one pause of the machine may be long."""
Begun: TypeAlias = tuple[UnderactuatedAUVTrackVectorEnv, Array]
"""An environment at the beginning of its episodes, and its first observation."""


class PolicyError(Exception):
    """A policy gave no usable action, or took too long."""


@dataclass(frozen=True)
class Rollout:
    """The results of N episodes of a scenario, K steps each."""

    measures: Measures
    errors: NDArray[np.float32]  # [m], shape (K, N); a failed episode keeps its last error
    tracks: tuple[Track, ...]  # of the first `TRACED` episodes
    seconds: float  # wall time of the rollout
    decision_seconds: float  # wall time of the policy for one vehicle and control step
    slowest_decision: float  # [s] largest mean time that was compared with the limit, see `Stopwatch`


class ControlStep(NamedTuple):
    """One control step of N episodes."""

    observation: Array  # before the step, shape (N, terms)
    command: Array  # shape (N, channels), zero for episodes that have ended
    reward: Array  # shape (N,)
    error: Array  # [m] distance to the reference after the step, shape (N,)
    running: NDArray[np.bool_]  # shape (N,), not ended before the step; the other entries of ended ones are meaningless
    failed: NDArray[np.bool_]  # shape (N,), ended in this step, beyond `lost_distance`
    saturated: NDArray[np.bool_]  # shape (N,), an actuator was commanded to its limit
    following: Array  # the next observation, shape (N, terms); one step after an end, that of the next episode


class Stopwatch:
    """Measures the wall time of a policy; waiting and the work of other processes count too.

    Attributes:
        slowest: the largest mean time of a decision [s] that was compared with the limit.
    """

    def __init__(self, limit: float = math.inf) -> None:
        """Start at zero.

        Args:
            limit: largest mean time of a decision for one vehicle [s], after the first `_WARM_UP_STEPS` steps and over
                at least `_TIMED_STEPS`.
        """
        self.limit, self.slowest, self._decisions, self._seconds = limit, 0.0, 0, 0.0
        self._warm_up = 0, 0.0  # number of decisions, and their time, that do not count

    @property
    def decision_seconds(self) -> float:
        """Mean time of a decision for one vehicle [s]."""
        return self._seconds / self._decisions

    def __enter__(self) -> None:
        self._since = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self._seconds += time.perf_counter() - self._since

    def count(self, n: int, k: int) -> None:
        """Count the decisions for n vehicles at step k; raise PolicyError if they took too long."""
        self._decisions += n
        if k < _WARM_UP_STEPS:
            self._warm_up = self._decisions, self._seconds
        if k < _WARM_UP_STEPS + _TIMED_STEPS - 1:
            return
        mean = (self._seconds - self._warm_up[1]) / (self._decisions - self._warm_up[0])
        self.slowest = max(self.slowest, mean)
        if mean > self.limit:
            raise PolicyError(f"a decision takes {mean:.3g} s; allowed are {self.limit:g} s")


def play(policy: Policy, begun: Begun, steps: int, stopwatch: Stopwatch | None = None) -> Iterator[ControlStep]:
    """Run a policy and yield each control step, until all episodes have ended.

    Args:
        policy: it gets its memory back at each step, and `episode_start`, True at the first step of an episode.
        begun: the environment, whose next episodes begin one step after the end, and its first observation.
        steps: largest number of steps.
        stopwatch: measures the policy's time.

    Raises:
        PolicyError: the policy's actions are not finite numbers, one for each vehicle and channel, or it is too slow.
    """
    (env, observation), stopwatch = begun, stopwatch or Stopwatch()
    privileged = policy if isinstance(policy, Privileged) else None
    (channels,) = env.single_action_space.shape or ()
    memory, first, running = None, np.ones(env.num_envs, dtype=bool), np.ones(env.num_envs, dtype=bool)
    ended = ~running  # in the last step: the coming step begins the next episodes of these vehicles
    for k in range(steps):
        with stopwatch:
            if privileged:
                privileged.observe(env)
            returned = policy.predict(observation, memory, first)
        if not isinstance(returned, tuple) or len(returned) != 2:
            raise PolicyError("predict returned no pair; it must return (action, state), with None for no state")
        action, memory = returned
        stopwatch.count(env.num_envs, k)
        command = _checked(action, running, k, channels)
        following, reward, terminated, truncated, info = env.step(command)
        first, ended, failed = ended, terminated | truncated, running & terminated
        yield ControlStep(
            observation, command, reward, info["position_error"], running, failed, info["saturated"], following
        )
        observation, running = following, running & ~ended
        if not running.any():
            return


def beginning(
    cells: Sequence[tuple[Scenario, Sequence[Episode]]],
    preview: tuple[int, ...],
    simulator: MakeSimulator | None = None,
) -> Begun:
    """Return an environment with all episodes of some scenarios in parallel, and its first observation.

    Args:
        cells: scenarios with the same number of substeps, and the episodes of each.
        preview: numbers of control periods ahead of the preview, see `auv_gym.task.preview`.
        simulator: makes the vehicles of another simulator, if it replaces the plant.
    """
    # The environment begins a next episode one step after an end. It is not evaluated, so its path is a straight line,
    # which needs no planning; if all episodes end together, it is never begun.
    after = [replace(scenario, path=Line(episodes[0].path.speed)) for scenario, episodes in cells]
    scenarios = [scenario for scenario, (_, episodes) in zip(after, cells, strict=True) for _ in episodes]
    make = UnderactuatedAUVTrack3DVectorEnv if scenarios[0].vertical else UnderactuatedAUVTrackVectorEnv
    env = make(len(scenarios), scenarios, preview=preview, autoreset_mode=AutoresetMode.NEXT_STEP)
    if simulator is not None:
        env.use_simulator(simulator)
    observation, _ = env.reset(seed=0, options={"episode": [episode for _, episodes in cells for episode in episodes]})
    return env, observation


class Repeatable:
    """Parallel episodes for several policies, one after the other; they are planned once for each preview."""

    def __init__(self, begin: Callable[[tuple[int, ...]], Begun]) -> None:
        """Take the function that returns the environment and its first observation for a preview."""
        self._begin = cache(begin)

    def play(self, policy: Policy, steps: int, stopwatch: Stopwatch | None = None) -> Iterator[ControlStep]:
        """Run a policy and yield each control step, see the function `play`."""
        return play(policy, copy.deepcopy(self._begin(preview_of(policy))), steps, stopwatch)


def rollout(
    policy: Policy,
    scenario: Scenario,
    episodes: Sequence[Episode],
    step_limit: float = math.inf,
    simulator: MakeSimulator | None = None,
) -> Rollout:
    """Run a policy in N parallel episodes of a scenario and return the results.

    Args:
        policy: see `play`.
        scenario: scenario of the episodes.
        episodes: the episodes.
        step_limit: largest mean time of a decision for one vehicle [s], see `Stopwatch`.
        simulator: makes the vehicles of another simulator, if it replaces the plant.

    Raises:
        PolicyError: see `play`.
    """
    start, stopwatch = time.perf_counter(), Stopwatch(step_limit)
    if isinstance(policy, ProgramPolicy):
        policy.step_limit = step_limit
    if isinstance(policy, Privileged):
        policy.prepare(scenario, episodes)
    env, observation = beginning([(scenario, episodes)], preview_of(policy), simulator)
    log = EpisodeLog(scenario.steps, len(episodes), len(scenario.parts.model.channels))
    log.rows.append(_row(env))
    for k, moment in enumerate(play(policy, (env, observation), scenario.steps, stopwatch)):
        log.add(k, moment)
        if log.running[:TRACED].any() and k + 1 < scenario.steps:
            log.rows.append(_row(env))
    return Rollout(
        log.measures(scenario),
        log.errors.astype(np.float32),
        log.tracks,
        time.perf_counter() - start,
        stopwatch.decision_seconds,
        stopwatch.slowest,
    )


class EpisodeLog:
    """Log of K steps of N episodes, each until its own end."""

    def __init__(self, steps: int, n: int, channels: int) -> None:
        """Make an empty log."""
        self.errors, self._rewards = np.zeros((steps, n)), np.zeros((steps, n))
        self._actions = np.zeros((steps, n, channels))
        self.rows: list[Array] = []  # of the traced episodes, see `_row`
        self.running, self._failed, self._length = np.ones(n, dtype=bool), np.zeros(n, dtype=bool), np.full(n, steps)

    def add(self, k: int, m: ControlStep) -> None:
        """Add step k; episodes that have ended keep their last error."""
        self._actions[k], self._rewards[k] = np.clip(m.command, -1.0, 1.0), np.where(m.running, m.reward, 0.0)
        self.errors[k] = np.where(m.running, m.error, self.errors[k - 1])
        self._failed |= m.failed
        self._length[m.failed] = k + 1
        self.running = m.running & ~m.failed
        if not self.running.any():
            self.errors[k + 1 :] = self.errors[k]

    @property
    def tracks(self) -> tuple[Track, ...]:
        """The tracks of the traced episodes, each as long as its episode."""
        table = np.array(self.rows)
        return tuple(Track(table[: int(length), :, i]) for i, length in enumerate(self._length[: table.shape[2]]))

    def measures(self, scenario: Scenario) -> Measures:
        """Return the metrics of the episodes."""
        commands = [self._actions[:n, i] for i, n in enumerate(self._length.tolist())]
        return Measures(
            rmse=rmse(self.errors),
            steady_rmse=steady_rmse(self.errors),
            settling=settling_time(self.errors, scenario.error_scale, scenario.control_dt),
            effort=np.array([effort(c) for c in commands]),
            smoothness=np.array([smoothness(c) for c in commands]),
            saturation=np.array([np.mean((np.abs(c) >= 1).any(axis=1)) for c in commands]),
            total_reward=self._rewards.sum(axis=0),
            steps=self._length.astype(np.float64),
            failed=self._failed,
        )


def _checked(action: Any, running: NDArray[np.bool_], k: int, channels: int) -> Array:
    """Return the actions of step k as floats, shape (N, channels), zero for episodes that have ended.

    Raises:
        PolicyError: they have another shape or type, or are not finite.
    """
    n = len(running)
    array = np.asarray(action)
    if array.dtype.kind not in "fiu" or array.shape != (n, channels):
        raise PolicyError(
            f"step {k}: actions have shape {array.shape} and type {array.dtype}; "
            f"for {n} observations they must be numbers of shape ({n}, {channels})"
        )
    finite = np.isfinite(array).all(axis=1) | ~running
    if not finite.all():
        i = int(np.argmin(finite))
        raise PolicyError(
            f"step {k}, episode {i}: action is {array[i]}; it must be {finite_numbers(channels)} in [-1, 1]"
        )
    return np.where(running[:, None], array, 0.0).astype(np.float64)


def make_env(scenario: Scenario) -> gym.Env[Any, Any]:
    """Return the scalar environment of a scenario.

    Raises:
        ValueError: the scenario's path is not feasible.
    """
    name = EVALUATED_ENV.replace("Track-", "Track3D-") if scenario.vertical else EVALUATED_ENV
    return gym.make(name, scenario=scenario, disable_env_checker=True)


def _row(env: UnderactuatedAUVTrackVectorEnv) -> Array:
    """Return the rows of a `Track` of the traced vehicles, shape (rows, n)."""
    (x, y, psi, *z), R, (V_x, V_y, *_) = env.pose.T, env.reference, env.current.T
    height = (*z, R.z) if z else ()
    return np.array((x, y, R.x, R.y, psi, R.psi, V_x, V_y, *height))[:, :TRACED]
