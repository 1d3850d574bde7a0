"""Shared by all tests: one thread per process, since oversubscribed cores run many times slower; a stand-in for Ray."""

import os
import signal
import sys
import time
import types
from concurrent import futures
from functools import partial

import browser as browser_of_tests
import pytest

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in the background of a shell; processes inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def ray(monkeypatch):
    """A stand-in for Ray with the calls that are used; `tests/on_cluster.py` has the real one.

    Its worker is a thread, and one alone, since `warnings.catch_warnings` in several at a time leaves filters behind.
    """
    module, pool = types.ModuleType("ray"), futures.ThreadPoolExecutor(1)
    module.addresses, module.locked, module.silent = [], False, 0.0

    def init(address, **_):
        time.sleep(module.silent)
        if address == "auto" or module.locked:
            raise SystemExit(15)
        module.addresses.append(address)

    def wait(running):
        done = next(futures.as_completed(running))
        return [done], [task for task in running if task is not done]

    module.init, module.cluster_resources = init, lambda: {"CPU": 3.0}
    module.remote = lambda **_: lambda function: types.SimpleNamespace(remote=partial(pool.submit, function))
    module.wait, module.get = wait, lambda task: task.result()
    module.cancel = lambda task, force: task.cancel()
    monkeypatch.setitem(sys.modules, "ray", module)
    yield module
    pool.shutdown()


@pytest.fixture(scope="session")
def browser():
    """A headless browser, started once a worker; `browser.opened` opens a page in it."""
    with browser_of_tests.browser() as started:
        yield started


@pytest.fixture(scope="session")
def paper(tmp_path_factory):
    """The folder of the recomputed paper, made once a worker; no test writes into it."""
    from research.paper.command import main

    out = tmp_path_factory.mktemp("paper")
    assert main(["--out", str(out)]) == 0
    return out
