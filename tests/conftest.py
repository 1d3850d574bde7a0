"""Shared by all tests: one thread per process, since oversubscribed cores run many times slower; a stand-in for Ray."""

import multiprocessing.pool
import os
import sys
import time
import types

import browser as browser_of_tests
import pytest

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")


@pytest.fixture
def ray(monkeypatch):
    """A stand-in for Ray with the calls that are used, its pool one of threads."""
    module, util, pool = (types.ModuleType(name) for name in ("ray", "ray.util", "ray.util.multiprocessing"))
    module.addresses, module.locked, module.silent = [], False, 0.0

    def init(address, **_):
        time.sleep(module.silent)
        if address == "auto" or module.locked:
            raise SystemExit(15)
        module.addresses.append(address)

    module.init, module.cluster_resources = init, lambda: {"CPU": 3.0}
    pool.Pool = multiprocessing.pool.ThreadPool
    for part in (module, util, pool):
        monkeypatch.setitem(sys.modules, part.__name__, part)
    return module


@pytest.fixture(scope="session")
def browser():
    """A headless browser, started once a worker; `browser.opened` opens a page in it."""
    with browser_of_tests.browser() as started:
        yield started
