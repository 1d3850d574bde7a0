"""Runs policies through scenarios: paired seeds, worker processes, the same numbers for any number of them."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import joblib
import numpy as np

from auv_gym.residual import Policy
from auv_gym.scenario import Scenario
from baselines import make_policy
from baselines.evaluation.metrics import EpisodeRecord, Track

ENV_ID = "auv_gym:UnderactuatedAUVTrack-v0"
CHUNK = 5
"""Episodes of a task. Fixed, so that what a policy object lives through does not depend on the number of workers."""


@dataclass(frozen=True)
class Task:
    """Some episodes of one policy in one scenario."""

    policy: str
    scenario: Scenario
    seeds: tuple[int, ...]
    keep_track: bool  # of the first episode


@dataclass(frozen=True)
class Run:
    """The episodes of one policy in one scenario, ordered by seed; or the reason why there are none."""

    policy: str
    scenario: Scenario
    records: tuple[EpisodeRecord, ...]
    error: str | None = None
    warnings: tuple[str, ...] = ()


def make_env(scenario: Scenario) -> gym.Env[Any, Any]:
    """Return the scalar environment of a scenario.

    Raises:
        ValueError: the scenario's path cannot be followed.
    """
    return gym.make(ENV_ID, scenario=scenario, disable_env_checker=True)


def run_all(
    policies: Sequence[str],
    scenarios: Sequence[Scenario],
    episodes: int,
    seed: int,
    jobs: int,
    on_run: Callable[[Run], None],
    on_episodes: Callable[[int], None] = lambda _: None,
) -> list[Run]:
    """Return a run of each policy in each scenario, scenario by scenario.

    Args:
        policies: their names, see `baselines.make_policy`.
        scenarios: what they run in.
        episodes: episodes of each run; episode i has the seed `seed + i`, whatever the policy.
        seed: of the first episode.
        jobs: worker processes; 1 runs in this one.
        on_run: called with each run when it is complete.
        on_episodes: called with the number of episodes whenever some are through.
    """
    pairs = [(policy, scenario) for scenario in scenarios for policy in policies]
    seeds = range(seed, seed + episodes)
    chunks = [tuple(seeds[i : i + CHUNK]) for i in range(0, episodes, CHUNK)]
    parts: list[list[Run | None]] = [[None] * len(chunks) for _ in pairs]
    runs: dict[int, Run] = {}
    tasks = [
        (i, j, Task(policy, scenario, chunk, keep_track=j == 0))
        for i, (policy, scenario) in enumerate(pairs)
        for j, chunk in enumerate(chunks)
    ]
    for i, j, part in _parallel(tasks, jobs):
        parts[i][j] = part
        on_episodes(len(chunks[j]))
        done = [p for p in parts[i] if p is not None]
        if len(done) == len(chunks):
            runs[i] = _joined(done)
            on_run(runs[i])
    return [runs[i] for i in range(len(pairs))]


def _parallel(tasks: Sequence[tuple[int, int, Task]], jobs: int) -> Iterator[tuple[int, int, Run]]:
    """Yield the result of each task as it arrives. Workers get one thread each: they share the machine."""
    jobs = min(jobs, len(tasks))
    if jobs == 1:
        yield from (_indexed(*task) for task in tasks)
        return
    with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
        yield from joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")(
            joblib.delayed(_indexed)(*task) for task in tasks
        )


def _indexed(i: int, j: int, task: Task) -> tuple[int, int, Run]:
    return i, j, run_task(task)


def _joined(parts: Sequence[Run]) -> Run:
    error = next((part.error for part in parts if part.error), None)
    records = () if error else tuple(record for part in parts for record in part.records)
    messages = dict.fromkeys(message for part in parts for message in part.warnings)
    return Run(parts[0].policy, parts[0].scenario, records, error, tuple(messages))


def run_task(task: Task) -> Run:
    """Return the episodes of a task. An exception of the policy ends it and becomes its `error`."""
    records: list[EpisodeRecord] = []
    error, seed = None, task.seeds[0]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            env, policy = make_env(task.scenario), make_policy(task.policy)
            for seed in task.seeds:
                record = run_episode(env, policy, seed, task.keep_track and seed == task.seeds[0])
                records.append(record)
        except Exception as exception:  # noqa: BLE001, whatever a policy raises costs it its row, not the others theirs
            reason = " ".join(str(exception).split())
            error = f"seed {seed}: {type(exception).__name__}: {reason}"
    messages = dict.fromkeys(str(warning.message) for warning in caught)
    return Run(task.policy, task.scenario, tuple(records), error, tuple(messages))


def run_episode(env: gym.Env[Any, Any], policy: Policy, seed: int, keep_track: bool = False) -> EpisodeRecord:
    """Return one episode of a policy in a scalar environment."""
    begin = time.perf_counter()
    observation, _ = env.reset(seed=seed)
    simulator: Any = env.unwrapped
    memory, first, over, lost = None, np.array([True]), False, False
    errors, actions, rewards, saturated = [], [], [], 0
    rows = [_row(simulator)] if keep_track else []
    while not over:
        action, memory = policy.predict(observation, memory, first)
        observation, reward, lost, truncated, info = env.step(action)
        errors.append(info["position_error"])
        actions.append(action)
        rewards.append(reward)
        saturated += info["saturated"]
        first[0], over = False, lost or truncated
        if keep_track:
            rows.append(_row(simulator))
    return EpisodeRecord(
        seed=seed,
        errors=np.array(errors),
        actions=np.clip(np.array(actions, dtype=np.float64), -1.0, 1.0),
        saturated=saturated,
        total_reward=math.fsum(rewards),
        lost=lost,
        seconds=time.perf_counter() - begin,
        track=_track(rows) if keep_track else None,
    )


def _row(simulator: Any) -> tuple[float, ...]:
    return (*simulator.state[:2].tolist(), *simulator.reference[:2], *simulator.current.tolist())


def _track(rows: Sequence[tuple[float, ...]]) -> Track:
    table = np.array(rows)
    return Track(table[:, :2], table[:, 2:4], table[:, 4:].mean(axis=0))
