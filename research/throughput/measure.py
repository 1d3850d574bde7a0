"""Measure the speed of the environments: `python -m research throughput --help`."""

from __future__ import annotations

import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from auv_gym.codegen import native
from auv_gym.scenarios.presets import PRESETS
from auv_gym.task.policy import preview_of
from baselines.policies import make_policy
from baselines.tools.command_line import DONE, FAILED, parse
from baselines.tools.files import json_text, read_json, read_text, write_atomically
from research import DATA

PROGRAM = "python -m research throughput"
THROUGHPUT_FILE = DATA / "throughput.json"  # record of the measurements
SCENARIO = "cruise-storm"  # all disturbances together
EPISODE = PRESETS[SCENARIO].steps  # number of control steps of an episode
TRACK = "auv_gym:UnderactuatedAUVTrack-v0"
SLOWER = 1.1  # largest factor by which a ratio may fall in the history
RESIDUAL = "auv_gym:UnderactuatedAUVTrackResidual-v0"
PEER = "Pendulum-v1"
PEER_EPISODE = 200  # number of steps of an episode of `PEER`
DECISIONS = ("backstepping", "ekf", "nmpc", "apg-cruise", "helm")
"""Policies whose decisions are timed."""
_UNITS = (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9))  # units of time, and the number of each in a second
Run = Callable[[], Sequence[float]]
"""Function that does some work and returns the processor time [s] per unit, of each part of the work."""


@dataclass(frozen=True)
class Figure:
    """One measured number."""

    case: str
    value: float
    unit: str  # "x": steps per second relative to those of a peer; "s": seconds

    @property
    def row(self) -> tuple[str, str]:
        """Name and value."""
        return self.case, written(self.value, self.unit)


@dataclass(frozen=True)
class Options:
    """Measure the speed of the environments relative to Gymnasium's Pendulum; print and record the results.

    Afterwards `python -m research pages speed` writes docs/speed.md. Exit status: 0 done, 1 a ratio fell since the last
    good run of the history, 2 wrong usage.
    """

    quick: bool = False
    """Run few and short rounds and record nothing, to test that the measurement works."""
    out: Path = THROUGHPUT_FILE
    """File for the results."""
    history: Path | None = None
    """File with the ratios of earlier runs, a line of JSON each. The new ratios are compared with the last good run and
    appended. A run is good unless a ratio is lower by a factor of more than 1.1."""


def written(value: float, unit: str) -> str:
    """Return the text of a number with its unit; seconds are converted to a suitable unit."""
    if unit == "x":
        return f"{value:.3g} x"
    name, factor = next(((n, f) for n, f in _UNITS if value * f >= 1), _UNITS[-1])
    return f"{value * factor:.3g} {name}"


def cpu_time() -> float:
    """Return the processor time [s] of this process and its children; other processes hardly change it."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def interleaved(rounds: int, *runs: Run) -> list[Any]:
    """Return the times [s] of runs, shape (rounds, parts) each.

    The runs alternate, so that a busy machine slows all of them equally.
    """
    times = [[run() for run in runs] for _ in range(rounds)]
    return [np.array(own) for own in zip(*times, strict=True)]


def timed(work: Callable[[], object], units: int = 1) -> Run:
    """Return a run that does some work, of `units` units, in one part."""

    def run() -> Sequence[float]:
        begin = cpu_time()
        work()
        return [(cpu_time() - begin) / units]

    return run


def faster(case: str, ours: Any, peer: Any) -> Figure:
    """Return the ratio of steps per second, ours over the peer's, from the times (rounds, parts) of both."""
    return Figure(case, float(np.median(peer.mean(axis=1)) / np.median(ours.mean(axis=1))), "x")


def scalar_run(env_id: str, steps: int, *, resets: bool, **options: Any) -> Run:
    """Return the run of an episode with zero actions, with or without the time of the reset."""
    env = gym.make(env_id, **options)
    zero = np.zeros(env.action_space.shape or (), dtype=env.action_space.dtype)
    env.reset(seed=0)

    def run() -> Sequence[float]:
        begin = cpu_time()
        env.reset()
        begin = begin if resets else cpu_time()
        done = 0
        while done < steps:
            done += 1
            if env.step(zero)[2]:
                break
        return [(cpu_time() - begin) / done]

    return run


def vector_run(env: Any, steps: int, *, staggered: bool = False) -> Run:
    """Return the run of steps of a vector environment with zero actions; each step is a part, each vehicle a unit.

    Episodes end at the same time, or one after the other if `staggered`.
    """
    n, zero = env.num_envs, np.zeros_like(env.action_space.sample())
    env.reset(seed=0)
    phase = np.arange(n) * EPISODE // n
    for k in range(EPISODE if staggered else 0):
        env.step(zero)
        if (phase == k).any():
            env.reset(options={"reset_mask": phase == k})

    def run() -> Sequence[float]:
        times = []
        for _ in range(steps):
            begin = cpu_time()
            env.step(zero)
            times.append((cpu_time() - begin) / n)
        return times

    return run


def process(code: str, *, cold: bool = False) -> Run:
    """Return the run of Python code in a new process; `cold`: without compiled files on the machine."""

    def work() -> None:
        with tempfile.TemporaryDirectory() as empty:
            environment = {**os.environ, **({native.CACHE: empty} if cold else {})}
            subprocess.run([sys.executable, "-c", code], check=True, env=environment, stderr=subprocess.DEVNULL)

    return timed(work)


