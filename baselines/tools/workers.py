"""Where tasks run: in this process, in worker processes beside it, or on the machines of a Ray cluster."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any
from urllib.parse import urlsplit

import joblib

PATIENCE = 5.0
"""Seconds until an address counts as not answering; Ray itself waits for two minutes."""
NAMED = ("auto", "local")
"""Addresses that are none: a cluster that this machine belongs to, and one made for the occasion."""


class ClusterError(ValueError):
    """There is no such cluster, or Ray is missing."""


@dataclass(frozen=True)
class Workers:
    """How many tasks run at a time, and where."""

    jobs: int = 1
    on_cluster: bool = False  # the one that `connect` has reached

    def results(self, function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]]) -> Iterator[Any]:
        """Yield what the function returns for each task's arguments, as it arrives.

        A worker gets one thread, since it shares its machine with the others. On a cluster every machine needs this
        project in the same version, and the files that the arguments name.

        Raises:
            ClusterError: the cluster fails twice.
        """
        jobs = min(self.jobs, len(tasks))
        if self.on_cluster and tasks:
            yield from _on_cluster(function, tasks, jobs)
        elif jobs <= 1:
            yield from (function(*task) for task in tasks)
        else:
            with joblib.parallel_config(backend="loky", inner_max_num_threads=1):
                yield from joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")(
                    joblib.delayed(function)(*task) for task in tasks
                )


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
                raise ClusterError(f"the Ray cluster failed twice, with {len(left)} tasks left: {reason}") from error
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
        ray.init(address=address, log_to_driver=False, logging_level="ERROR")
        return int(ray.cluster_resources()["CPU"])
    except (Exception, SystemExit) as error:
        hint = "; if it asks for a token, set RAY_AUTH_TOKEN" if address not in NAMED else ""
        raise ClusterError(f"cannot use the Ray cluster {address}: {error}{hint}") from error


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
