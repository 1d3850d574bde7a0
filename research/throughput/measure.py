"""Measure how fast the environments are: `python -m research throughput --help`."""

from __future__ import annotations

import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from auv_gym.codegen import native
from auv_gym.scenarios.presets import PRESETS
from auv_gym.task.policy import preview_of
from baselines.policies import make_policy
from baselines.tools.command_line import DONE, parse
from baselines.tools.files import json_text, read_json, write_atomically
from research import DATA

PROGRAM = "python -m research throughput"
THROUGHPUT_FILE = DATA / "throughput.json"  # what was measured
SCENARIO = "cruise-storm"  # every disturbance at once
EPISODE = PRESETS[SCENARIO].steps  # control steps of an episode
TRACK = "auv_gym:UnderactuatedAUVTrack-v0"
RESIDUAL = "auv_gym:UnderactuatedAUVTrackResidual-v0"
PEER = "Pendulum-v1"
PEER_EPISODE = 200  # steps of an episode of the peer
DECISIONS = ("backstepping", "ekf", "nmpc", "apg-cruise", "helm")
"""Policies whose decisions are timed."""
_UNITS = (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9))  # of times, and how many of each make a second
Run = Callable[[], Sequence[float]]
"""Does some work and returns the processor time [s] a unit of each piece of it."""


@dataclass(frozen=True)
class Figure:
    """One measured number."""

    case: str
    value: float
    unit: str  # "x": how many times as many steps a second as a peer; "s": seconds
    goal: float | None = None  # at least that many times, at most that many seconds

    @property
    def row(self) -> tuple[str, str, str, str]:
        """What it is, its value, its goal, and whether that is met."""
        if self.goal is None:
            return self.case, written(self.value, self.unit), "", ""
        met = self.value >= self.goal if self.unit == "x" else self.value <= self.goal
        return self.case, written(self.value, self.unit), written(self.goal, self.unit), "yes" if met else "no"


@dataclass(frozen=True)
class Options:
    """Measure how fast the environments are beside Gymnasium's Pendulum; print it, and keep it for docs/speed.md.

    `python -m research pages speed` then writes the page. Exit status: 0 done, 2 wrong usage.
    """

    quick: bool = False
    """Fewer and shorter rounds, of which nothing is kept: whether all of it still runs, not how fast."""
    out: Path = THROUGHPUT_FILE
    """The file of what was measured."""


def written(value: float, unit: str) -> str:
    """Return a number with its unit, seconds in a handy multiple."""
    if unit == "x":
        return f"{value:.3g} x"
    name, factor = next(((n, f) for n, f in _UNITS if value * f >= 1), _UNITS[-1])
    return f"{value * factor:.3g} {name}"


def cpu_time() -> float:
    """Return the processor time [s] of this process and its children: other users of the machine count little in it."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def interleaved(rounds: int, *runs: Run) -> list[Any]:
    """Return the times [s] of runs that take turns, shape (rounds, pieces) each: a busy machine slows all alike."""
    times = [[run() for run in runs] for _ in range(rounds)]
    return [np.array(own) for own in zip(*times, strict=True)]


def timed(work: Callable[[], object], units: int = 1) -> Run:
    """Return the run that does some work of so many units in one piece."""

    def run() -> Sequence[float]:
        begin = cpu_time()
        work()
        return [(cpu_time() - begin) / units]

    return run


def faster(case: str, ours: Any, peer: Any, goal: float) -> Figure:
    """Return how many times as many steps a second as a peer's, for times (rounds, pieces) of both."""
    return Figure(case, float(np.median(peer.mean(axis=1)) / np.median(ours.mean(axis=1))), "x", goal)


def scalar_run(env_id: str, steps: int, *, resets: bool, **options: Any) -> Run:
    """Return an episode of so many steps under zero actions, with or without the time of the reset before it."""
    env = gym.make(env_id, **options)
    still = np.zeros(env.action_space.shape or (), dtype=env.action_space.dtype)
    env.reset(seed=0)

    def run() -> Sequence[float]:
        begin = cpu_time()
        env.reset()
        begin = begin if resets else cpu_time()
        done = 0
        while done < steps:
            done += 1
            if env.step(still)[2]:
                break
        return [(cpu_time() - begin) / done]

    return run


def vector_run(env: Any, steps: int, *, staggered: bool = False) -> Run:
    """Return steps of a vector environment under zero actions, a piece each, per vehicle.

    Episodes that end are followed by the next ones: all at once, or `staggered` one after the other.
    """
    n, still = env.num_envs, np.zeros_like(env.action_space.sample())
    env.reset(seed=0)
    phase = np.arange(n) * EPISODE // n
    for k in range(EPISODE if staggered else 0):
        env.step(still)
        if (phase == k).any():
            env.reset(options={"reset_mask": phase == k})

    def run() -> Sequence[float]:
        times = []
        for _ in range(steps):
            begin = cpu_time()
            env.step(still)
            times.append((cpu_time() - begin) / n)
        return times

    return run


def process(code: str, *, cold: bool = False) -> Run:
    """Return the run of some Python in a process of its own, `cold` with nothing compiled before."""

    def work() -> None:
        with tempfile.TemporaryDirectory() as empty:
            environment = {**os.environ, **({native.CACHE: empty} if cold else {})}
            subprocess.run([sys.executable, "-c", code], check=True, env=environment, stderr=subprocess.DEVNULL)

    return timed(work)


