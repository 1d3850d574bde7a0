"""How long policies take: one decision of one vehicle, and a vehicle step of an evaluation."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator

import gymnasium as gym
import numpy as np

from auv_gym import PRESETS
from auv_gym.task.policy import preview_of
from baselines.evaluation.rollout import rollout
from baselines.policies import list_policies, make_policy
from baselines.policy import Privileged
from research.throughput.environments import TRACK
from research.throughput.figures import SCENARIO, Figure, takes
from research.throughput.timing import TimedRun, cpu_time, interleaved, timed, typical_time

DECISION_GOALS = {"apg-cruise": 2e-5, "ekf": 1e-4, "nmpc": 1.5e-3}  # [s]
STEP_GOALS = {"backstepping": 6e-7, "ekf": 6e-6, "nmpc": 1.2e-4}  # [s]


def decision_run(name: str, steps: int) -> TimedRun:
    """Return a policy's decisions for one vehicle in closed loop, a piece each; the first five are left out."""
    policy = make_policy(name)
    env = gym.make(TRACK, scenario=SCENARIO, preview=preview_of(policy))

    def run() -> list[float]:
        (observation, _), memory, times = env.reset(seed=0), None, []
        for _ in range(steps):
            begin = cpu_time()
            action, memory = policy.predict(observation, memory)
            times.append(cpu_time() - begin)
            observation, *_ = env.step(action)
        return times[5:]

    return run


def decision_cases(quick: bool) -> Iterator[Figure]:
    """One decision of one vehicle, for every policy that is not privileged."""
    names = [name for name in list_policies() if not isinstance(make_policy(name), Privileged)]
    steps, rounds = (8, 1) if quick else (60, 3)
    times = interleaved(rounds, *(decision_run(name, steps) for name in names))
    for name, own in zip(names, times, strict=True):
        yield takes(f"decision of one vehicle: {name}", typical_time(own), DECISION_GOALS.get(name))


def evaluation_cases(quick: bool) -> Iterator[Figure]:
    """A vehicle step of an evaluation, the environment and all measures included, 256 episodes side by side."""
    n, scenario = (4 if quick else 256), PRESETS[SCENARIO]
    rng = np.random.default_rng(0)
    episodes = [scenario.drawn(rng, lambda _: None)[0] for _ in range(n)]

    def run_of(name: str) -> TimedRun:
        policy = make_policy(name)
        return timed(lambda: rollout(policy, scenario, episodes), n * scenario.steps)

    for name, goal in STEP_GOALS.items():
        if quick and name == "nmpc":
            continue
        (times,) = interleaved(1 if name == "nmpc" else 3, run_of(name))
        yield takes(f"evaluation, a vehicle step: {name}", typical_time(times), goal)


def command_cases(quick: bool) -> Iterator[Figure]:
    """The command line as a user runs it."""

    def evaluating(*arguments: str) -> TimedRun:
        def work() -> None:
            with tempfile.TemporaryDirectory() as out:
                command = [sys.executable, "-m", "baselines", "evaluate", "--out", out, *arguments]
                subprocess.run(command, check=True, capture_output=True)

        return timed(work)

    quickly = ("--scenario", "cruise-calm", "--episodes", "2", "--jobs", "1") if quick else ()
    (times,) = interleaved(1, evaluating(*quickly))
    yield takes("python evaluate.py", typical_time(times), 10)
    if not quick:
        names = [name for name in list_policies() if not name.endswith(":fade")]
        (times,) = interleaved(1, evaluating("--policy", *names))
        yield takes("python evaluate.py, all policies of benchmark-v1 run anew", typical_time(times), 360)
