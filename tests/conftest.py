"""Shared by all tests: one thread per process, since oversubscribed cores run many times slower; and no window."""

import importlib.util
import os
import re
import signal
from pathlib import Path

import pytest
from hypothesis import settings

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")
os.environ.setdefault("MPLBACKEND", "Agg")
for variable in ("SDL_AUDIODRIVER", "SDL_VIDEODRIVER"):
    os.environ.setdefault(variable, "dummy")

OPTIONAL = ("casadi", "distributed", "onnxruntime", "playwright", "pygame", "stable_baselines3", "torch")
"""Libraries of extras: tests that import one are left out where it is not installed, as with the oldest versions."""
MISSING = [name for name in OPTIONAL if importlib.util.find_spec(name) is None]
IMPORTS_MISSING = re.compile(rf"^(?:import|from) (?:{'|'.join(MISSING) or '(?!)'})\b", re.MULTILINE)
collect_ignore = [
    str(file)
    for file in Path(__file__).parent.rglob("test_*.py")
    if IMPORTS_MISSING.search(file.read_text(encoding="utf-8"))
]

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in the background of a shell; processes inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)


# The same examples in each run. The nightly workflow tries more and other ones, with --hypothesis-profile=thorough.
settings.register_profile("quick", derandomize=True, database=None, deadline=None)
settings.register_profile("thorough", max_examples=1000, deadline=None, print_blob=True)
settings.load_profile("quick")


@pytest.fixture(scope="session")
def browser():
    """A headless browser, started once a worker; `browser.opened` opens a page in it."""
    import browser as browser_of_tests

    with browser_of_tests.browser() as started:
        yield started


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """An empty cache of compiled code."""
    from native_cache import forget

    from auv_gym.codegen import native

    monkeypatch.setenv(native.CACHE, str(tmp_path / "cache"))
    monkeypatch.delenv(native.SWITCH, raising=False)
    forget()
    yield tmp_path / "cache"
    forget()
