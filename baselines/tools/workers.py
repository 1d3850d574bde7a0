"""Where tasks run: in this process, in worker processes beside it, or on the machines of a Ray cluster."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent import futures
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from multiprocessing import resource_tracker
from typing import Any
from urllib.parse import urlsplit

import joblib
from joblib.externals.loky.backend import resource_tracker as resource_tracker_of_joblib

from auv_gym.installation import install
from baselines.tools.command_line import WorkerError

PATIENCE = 4.0  # [s] until an address counts as not answering
JOINING = 60.0  # [s] in which a cluster that answers must take this process in
_NAMED = ("auto", "local")
"""Names in place of an address: the cluster that this machine belongs to, and one made for the occasion."""
DEFAULT_JOBS = min(2, os.cpu_count() or 1)  # tasks at a time
RETRIES = 3  # times that a task runs again whose worker or machine has died
_LONGEST = 500  # characters of a message of Ray's that are shown
SETTINGS = b"\0\0\0\x04\0\0\0\0\0"
"""An empty frame of settings, whose fourth byte says that it is one."""
GREETING = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + SETTINGS
"""What a client of HTTP/2 says first."""
WATCH = 0.5  # [s] between two looks of a worker process at whether its parent is still there


class ClusterError(ValueError):
    """There is no such cluster, or Ray is missing."""


@dataclass(frozen=True)
class Workers:
    """How many tasks run at a time, and where."""

    jobs: int = 1
    on_cluster: bool = False  # the one that `connect` has reached

    @classmethod
    def of(cls, jobs: int | None, cluster: str | None) -> Workers:
        """Return the workers of a command line's options.

        Args:
            jobs: how many; None: as many as a cluster has processors, on this machine `DEFAULT_JOBS`.
            cluster: its address, see `connect`; None: this machine.

        Raises:
            ClusterError: see `connect`.
            ValueError: there are none.
        """
        if jobs is not None and jobs < 1:
            raise ValueError(f"--jobs is {jobs}; it must be 1 or more")
        if cluster is None:
            return cls(jobs or DEFAULT_JOBS)
        processors = connect(cluster)
        return cls(jobs or processors, on_cluster=True)

    def each_of(self, tasks: int) -> int:
        """Return how many processes each of so many tasks may have, its own included, if all run at a time."""
        return 1 if self.on_cluster else max(1, self.jobs // max(1, tasks))

    def results(self, function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]]) -> Iterator[Any]:
        """Yield what the function returns for each task's arguments, as it arrives.

        A worker gets one thread, since it shares its machine with the others, and ends with the process that started
        it. A terminal sends Ctrl-C to all of them; only the starting process handles it. On a cluster every machine
        needs this project in the same version, and the files that the arguments name.

        Raises:
            WorkerError: a worker process was lost, or the cluster failed; what it did is to be run again.
        """
        jobs = min(self.jobs, len(tasks))
        if self.on_cluster and tasks:
            yield from _on_cluster(function, tasks, jobs)
        elif jobs <= 1:
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


def _on_cluster(function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], jobs: int) -> Iterator[Any]:
    """Yield the results of a Ray cluster, so many tasks at a time.

    Ray itself runs a task again, on a machine that is left, whose worker or machine has died.
    """
    import ray

    remote, waiting, left = ray.remote(num_cpus=1, max_retries=RETRIES)(function), iter(tasks), len(tasks)
    running = [remote.remote(*task) for task in itertools.islice(waiting, jobs)]
    try:
        while running:
            [done], running = ray.wait(running)
            result = ray.get(done)
            running += [remote.remote(*task) for task in itertools.islice(waiting, 1)]
            yield result
            left -= 1
    except Exception as error:  # of whatever kind Ray's own are
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:_LONGEST]
        raise WorkerError(f"the Ray cluster failed, with {left} tasks left: {reason}") from error
    finally:
        for task in running:
            ray.cancel(task, force=True)


def connect(address: str) -> int:
    """Connect to a Ray cluster and return the number of its processors.

    Args:
        address: HOST:PORT of its head, ray://HOST:PORT from outside, "auto" for the one that this machine belongs to,
            "local" for one on this machine alone.

    Raises:
        ClusterError: Ray is missing, or nothing answers there.
    """
    try:
        import ray
    except ImportError as error:
        raise ClusterError(f"a cluster needs Ray: {install('cluster')}") from error
    if address not in _NAMED:
        _reach(address)
    try:
        _within(JOINING, partial(ray.init, address=address, log_to_driver=False, logging_level="ERROR"))
        return int(ray.cluster_resources()["CPU"])
    except (Exception, SystemExit) as error:
        hint = "; if it asks for a token, set RAY_AUTH_TOKEN" if address not in _NAMED else ""
        reason = f"no answer within {JOINING:g} s" if isinstance(error, futures.TimeoutError) else error
        raise ClusterError(f"cannot use the Ray cluster {address}: {reason}{hint}") from error


def _within(seconds: float, function: Callable[[], Any]) -> None:
    """Call a function that has no time limit of its own; raise `futures.TimeoutError` where it takes longer."""
    outcome: futures.Future[Any] = futures.Future()

    def call() -> None:
        try:
            outcome.set_result(function())
        except BaseException as error:  # noqa: BLE001, raised again where the outcome is asked for
            outcome.set_exception(error)

    threading.Thread(target=call, daemon=True).start()
    outcome.result(seconds)


def _reach(address: str) -> None:
    """Raise ClusterError unless something at an address speaks as a cluster does.

    Ray itself waits for minutes where nothing answers, so what speaks gRPC is told from what does not: behind HTTP/2's
    greeting it sends its settings (RFC 9113, 3.4). Behind TLS (RAY_USE_TLS) that cannot be seen.
    """
    url = urlsplit(address if "://" in address else f"//{address}")
    try:
        if not url.hostname or not url.port:
            raise ValueError("neither HOST:PORT nor ray://HOST:PORT, auto or local")
        with socket.create_connection((url.hostname, url.port), PATIENCE) as connection:
            if os.environ.get("RAY_USE_TLS", "0") == "0":
                connection.sendall(GREETING)
                with connection.makefile("rb") as answer:
                    if answer.read(4)[3:] != SETTINGS[3:4]:
                        raise ValueError("what answers there is no Ray cluster")
    except TimeoutError as error:
        raise ClusterError(f"cannot reach the Ray cluster {address}: no answer within {PATIENCE:g} s") from error
    except (OSError, ValueError) as error:
        raise ClusterError(f"cannot reach the Ray cluster {address}: {error}") from error