def scalar_figures(quick: bool) -> Iterator[Figure]:
    """Measure the scalar environment relative to Pendulum, and the start of an episode."""
    rounds = 1 if quick else 25
    own = {"scenario": SCENARIO}
    alone, peer, with_resets, peer_with_resets = interleaved(
        rounds,
        scalar_run(RESIDUAL, EPISODE - 1, resets=False, **own),
        scalar_run(PEER, PEER_EPISODE - 1, resets=False),
        scalar_run(RESIDUAL, EPISODE, resets=True, **own),
        scalar_run(PEER, PEER_EPISODE, resets=True),
    )
    yield faster(f"scalar residual environment against {PEER}, steps alone", alone, peer)
    yield faster("... with resets", with_resets, peer_with_resets)
    env, vector = gym.make(RESIDUAL, scenario=SCENARIO), vector_env(RESIDUAL, 64)
    env.reset(seed=0)
    vector.reset(seed=0)
    eleven = {"reset_mask": np.arange(64) < 11}
    times = 20  # repetitions in one part
    single, several = interleaved(
        rounds,
        timed(lambda: [env.reset() for _ in range(times)], times),
        timed(lambda: [vector.reset(options=eleven) for _ in range(times)], 11 * times),
    )
    yield Figure("begin of an episode: alone, through `reset`", float(np.median(single)), "s")
    yield Figure("... eleven of 64 vehicles at once, for each", float(np.median(several)), "s")


def vector_env(env_id: str, n: int) -> Any:
    """Return a NumPy vector environment of N vehicles."""
    return gym.make_vec(env_id, n, "vector_entry_point", scenario=SCENARIO)


def vector_figures(quick: bool) -> Iterator[Figure]:
    """Measure the vector environment relative to SyncVectorEnv: episodes, staggered ends, and steps without an end."""
    for n in (64, 1024)[: 1 if quick else None]:
        ours, ours_staggered, peer = interleaved(
            1 if quick else 5,
            vector_run(vector_env(RESIDUAL, n), EPISODE),
            vector_run(vector_env(RESIDUAL, n), EPISODE, staggered=True),
            vector_run(gym.make_vec(PEER, n, "sync"), max(5, 6400 // n)),
        )
        yield faster(f"N = {n} against SyncVectorEnv({PEER}), whole episodes", ours, peer)
        yield faster("... with ends at different times", ours_staggered, peer)
        without = np.delete(ours, np.s_[EPISODE - 1 :: EPISODE], axis=1)
        yield faster("... without the steps that end an episode", without, peer)


def first_figures(quick: bool) -> Iterator[Figure]:
    """Measure the first environment of a process, with and without compiled files on the machine."""
    code = "import gymnasium as gym; env = gym.make({!r}, scenario={!r})"
    used = f"{code}; env.reset(seed=0); env.step([0.0, 0.0])"
    plain, residual, warm = interleaved(
        1 if quick else 5,
        process(used.format(TRACK, SCENARIO), cold=True),
        process(used.format(RESIDUAL, SCENARIO), cold=True),
        process(code.format(RESIDUAL, SCENARIO)),
    )
    yield Figure("first use on a new machine, plain id", float(np.median(plain)), "s")
    yield Figure("... residual id", float(np.median(residual)), "s")
    yield Figure("process to the first `gym.make` of the residual id, warm", float(np.median(warm)), "s")


def decision_figures(quick: bool) -> Iterator[Figure]:
    """Measure a decision for one vehicle in closed loop, without the first five."""

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


def compared(file: Path, figures: Sequence[Figure]) -> list[str]:
    """Append the ratios of a run to a history, and return a message for each that fell since the last good run.

    Raises:
        ValueError: the file is no history.
        OSError: the file cannot be read or written.
    """
    runs = [json.loads(line) for line in read_text(file).splitlines()] if file.exists() else []
    last: Mapping[str, float] = next((run["ratios"] for run in reversed(runs) if run["good"]), {})
    ratios = {figure.case: figure.value for figure in figures if figure.unit == "x"}
    fallen = [
        f"{case}: {value:.3g} x, {last[case]:.3g} x in the last good run"
        for case, value in ratios.items()
        if SLOWER * value < last.get(case, 0.0)
    ]
    line = json.dumps({"date": datetime.now(timezone.utc).date().isoformat(), "good": not fallen, "ratios": ratios})
    write_atomically(file, "".join(f"{json.dumps(run)}\n" for run in runs) + f"{line}\n")
    return fallen


MEASURED = (scalar_figures, vector_figures, first_figures, decision_figures)
"""The measurements, in this order."""


def machine() -> str:
    """Return the description of the machine."""
    compiler = native.compiler() if native.wanted() else None
    code = compiler[1].splitlines()[0] if compiler else "no compiler"
    processor = platform.processor() or platform.machine()
    return f"{processor}, {os.cpu_count()} cores, Python {platform.python_version()}, {code}"


def main(arguments: Sequence[str]) -> int:
    """Run the measurements and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options, figures = parse(Options, arguments, PROGRAM), []
    warnings.filterwarnings("ignore", module="gymnasium")
    print(f"{machine()}; processor time on one thread; scenario {SCENARIO}\n")
    for measured in MEASURED:
        for figure in measured(options.quick):
            figures.append(figure)
            case, value = figure.row
            print(f"{case:<68} {value:>8}", flush=True)
    if not options.quick:
        write_atomically(options.out, json_text({"machine": machine(), "figures": [asdict(f) for f in figures]}))
        print(f"\nwritten: {options.out}")
    fallen = compared(options.history, figures) if options.history else []
    for message in fallen:
        print(f"slower: {message}")
    return FAILED if fallen else DONE


def context(page: str) -> dict[str, Any]:
    """Return the values of the template of docs/speed.md: machine, scenario and the rows of the table."""
    del page
    record = read_json(THROUGHPUT_FILE)
    return {
        "machine": record["machine"],
        "scenario": SCENARIO,
        "rows": [Figure(**figure).row for figure in record["figures"]],
    }
