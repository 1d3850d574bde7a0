"""Runs tasks in this process or in parallel worker processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent import futures
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from typing import Any

import joblib
from joblib.externals.loky.backend import resource_tracker as resource_tracker_of_joblib

from baselines.tools.command_line import WorkerError

DEFAULT_JOBS = min(2, os.cpu_count() or 1)  # number of parallel tasks
WATCH = 0.5  # [s] interval at which a worker process checks that its parent still runs


@dataclass(frozen=True)
class Workers:
    """The number of tasks that run in parallel."""

    jobs: int = 1

    @classmethod
    def of(cls, jobs: int | None) -> Workers:
        """Return the workers for a value of the option --jobs; None: `DEFAULT_JOBS`.

        Raises:
            ValueError: it is below 1.
        """
        if jobs is not None and jobs < 1:
            raise ValueError(f"--jobs is {jobs}; it must be 1 or more")
        return cls(jobs or DEFAULT_JOBS)

    def each_of(self, tasks: int) -> int:
        """Return the number of processes for each of some parallel tasks, at least 1: its own process is included."""
        return max(1, self.jobs // max(1, tasks))

    def results(self, function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]]) -> Iterator[Any]:
        """Yield the result of the function for each task's arguments, in the order of completion.

        A worker process computes with one thread, since it shares the machine with the others. It ends when its parent
        ends. A terminal sends Ctrl-C to all processes; only the parent handles it.

        Raises:
            WorkerError: a worker process ended unexpectedly; its task must be run again.
        """
        jobs = min(self.jobs, len(tasks))
        if jobs <= 1:
            yield from (function(*task) for task in tasks)
        else:
            yield from _in_parallel(function, tasks, jobs)


def _in_parallel(function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], jobs: int) -> Iterator[Any]:
    """Yield the results of `jobs` worker processes."""
    calls, found = [joblib.delayed(function)(*task) for task in tasks], None
    each = {"inner_max_num_threads": 1, "initializer": _begin, "initargs": (os.getpid(), tuple(sys.path))}
    with _crashes_as_worker_errors():
        try:
            with joblib.parallel_config(backend="loky", **each), _interrupts_blocked():
                found = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")(calls)
        except KeyboardInterrupt as interrupt:
            if found is not None:
                found.throw(interrupt)  # garbage collection would end the workers too, but with a warning
            raise
        yield from found


class ProcessObjects:
    """Objects in this process and in worker processes, whose methods are called at the same time.

    Object k is in process k modulo the number of processes, where process 0 is this one. The worker processes end after
    `close`, or when their parent ends; see `Workers.results`.

    Args:
        make: returns an object; if it fails in a worker process, the first call raises the exception.
        arguments: of `make`, for each object.
        processes: number of processes, including this one; there is at most one for each object.
    """

    def __init__(self, make: Callable[..., Any], arguments: Sequence[tuple[Any, ...]], processes: int = 1) -> None:
        self._count, spawn = len(arguments), multiprocessing.get_context("spawn")
        mine, *others = (arguments[j::processes] for j in range(min(processes, self._count)))
        begin = _begin, (os.getpid(), tuple(sys.path))
        with _interrupts_blocked():  # joblib would replace a process whose memory grows, and lose the objects
            self._others = [futures.ProcessPoolExecutor(1, spawn, *begin) for _ in others]
            self._made = [pool.submit(_make, make, share) for pool, share in zip(self._others, others, strict=True)]
        self._mine = [make(*one) for one in mine]

    def call(self, method: str, *arguments: Any) -> list[Any]:
        """Call a method of all objects with the same arguments, and return the results in the order of the objects.

        Raises:
            WorkerError: a worker process ended unexpectedly.
        """
        with _crashes_as_worker_errors():
            answers = [pool.submit(_call, method, arguments) for pool in self._others]
            results = [[getattr(one, method)(*arguments) for one in self._mine]]
            for made, answer in zip(self._made, answers, strict=True):
                made.result()
                results.append(answer.result())
        return [results[k % len(results)][k // len(results)] for k in range(self._count)]

    def close(self) -> None:
        """End the worker processes after the calls that are running."""
        for pool in self._others:
            pool.shutdown(cancel_futures=True)


_objects: list[Any] = []
"""The objects of a worker process."""


def _make(make: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> None:
    _objects[:] = [make(*one) for one in arguments]


def _call(method: str, arguments: Sequence[Any]) -> list[Any]:
    return [getattr(one, method)(*arguments) for one in _objects]


@contextmanager
def _crashes_as_worker_errors() -> Iterator[None]:
    """Raise `WorkerError` if a worker process of a pool, joblib's or Python's, ends unexpectedly."""
    try:
        yield
    except BrokenProcessPool as error:
        reason = str(error).partition(chr(10))[0]
        raise WorkerError(f"a worker process ended unexpectedly, perhaps out of memory: {reason}") from error


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block SIGINT in the processes that start in this block; this process handles it at the end of the block.

    A child process inherits the blocked signal before its first line runs. A handler that the child installs would come
    too late: a worker imports modules for seconds first, and an interrupt at that time prints a traceback.
    """
    if sys.platform == "win32":  # it has no signal masks
        yield
        return
    for tracker in (resource_tracker_of_joblib, resource_tracker):
        tracker.ensure_running()  # before the block, since starting it unblocks the signal
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(parent: int, path: Sequence[str]) -> None:
    """Begin a worker process, which imports from the same places as its parent.

    A thread ends it when its parent ends, even if the parent is killed.
    """
    sys.path[:] = path

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
