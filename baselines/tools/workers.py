"""Where tasks run: in this process, in worker processes beside it, or on the machines of a Ray cluster."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent import futures
from dataclasses import dataclass
from functools import partial
from typing import Any
from urllib.parse import urlsplit

import joblib
from joblib.externals.loky.process_executor import BrokenProcessPool

from baselines.tools.command_line import WorkerError

PATIENCE = 5.0  # [s] until an address counts as not answering; Ray itself waits for two minutes
JOINING = 60.0  # [s] in which a cluster that answers must take this process in
NAMED = ("auto", "local")
"""Names in place of an address: the cluster that this machine belongs to, and one made for the occasion."""
DEFAULT_JOBS = min(2, os.cpu_count() or 1)  # tasks at a time
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

    def results(self, function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]]) -> Iterator[Any]:
        """Yield what the function returns for each task's arguments, as it arrives.

        A worker gets one thread, since it shares its machine with the others, and ends with the process that started
        it. On a cluster every machine needs this project in the same version, and the files that the arguments name.

        Raises:
            WorkerError: a worker process was lost, or the cluster has failed twice; what it did is to be run again.
        """
        jobs = min(self.jobs, len(tasks))
        if self.on_cluster and tasks:
            yield from _on_cluster(function, tasks, jobs)
        elif jobs <= 1:
            yield from (function(*task) for task in tasks)
        else:
            calls = [joblib.delayed(function)(*task) for task in tasks]
            each = {"inner_max_num_threads": 1, "initializer": _end_with, "initargs": (os.getpid(),)}
            try:
                with joblib.parallel_config(backend="loky", **each):
                    yield from joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")(calls)
            except BrokenProcessPool as error:
                reason = str(error).partition(chr(10))[0]
                raise WorkerError(f"a worker process was lost, perhaps for want of memory: {reason}") from error


def _end_with(parent: int) -> None:
    """Let this worker process end with its parent, even with one that is killed."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _on_cluster(function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]], jobs: int) -> Iterator[Any]:
    """Yield the results of a Ray cluster; what a machine that dies had in hand is tried once more."""
    from ray.util.multiprocessing import Pool  # joblib's backend for Ray is this pool, but returns all at the end

    left = dict(enumerate(tasks))
    for last in (False, True):
        try:
            with Pool(min(jobs, len(left))) as pool:
                for i, result in pool.imap_unordered(partial(_numbered, function), list(left.items()), chunksize=1):
                    del left[i]
                    yield result
        except Exception as error:  # of whatever kind Ray's own are
            if last:
                reason = " ".join(f"{type(error).__name__}: {error}".split())
                raise WorkerError(f"the Ray cluster failed twice, with {len(left)} tasks left: {reason}") from error
        if not left:
            return


def _numbered(function: Callable[..., Any], task: tuple[int, tuple[Any, ...]]) -> tuple[int, Any]:
    return task[0], function(*task[1])


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
        raise ClusterError("a cluster needs Ray: pip install 'auv-gym[cluster]'") from error
    if address not in NAMED:
        _reach(address)
    try:
        _within(JOINING, partial(ray.init, address=address, log_to_driver=False, logging_level="ERROR"))
        return int(ray.cluster_resources()["CPU"])
    except (Exception, SystemExit) as error:
        hint = "; if it asks for a token, set RAY_AUTH_TOKEN" if address not in NAMED else ""
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
    """Raise ClusterError unless something listens at an address."""
    url = urlsplit(address if "://" in address else f"//{address}")
    try:
        if not url.hostname or not url.port:
            raise ValueError("neither HOST:PORT nor ray://HOST:PORT, auto or local")
        with socket.create_connection((url.hostname, url.port), PATIENCE):
            pass
    except (OSError, ValueError) as error:
        raise ClusterError(f"cannot reach the Ray cluster {address}: {error}") from error
