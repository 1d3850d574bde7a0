"""Runs tasks in this process, in parallel worker processes, or on the workers of a cluster."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent import futures
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any

import joblib
from joblib.externals.loky.backend import resource_tracker as resource_tracker_of_joblib
from threadpoolctl import threadpool_limits

from auv_gym.installation import install
from baselines.tools.command_line import WorkerError, described, warned

DEFAULT_JOBS = min(2, os.cpu_count() or 1)  # number of parallel tasks
_ANSWER = 30  # [s] in which a scheduler and a worker of a cluster must answer
WATCH = 0.5  # [s] interval at which a worker process checks that its parent still runs


@dataclass(frozen=True)
class Workers:
    """Where tasks run in parallel."""

    jobs: int = 1  # processes of this machine
    cluster: str = ""  # address or file of a Dask scheduler whose workers run the tasks instead; "": none

    @classmethod
    def of(cls, jobs: int | None, cluster: str | None = None) -> Workers:
        """Return the workers for values of the options --jobs, None: `DEFAULT_JOBS`, and --cluster.

        Raises:
            ValueError: it is below 1.
        """
        if jobs is not None and jobs < 1:
            raise ValueError(f"--jobs is {jobs}; it must be 1 or more")
        return cls(jobs or DEFAULT_JOBS, cluster or "")

    def each_of(self, tasks: int) -> int:
        """Return the number of processes for each of some parallel tasks, at least 1: its own process is included."""
        return 1 if self.cluster else max(1, self.jobs // max(1, tasks))

    def results(self, function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]]) -> Iterator[Any]:
        """Yield the result of the function for each task's arguments, in the order of completion.

        A worker process computes with one thread, since it shares the machine with the others. It ends when its parent
        ends. A terminal sends Ctrl-C to all processes; only the parent handles it.

        Raises:
            WorkerError: a worker process ended unexpectedly; its task must be run again. On a cluster another worker
                runs it; the error is that no scheduler or no suitable worker answers, or that a task ends each worker.
        """
        jobs = min(self.jobs, len(tasks))
        if self.cluster:
            yield from _on_cluster(function, tasks, self.cluster)
        elif jobs <= 1:
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


def _on_cluster(function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], cluster: str) -> Iterator[Any]:
    """Yield the results of the workers of a Dask scheduler; the task of a worker that has gone runs on another one."""
    try:
        dask: Any = importlib.import_module("distributed")
    except ImportError as error:
        raise WorkerError(f"--cluster needs Dask: {install('cluster')}") from error
    if cluster.endswith(".json") and not Path(cluster).is_file():
        raise WorkerError(f"cannot read {cluster}; --cluster is the file of a Dask scheduler, or its address")
    where = {"scheduler_file": cluster} if Path(cluster).is_file() else {"address": cluster}
    client = dask.Client.__new__(dask.Client)
    try:
        client.__init__(**where, timeout=_ANSWER, set_as_default=False)
    except Exception as error:
        client.status = "closed"  # otherwise its destructor would wait for a scheduler, and fail
        raise WorkerError(f"no Dask scheduler answers at {cluster}: {described(error)}") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_ANSWER)
        except TimeoutError as error:
            raise WorkerError(f"the Dask scheduler at {cluster} has no workers; start some: dask worker") from error
        if most := [n for n in client.nthreads().values() if n > 1]:
            raise WorkerError(f"a Dask worker has {most[0]} threads; start each with --nthreads 1, and --nworkers N")
        place = tuple(sys.path), str(Path.cwd())
        calls = [client.submit(_remote, *place, pickle.dumps((function, task)), pure=False) for task in tasks]
        for call in dask.as_completed(calls, loop=client.loop):
            try:
                yield call.result()
            except dask.KilledWorker as error:
                raise WorkerError(f"a task has ended several Dask workers, perhaps out of memory: {error}") from error
            call.release()


def _remote(path: Sequence[str], folder: str, task: bytes) -> Any:
    """Run a task in a worker of a cluster, which has the folders of the caller, with one thread."""
    sys.path[:] = [*dict.fromkeys((*path, *sys.path))]
    os.chdir(folder)
    with threadpool_limits(1):
        function, arguments = pickle.loads(task)  # after the path is known, since it imports the user's effects
        return function(*arguments)


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
    warnings.formatwarning = warned

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
