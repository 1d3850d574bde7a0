"""Processor time of two or more things in turn, round after round, so that a busy machine slows all of them alike."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Sequence

import numpy as np

from auv_gym.physics.namespaces import Array

TimedRun = Callable[[], Sequence[float]]
"""Does some work and returns the processor time [s] a unit of each piece of it."""


def cpu_time() -> float:
    """Return the processor time [s] of this process and its children: other users of the machine count little in it."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def timed(work: Callable[[], object], units: int = 1, clock: Callable[[], float] = cpu_time) -> TimedRun:
    """Return the run that does the work, of so many units, in one piece; by another clock, the times are its."""

    def run() -> Sequence[float]:
        begin = clock()
        work()
        return [(clock() - begin) / units]

    return run


def interleaved(rounds: int, *runs: TimedRun) -> list[Array]:
    """Return the times [s] of each run, taken in turn, shape (rounds, pieces)."""
    times = [[run() for run in runs] for _ in range(rounds)]
    return [np.array(column) for column in zip(*times, strict=True)]


def mean_time(times: Array) -> float:
    """Return the time [s] a unit with all that a round holds: its mean over the pieces, the median of the rounds."""
    return float(np.median(times.mean(axis=1)))


def typical_time(times: Array) -> float:
    """Return the time [s] a unit of a usual piece, without what happens in few of them, such as an episode's end."""
    return float(np.median(times))
