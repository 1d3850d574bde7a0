"""Measure the speed of environments and policies, also with Gymnasium's own benchmarks: `python -m research speed`.

Times are processor times on one thread. Two environments take turns, so that a busy machine slows both; a ratio is that
of the medians of the rounds.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils.performance import benchmark_step, benchmark_vector_step

from auv_gym.scenarios.presets import PRESETS
from auv_gym.task.policy import preview_of
from baselines.policies import make_policy
from baselines.tools.command_line import FAILED
from research.pages import table
from research.study import Study

_SCENARIO = "cruise-storm"  # all disturbances together
_TRACK, _RESIDUAL = (f"auv_gym:UnderactuatedAUVTrack{kind}-v0" for kind in ("", "Residual"))
_PEER, _PEER_EPISODE = "Pendulum-v1", 200  # environment of Gymnasium to compare with, and steps of its episodes
_EPISODE = PRESETS[_SCENARIO].steps
_POLICIES = ("backstepping", "ekf", "nmpc", "helm")


def _vector(env_id: str, n: int, **options: Any) -> Any:
    return gym.make_vec(env_id, n, "sync" if env_id == _PEER else "vector_entry_point", **options)


def _time(work: Callable[[], object]) -> float:
    begin = time.process_time()
    work()
    return time.process_time() - begin


def _steps(env: Any, steps: int, resets: bool) -> float:
    """Return the time of a step [s] with zero actions, with or without the time of the reset."""
    zero = np.zeros_like(env.action_space.sample())
    reset = _time(env.reset)
    return (_time(lambda: [env.step(zero) for _ in range(steps)]) + resets * reset) / steps


def _ratio(rounds: int, own: Callable[[], float], peer: Callable[[], float]) -> float:
    """Return the speed of our run over that of a peer."""
    times = np.array([(own(), peer()) for _ in range(rounds)])
    return float(np.divide(*np.median(times, axis=0)[::-1]))


def _scalar(quick: bool) -> Iterator[tuple[str, float]]:
    own, peer = gym.make(_RESIDUAL, scenario=_SCENARIO), gym.make(_PEER)
    rounds = 2 if quick else 25
    for label, resets in (("steps alone", False), ("with resets", True)):
        runs = (partial(_steps, env, n - 1, resets) for env, n in ((own, _EPISODE), (peer, _PEER_EPISODE)))
        yield f"one vehicle, {label} [x {_PEER}]", _ratio(rounds, *runs)
    yield "begin of an episode [us]", 1e6 * float(np.median([_time(own.reset) for _ in range(20 * rounds)]))


def _many(quick: bool) -> Iterator[tuple[str, float]]:
    for n in (64, 1024)[: 1 if quick else 2]:
        own, peer = _vector(_RESIDUAL, n, scenario=_SCENARIO), _vector(_PEER, n)
        runs = partial(_steps, own, _EPISODE, False), partial(_steps, peer, max(5, 6400 // n), False)
        yield f"N = {n}, whole episodes [x SyncVectorEnv({_PEER})]", _ratio(1 if quick else 5, *runs)


def _gymnasium(quick: bool) -> Iterator[tuple[str, float]]:
    seconds = 1 if quick else 5
    for env_id in (_TRACK, _PEER):
        name, options = env_id.rpartition(":")[2], {} if env_id == _PEER else dict[str, Any](scenario=_SCENARIO)
        yield f"`benchmark_step` of {name} [steps/s]", benchmark_step(gym.make(env_id, **options), seconds)
        many = benchmark_vector_step(_vector(env_id, 64, **options), seconds)
        yield f"`benchmark_vector_step` of {name}, N = 64 [steps/s]", many


def _decisions(quick: bool) -> Iterator[tuple[str, float]]:
    """Yield the time of a decision for one vehicle in closed loop, without the first five."""
    for name in _POLICIES:
        policy = make_policy(name)
        env = gym.make(_TRACK, scenario=_SCENARIO, preview=preview_of(policy))
        (observation, _), memory, times = env.reset(seed=0), None, []
        for _ in range(10 if quick else 200):
            begin = time.process_time()
            action, memory = policy.predict(observation, memory)
            times.append(time.process_time() - begin)
            observation, *_ = env.step(action)
        yield f"decision of `{name}` [us]", 1e6 * float(np.median(times[5:]))


_MEASURES = {"scalar": _scalar, "many": _many, "gymnasium": _gymnasium, "decisions": _decisions}
STUDY = Study("speed", [(row,) for row in _MEASURES], lambda row, quick=False: dict(_MEASURES[row](quick)), str)
_SLOWER = 0.7  # share of a recorded ratio below which the command fails


def main(arguments: Sequence[str]) -> int:
    """Measure, compare ratios with the recorded ones, and return the exit status: 1 if one is much smaller."""
    before = _figures()
    status = STUDY.main(arguments)
    for name, value in _figures().items():
        if "[x " in name and value < _SLOWER * before.get(name, 0.0):
            print(f"slower: {name} is {value:.3g}, {before[name]:.3g} in the record")
            status = FAILED
    return status


def _figures() -> dict[str, float]:
    return {name: value for values in STUDY.values().values() for name, value in values.items()}


def speed_section() -> str:
    """Return the table of docs/speed.md."""
    return table(("figure", "measured"), [(name, f"{value:,.3g}") for name, value in _figures().items()])
