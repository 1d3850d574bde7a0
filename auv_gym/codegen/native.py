"""C sources compiled by whatever compiler the machine has, once, into a cache; without one, only speed is lost."""

from __future__ import annotations

import ctypes
import hashlib
import logging
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

logger = logging.getLogger(__name__)

SWITCH = "AUV_GYM_NATIVE"
"""Environment variable that turns compiled code off where it is 0."""
CACHE = "AUV_GYM_CACHE"
"""Environment variable that names another folder for compiled code than that of the user's caches."""
COMPILERS = ("gcc", "clang", "cc")  # looked for in this order, behind that of the environment variable CC
_FLAGS = ("-O1", "-std=c99", "-fPIC", "-shared")
"""What every compiler that is used here knows."""
_EXACT = ("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros")
"""A product and a sum are rounded one after the other, as everywhere else; what is not a number stays none."""
_SIMD = ("-fopenmp-simd",)
"""For several vehicles at once, which takes twice the time."""
TUNED = ("-march=native", "-fno-ivopts")
"""For this processor; and gcc shall not search for the cheapest counters of long loops. More optimisation than -O1
takes twice the time and makes the code no faster: the equations are straight lines, and the loops over vehicles are
marked as parallel. All left out where a compiler does not know them."""
_PATIENCE = 300.0
"""Seconds that a compiler may take."""


def wanted() -> bool:
    """Return whether compiled code may be used."""
    return os.environ.get(SWITCH, "1") != "0"


@cache
def compiler() -> tuple[str, str] | None:
    """Return path and version of the first C compiler that answers; None if none does, which is logged."""
    for name in filter(None, (os.environ.get("CC"), *COMPILERS)):
        if (path := shutil.which(name)) is not None:
            try:
                done = subprocess.run([path, "--version"], capture_output=True, timeout=_PATIENCE, check=True)
            except (OSError, subprocess.SubprocessError):
                continue
            return path, done.stdout.decode(errors="replace")
    logger.info(
        "no C compiler works here, so equations run as Python; gcc or clang would make them several times faster"
    )
    return None


@cache
def library(source: str, *, many: bool = True) -> ctypes.CDLL | None:
    """Return the library of a C source, from the cache if it is there; None where it cannot be made.

    Without `many` it is compiled in a fraction of the time, and is as fast for one vehicle.
    """
    if not wanted() or (found := compiler()) is None:
        return None
    path, version = found
    flags = (*_FLAGS, *_EXACT, *TUNED, *(_SIMD if many else ()))
    key = "\0".join((source, path, version, *flags, platform.machine(), sys.platform, _processor()))
    name = f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.so"
    for folder in cache_folders():
        if (made := _loaded(path, source, folder / name, flags)) is not None:
            return made
    return None


def _loaded(path: str, source: str, file: Path, flags: tuple[str, ...]) -> ctypes.CDLL | None:
    """Return the library that a file holds or shall hold; None, which is logged, where that cannot be."""
    try:
        try:
            return ctypes.CDLL(str(_built(path, source, file, flags)))
        except OSError:
            file.unlink()  # damaged, else this is the error to report
            return ctypes.CDLL(str(_built(path, source, file, flags)))
    except subprocess.SubprocessError as error:
        logger.info("%s cannot compile the equations, so they run as Python: %s", path, _reason(error))
    except OSError as error:
        logger.info("compiled code cannot be kept in %s: %s", file.parent, error)
    return None


@cache
def _processor() -> str:
    """Return what tells processors with other instructions apart."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.processor()
    return "\n".join(sorted({line for line in lines if line.startswith(("flags", "Features", "model name"))}))


def cache_folders() -> Iterator[Path]:
    """Yield the folders where what is made once may be kept: the cache, else one that ends with the process."""
    if CACHE in os.environ:
        yield Path(os.environ[CACHE])
    elif "XDG_CACHE_HOME" in os.environ:
        yield Path(os.environ["XDG_CACHE_HOME"]) / "auv_gym"
    else:
        with suppress(RuntimeError):  # there is no home
            yield Path.home() / ".cache" / "auv_gym"
    yield _temporary()


@cache
def _temporary() -> Path:
    """Return a new folder that nobody else can write to; it is removed at the end of the process."""
    folder = tempfile.TemporaryDirectory(prefix="auv_gym-")
    _kept.append(folder)
    return Path(folder.name)


_kept: list[tempfile.TemporaryDirectory[str]] = []


def _built(path: str, source: str, file: Path, flags: tuple[str, ...]) -> Path:
    """Return a library's file, compiled if it is not there; two processes at once leave one whole file."""
    if file.exists():
        return file
    _announce()
    file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    with tempfile.TemporaryDirectory(dir=file.parent) as folder:
        made = Path(folder) / file.name
        try:
            _compile(path, source, made, flags)
        except subprocess.CalledProcessError:
            _compile(path, source, made, tuple(flag for flag in flags if flag not in TUNED))
        made.replace(file)
    return file


@cache
def _announce() -> None:
    """Say in one line why the first use on a machine takes longer."""
    print("auv_gym: compiling the equations of motion for this machine; this happens once", file=sys.stderr, flush=True)


def _compile(path: str, source: str, made: Path, flags: tuple[str, ...]) -> None:
    command = [path, *flags, "-x", "c", "-", "-o", str(made), "-lm"]
    subprocess.run(command, input=source.encode(), capture_output=True, timeout=_PATIENCE, check=True)


def _reason(error: subprocess.SubprocessError) -> str:
    said = getattr(error, "stderr", None) or b""
    return said.decode(errors="replace").strip().splitlines()[0] if said.strip() else str(error)
