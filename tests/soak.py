"""Runs millions of steps in random scenarios, and checks that all numbers are finite and memory does not grow.

`python tests/soak.py [--steps N] [--seed S]`. Each round has a new vector environment with random scenarios, an
autoreset mode and a policy. `tests/baselines/test_soak.py` runs a few rounds.
"""

import argparse
import gc
import re
import sys
import time
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
from random_scenarios import SUBSTEPS, Generated, scenario

from auv_gym.codegen import native
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.envs.vector_api import AutoresetMode
from auv_gym.task.policy import preview_of
from baselines import make_policy

VEHICLES = 2000
ROUND = 400  # control steps of a round
EPISODES = (100, 400)  # control steps
POLICIES = ("uniform", "backstepping", "los-pid", "ekf", "apg-cruise", "helm")
"""The policies of the rounds, in turn; "uniform" has random actions."""
REFUSAL = re.compile(
    "infeasible at t = |the path runs from |the plan needs |an integration step, control_dt / substeps, is |"
    "scenario 'random' has speeds from "
)
"""Beginnings of the messages that a random scenario may be refused with; any other ValueError is a failure."""
GROWTH = 50  # [MiB] largest growth of memory after the first tenth, without compiled code
OF_LIBRARY = 3  # [MiB] most memory of a compiled library; each new structure of a scenario has some of its own


def resident():
    """Return the resident memory of this process [MiB]."""
    gc.collect()
    return int(re.search(r"VmRSS:\s*(\d+)", Path("/proc/self/status").read_text())[1]) / 1024


class Uniform:
    """A policy of random actions."""

    preview = ()

    def __init__(self, rng):
        self._rng = rng

    def predict(self, observation, memory, first):
        """Return random actions."""
        return self._rng.uniform(-1, 1, (len(observation), 2)), memory


def begun(rng, preview):
    """Return a vector environment of random scenarios and what it observes; None if they are refused, see `REFUSAL`."""
    choose = Generated(rng)
    substeps = (choose.of(SUBSTEPS),)
    mode = choose.of((AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP))
    try:
        some = [scenario(choose, substeps) for _ in range(choose.of((1, 5)))]
        some = [replace(each, steps=choose.of(EPISODES)) for each in some]
        chosen = [some[i % len(some)] for i in range(VEHICLES)]
        env = UnderactuatedAUVTrackVectorEnv(VEHICLES, chosen, autoreset_mode=mode, preview=preview)
        return env, env.reset(seed=int(rng.integers(2**31)))[0]
    except ValueError as error:
        if not REFUSAL.match(str(error)):
            raise
        return None


def checked(**arrays):
    """Raise AssertionError if a number is not finite."""
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise AssertionError(f"{name} holds {np.ravel(array)[~np.isfinite(np.ravel(array))][0]}")


def soak(steps, seed, report=lambda _: None):
    """Run a number of steps, summed over vehicles, and return counts, memory [MiB] and time [s] by name.

    Raises:
        AssertionError: a number is not finite, or an observation is outside of its space.
        ValueError: a scenario is refused with another message than those of `REFUSAL`.
    """
    rng, begin = np.random.default_rng(seed), time.monotonic()
    done = {"steps": 0, "episodes": 0, "environments": 0, "refused": 0, "early": 0.0, "libraries": 0}
    while done["steps"] < steps:
        name = POLICIES[done["environments"] % len(POLICIES)]
        policy = Uniform(rng) if name == "uniform" else make_policy(name)
        if (made := begun(rng, preview_of(policy))) is None:
            done["refused"] += 1
            continue
        done["environments"] += 1
        (env, observation), memory, first = made, None, np.ones(VEHICLES, dtype=bool)
        for _ in range(ROUND):
            action, memory = policy.predict(observation, memory, first)
            checked(action=action)
            try:
                observation, reward, terminated, truncated, info = env.step(action)
            except ValueError as error:  # the next episode has a path that cannot be followed
                if not REFUSAL.match(str(error)):
                    raise
                done["refused"] += 1
                break
            first = terminated | truncated
            checked(observation=observation, reward=reward, error=info["position_error"])
            done["steps"] += VEHICLES
            done["episodes"] += int(first.sum())
        if not env.observation_space.contains(observation):
            raise AssertionError("an observation is outside of its space")
        if not done["early"] and done["steps"] >= steps / 10:
            done |= {"early": resident(), "libraries": -native.library.cache_info().currsize}
            report(f"{done['steps']} steps, {done['early']:.0f} MiB, {time.monotonic() - begin:.0f} s")
    done["libraries"] += native.library.cache_info().currsize
    return {**done, "late": resident(), "seconds": time.monotonic() - begin}


def main():
    """Run the steps and print the result; the exit status is 1 if memory grows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=lambda text: int(float(text)), default=50_000_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    warnings.simplefilter("ignore")  # gains that are not made for a vehicle or a control period say so
    done = soak(options.steps, options.seed, lambda line: print(line, flush=True))
    print(
        f"{done['steps']} steps and {done['episodes']} episodes in {done['environments']} environments, "
        f"{done['refused']} refused: all numbers are finite; {done['early']:.0f} MiB after the first tenth, "
        f"{done['late']:.0f} MiB at the end with {done['libraries']} more compiled libraries; {done['seconds']:.0f} s"
    )
    sys.exit(done["late"] > done["early"] + GROWTH + OF_LIBRARY * done["libraries"])


if __name__ == "__main__":
    main()
