"""Shared by all tests: one thread per process, since oversubscribed cores run many times slower."""

import os
import signal

import browser as browser_of_tests
import pytest

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in the background of a shell; processes inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def browser():
    """A headless browser, started once a worker; `browser.opened` opens a page in it."""
    with browser_of_tests.browser() as started:
        yield started
