"""Where tasks run: in this process, or in worker processes beside it."""

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

DEFAULT_JOBS = min(2, os.cpu_count() or 1)  # tasks at a time
WATCH = 0.5  # [s] between two looks of a worker process at whether its parent is still there


@dataclass(frozen=True)
class Workers:
    """How many tasks run at a time."""

    jobs: int = 1

    @classmethod
    def of(cls, jobs: int | None) -> Workers:
        """Return the workers of the option --jobs; None: `DEFAULT_JOBS`.

        Raises:
            ValueError: there are none.
        """
        if jobs is not None and jobs < 1:
            raise ValueError(f"--jobs is {jobs}; it must be 1 or more")
        return cls(jobs or DEFAULT_JOBS)

    def each_of(self, tasks: int) -> int:
        """Return how many processes each of so many tasks may have, its own included, if all run at a time."""
        return max(1, self.jobs // max(1, tasks))

    def results(self, function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]]) -> Iterator[Any]:
        """Yield what the function returns for each task's arguments, as it arrives.

        A worker gets one thread, since it shares its machine with the others, and ends with the process that started
        it. A terminal sends Ctrl-C to all of them; only the starting process handles it.

        Raises:
            WorkerError: a worker process was lost; what it did is to be run again.
        """
        jobs = min(self.jobs, len(tasks))
        if jobs <= 1:
            yield from (function(*task) for task in tasks)
        else:
            yield from _beside(function, tasks, jobs)


def _beside(function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], jobs: int) -> Iterator[Any]:
    """Yield the results of so many worker processes on this machine."""
    calls, found = [joblib.delayed(function)(*task) for task in tasks], None
    each = {"inner_max_num_threads": 1, "initializer": _end_with, "initargs": (os.getpid(),)}
    with _losses_as_worker_errors():
        try:
            with joblib.parallel_config(backend="loky", **each), _interrupts_blocked():
                found = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")(calls)
        except KeyboardInterrupt as interrupt:
            if found is not None:
                found.throw(interrupt)  # one that is left alone ends its workers too, but warns of what is lost
            raise
        yield from found


class Elsewhere:
    """An object in a worker process of its own, whose methods are called from here; see `Workers.results`.

    It ends with `close`, or with the process that has made it.
    """

    def __init__(self, make: Callable[..., Any], *arguments: Any) -> None:
        """Begin to make an object; what that raises the first call does."""
        spawn = multiprocessing.get_context("spawn")
        with _interrupts_blocked():  # not joblib's processes: one whose memory grows is replaced there by another
            self._process = futures.ProcessPoolExecutor(1, spawn, initializer=_end_with, initargs=(os.getpid(),))
            self._made = self._process.submit(_keep, make, arguments)

    def call(self, method: str, *arguments: Any) -> Callable[[], Any]:
        """Begin to call a method, behind all calls before; what is returned waits for what it returns.

        Raises:
            WorkerError: the process was lost, here or where it is waited for.
        """
        with _losses_as_worker_errors():
            answer = self._process.submit(_call, method, arguments)

        def wait() -> Any:
            with _losses_as_worker_errors():
                self._made.result()
                return answer.result()

        return wait

    def close(self) -> None:
        """End the process, behind the call that it is at."""
        self._process.shutdown(cancel_futures=True)


_kept: list[Any] = []
"""The object of an `Elsewhere` in its process."""


def _keep(make: Callable[..., Any], arguments: Sequence[Any]) -> None:
    _kept[:] = [make(*arguments)]


def _call(method: str, arguments: Sequence[Any]) -> Any:
    return getattr(_kept[0], method)(*arguments)


@contextmanager
def _losses_as_worker_errors() -> Iterator[None]:
    """Raise `WorkerError` where a pool of processes, joblib's or Python's, has lost a worker."""
    try:
        yield
    except BrokenProcessPool as error:
        reason = str(error).partition(chr(10))[0]
        raise WorkerError(f"a worker process was lost, perhaps for want of memory: {reason}") from error


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block SIGINT in the processes that start in this block; this process handles it at the end of the block.

    A child inherits the blocked signal before its first line runs. A handler that the child installs would come too
    late: a worker imports for seconds first, and an interrupt in between is a traceback.
    """
    if sys.platform == "win32":  # has no masks
        yield
        return
    for tracker in (resource_tracker_of_joblib, resource_tracker):
        tracker.ensure_running()  # now: starting it lifts the block
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with(parent: int) -> None:
    """End this worker process when its parent ends, even if the parent is killed."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