def scalar_figures(quick: bool) -> Iterator[Figure]:
    """The scalar environment against Pendulum, and the begin of an episode."""
    rounds = 1 if quick else 25
    own = {"scenario": SCENARIO}
    alone, peer, with_resets, peer_with_resets = interleaved(
        rounds,
        scalar_run(RESIDUAL, EPISODE - 1, resets=False, **own),
        scalar_run(PEER, PEER_EPISODE - 1, resets=False),
        scalar_run(RESIDUAL, EPISODE, resets=True, **own),
        scalar_run(PEER, PEER_EPISODE, resets=True),
    )
    yield faster(f"scalar residual environment against {PEER}, steps alone", alone, peer, 5.0)
    yield faster("... with resets", with_resets, peer_with_resets, 3.2)
    env, vector = gym.make(RESIDUAL, scenario=SCENARIO), vector_env(RESIDUAL, 64)
    env.reset(seed=0)
    vector.reset(seed=0)
    eleven = {"reset_mask": np.arange(64) < 11}
    times = 20  # in a row
    single, several = interleaved(
        rounds,
        timed(lambda: [env.reset() for _ in range(times)], times),
        timed(lambda: [vector.reset(options=eleven) for _ in range(times)], 11 * times),
    )
    yield Figure("begin of an episode: alone, through `reset`", float(np.median(single)), "s", 250e-6)
    yield Figure("... a sub-environment of eleven", float(np.median(several)), "s", 100e-6)


def vector_env(env_id: str, n: int) -> Any:
    """Return a vector environment of N vehicles on NumPy."""
    return gym.make_vec(env_id, n, "vector_entry_point", scenario=SCENARIO)


def vector_figures(quick: bool) -> Iterator[Figure]:
    """The vector environment against SyncVectorEnv: whole episodes, staggered ends, and steps in which none ends."""
    for n, whole, staggered, between in ((64, 18.0, 10.0, None), (1024, 30.0, 15.0, 50.0))[: 1 if quick else None]:
        ours, ours_staggered, peer = interleaved(
            1 if quick else 5,
            vector_run(vector_env(RESIDUAL, n), EPISODE),
            vector_run(vector_env(RESIDUAL, n), EPISODE, staggered=True),
            vector_run(gym.make_vec(PEER, n, "sync"), max(5, 6400 // n)),
        )
        yield faster(f"N = {n} against SyncVectorEnv({PEER}), whole episodes", ours, peer, whole)
        yield faster("... whose ends are staggered", ours_staggered, peer, staggered)
        if between is not None:
            without = np.delete(ours, np.s_[EPISODE - 1 :: EPISODE], axis=1)
            yield faster("... exogenous inputs and step, without ends", without, peer, between)


def first_figures(quick: bool) -> Iterator[Figure]:
    """What a process pays for the first environment, with and without a compiled one on the machine."""
    code = "import gymnasium as gym; env = gym.make({!r}, scenario={!r})"
    used = f"{code}; env.reset(seed=0); env.step([0.0, 0.0])"
    plain, residual, warm = interleaved(
        1 if quick else 5,
        process(used.format(TRACK, SCENARIO), cold=True),
        process(used.format(RESIDUAL, SCENARIO), cold=True),
        process(code.format(RESIDUAL, SCENARIO)),
    )
    yield Figure("first use on a new machine, plain id", float(np.median(plain)), "s", 0.8)
    yield Figure("... residual id", float(np.median(residual)), "s", 1.5)
    yield Figure("process to the first `gym.make` of the residual id, warm", float(np.median(warm)), "s", 0.45)


def decision_figures(quick: bool) -> Iterator[Figure]:
    """One decision of one vehicle in closed loop; the first five are left out."""

    def run_of(name: str) -> Run:
        policy = make_policy(name)
        env = gym.make(TRACK, scenario=SCENARIO, preview=preview_of(policy))

        def run() -> Sequence[float]:
            (observation, _), memory, times = env.reset(seed=0), None, []
            for _ in range(8 if quick else 60):
                begin = cpu_time()
                action, memory = policy.predict(observation, memory)
                times.append(cpu_time() - begin)
                observation, *_ = env.step(action)
            return times[5:]

        return run

    for name, times in zip(DECISIONS, interleaved(1 if quick else 3, *map(run_of, DECISIONS)), strict=True):
        yield Figure(f"decision of one vehicle: {name}", float(np.median(times)), "s")


MEASURED = (scalar_figures, vector_figures, first_figures, decision_figures)
"""What is measured, in this order."""


def machine() -> str:
    """Return what it is measured on."""
    compiler = native.compiler() if native.wanted() else None
    code = compiler[1].splitlines()[0] if compiler else "no compiler"
    processor = platform.processor() or platform.machine()
    return f"{processor}, {os.cpu_count()} cores, Python {platform.python_version()}, {code}"


def main(arguments: Sequence[str]) -> int:
    """Measure as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options, figures = parse(Options, arguments, PROGRAM), []
    warnings.filterwarnings("ignore", module="gymnasium")
    print(f"{machine()}; processor time on one thread; scenario {SCENARIO}\n")
    for measured in MEASURED:
        for figure in measured(options.quick):
            figures.append(figure)
            case, value, goal, met = figure.row
            print(f"{case:<68} {value:>8}  {f'goal {goal}: {met}' if goal else ''}", flush=True)
    if not options.quick:
        write_atomically(options.out, json_text({"machine": machine(), "figures": [asdict(f) for f in figures]}))
        print(f"\nwritten: {options.out}")
    return DONE


def context(page: str) -> dict[str, Any]:
    """Return machine, scenario and the rows of the table for docs/speed.md."""
    del page
    record = read_json(THROUGHPUT_FILE)
    return {
        "machine": record["machine"],
        "scenario": SCENARIO,
        "rows": [Figure(**figure).row for figure in record["figures"]],
    }
