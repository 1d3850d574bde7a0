"""Compile C sources once, with a compiler of the machine, into a cache.

A library is loaded by its absolute path, and only from a folder to which no other user can write, see `cache`.
"""

from __future__ import annotations

import ctypes
import hashlib
import logging
import multiprocessing
import os
import platform
import shlex
import shutil
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from auv_gym.codegen.cache import BUILD, cache_folders, mark_used, open_own, own_folder, remove_unused
from auv_gym.codegen.cache import CACHE as CACHE  # noqa: PLC0414, exported by this module

logger = logging.getLogger(__name__)

SWITCH = "AUV_GYM_NATIVE"
"""Environment variable that turns compiled code off if it is 0."""
COMPILERS = ("gcc", "clang", "cc")  # tried in this order, after that of the environment variable CC
_FLAGS = ("-std=c99", "-fPIC", "-shared")
"""Flags that every supported compiler accepts."""
_EXACT = ("-ffp-contract=off", "-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros")
"""Flags for the bits of the results: a product and a sum are rounded separately, and nan stays nan."""
_ONE = ("-Og",)
"""Flags for one vehicle: gcc takes two thirds of the time of -O1, and the code is 3 % slower."""
_MANY = ("-O1", "-fopenmp-simd")
"""Flags for several vehicles at once. The compilation takes three times the time.

-O2 takes twice the time of -O1 and makes the code no faster: the equations have no branches, and the loops over
vehicles are marked as parallel."""
TUNING_FLAGS = ("-march=native", "-fno-ivopts")
"""Flags for this processor, and without a slow search for loop counters by gcc; left out if a compiler refuses them."""
_PATIENCE = 60.0
"""Time limit of a compiler [s] for a short source."""
_SLOWEST = 200.0
"""Speed of a compiler on a busy machine [characters/s], for the time limit of a longer source."""
_TRIAL = "#include <math.h>\n#include <stdint.h>\ndouble auv_trial(double x) { return floor(x); }\n"
"""Source that a compiler must be able to build before it is used."""
_SYSCTL = "/usr/sbin/sysctl"  # prints the name of the processor on macOS
_PROCESSOR = ("model name", "flags", "features", "facilities", "cpu", "isa", "uarch", "cpu implementer", "cpu part")
"""Entries of /proc/cpuinfo that identify the instruction set on x86, Arm, s390, POWER and RISC-V."""
_PYTHON = "so equations run as Python, several times slower"
"""Consequence if no code can be compiled."""
_AGAIN = "so each process compiles again, which takes seconds"
"""Consequence if compiled code cannot be kept."""
_refused: dict[Path, str] = {}
"""Folders in which no library could be built and loaded, with the reasons."""
_logged: set[str] = set()
"""Consequences that were logged already."""


def wanted() -> bool:
    """Return whether compiled code may be used."""
    return os.environ.get(SWITCH, "1") != "0"


@cache
def compiler() -> tuple[str, str] | None:
    """Return command and version of the first C compiler that works; log a warning and return None if none does.

    The environment variable CC may hold a path, or a command of several words, such as "ccache gcc".
    """
    reasons: list[str] = []
    for name in filter(None, (os.environ.get("CC"), *COMPILERS)):
        try:
            program, *words = [name] if shutil.which(name) else shlex.split(name)
            if (path := shutil.which(program)) is None:
                raise ValueError("the program does not exist")
            command = shlex.join([path, *words])
            version = _run([path, *words, "--version"]).decode(errors="replace")
        except (OSError, ValueError, subprocess.SubprocessError) as error:
            reason = f"{name}: {_reason(error)}"
        else:
            trial, reason = _library(command, version, _TRIAL, lambda: _TRIAL, (*_FLAGS, *_EXACT, *TUNING_FLAGS))
            if trial is not None:
                return command, version
        logger.info("this compiler does not work: %s", reason)
        reasons.append(reason)
    _warn(f"there is no C compiler that works ({reasons[0]})", f"{_PYTHON}: install gcc or clang")
    return None


def _warn(problem: str, consequence: str) -> None:
    """Log a problem, once for each consequence, and not in worker processes."""
    if consequence not in _logged and multiprocessing.parent_process() is None:
        _logged.add(consequence)
        logger.warning("auv_gym: %s, %s", problem, consequence)


def has_compiler() -> bool:
    """Return whether code can be compiled."""
    return wanted() and compiler() is not None


def library(digest: str, source: Callable[[], str], *, many: bool = True) -> ctypes.CDLL | None:
    """Return the library of a C source, from the cache if possible; None if it cannot be compiled.

    Args:
        digest: a hash that identifies the source.
        source: returns the source; called only if it must be compiled.
        many: for several vehicles at once. Without it the compilation takes a fraction of the time, and the code is as
            fast for one vehicle.
    """
    if not wanted() or (program := compiler()) is None:
        return None
    key = digest, many
    if key not in _libraries:
        flags = (*_FLAGS, *_EXACT, *TUNING_FLAGS, *(_MANY if many else _ONE))
        _libraries[key], reason = _library(*program, digest, source, flags)
        if reason:
            _warn(reason, _PYTHON if _libraries[key] is None else _AGAIN)
    return _libraries[key]


_libraries: dict[tuple[str, bool], ctypes.CDLL | None] = {}
"""The libraries of this process by digest, and by whether they are for several vehicles; None: not compiled."""


def _library(
    command: str, version: str, identity: str, source: Callable[[], str], flags: tuple[str, ...]
) -> tuple[ctypes.CDLL | None, str]:
    """Return the library of a source, or None; and the reason why the first folder could not be used, or ""."""
    machine = platform.machine(), sys.platform, _processor(), str(struct.calcsize("P"))
    digest = hashlib.sha256("\0".join((identity, command, version, *flags, *machine)).encode()).hexdigest()[:32]
    reasons: list[str] = []
    for folder in cache_folders():
        file = folder / f"{digest}.so"
        with suppress(OSError), open_own(file):
            made = ctypes.CDLL(str(file))
            mark_used(file)
            return made, "".join(reasons[:1])
        try:
            if folder not in _refused:
                if identity != _TRIAL and not _refused:
                    _announce()
                return _built(command, source(), file, flags), "".join(reasons[:1])
        except subprocess.SubprocessError as error:  # no matter of the folder
            return None, f"{command}: {_reason(error)}"
        except OSError as error:
            _refused[folder] = f"compiled code cannot be kept in {folder}: {_reason(error)}"
        if folder in _refused:
            reasons.append(_refused[folder])
    return None, "".join(reasons[:1]) or "there is no folder for compiled code"


@cache
def _processor() -> str:
    """Return a text that differs between processors with different instruction sets."""
    if sys.platform == "darwin":
        with suppress(OSError, subprocess.SubprocessError):
            return _run([_SYSCTL, "-n", "machdep.cpu.brand_string"]).decode(errors="replace")
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.processor()
    return "\n".join(sorted({line for line in lines if line.partition(":")[0].strip().lower() in _PROCESSOR}))


@cache
def _announce() -> None:
    """Print why the first use on a machine takes longer."""
    print(
        "auv_gym: compiling equations for this machine, once for each kind of scenario and policy",
        file=sys.stderr,
        flush=True,
    )


def _built(command: str, source: str, file: Path, flags: tuple[str, ...]) -> ctypes.CDLL:
    """Build a library, load it, then move its file into place; concurrent builds leave one complete file.

    Raises:
        OSError: it cannot be written or loaded.
        SubprocessError: the compiler fails.
    """
    remove_unused(own_folder(file.parent))
    # Windows removes no library that is loaded.
    with tempfile.TemporaryDirectory(prefix=BUILD, dir=file.parent, ignore_cleanup_errors=True) as folder:
        made = Path(folder) / file.name
        try:
            _compile(command, source, made, flags)
        except subprocess.CalledProcessError:
            _compile(command, source, made, tuple(flag for flag in flags if flag not in TUNING_FLAGS))
        made.chmod(0o755)  # not writable by other users, whatever the umask
        library = ctypes.CDLL(str(made))
        try:
            made.replace(file)
        except PermissionError:
            if sys.platform != "win32" or not file.exists():  # Windows replaces no library that another process uses
                raise
    return library


def _compile(command: str, source: str, made: Path, flags: tuple[str, ...]) -> None:
    words = [*shlex.split(command), *flags, "-x", "c", "-", "-o", str(made), "-lm"]
    _run(words, source, env={**os.environ, "TMPDIR": str(made.parent)})


def _run(words: list[str], source: str = "", **options: Any) -> bytes:
    """Return the output of a program that reads a source.

    Raises:
        OSError: it cannot be started.
        SubprocessError: it fails, or exceeds the time limit for the source.
    """
    patience = _PATIENCE + len(source) / _SLOWEST
    done = subprocess.run(words, input=source.encode(), capture_output=True, check=True, timeout=patience, **options)
    output: bytes = done.stdout
    return output


def _reason(error: Exception) -> str:
    """Return the message of an error in one line."""
    if isinstance(error, subprocess.TimeoutExpired):
        return f"it exceeds {error.timeout:.0f} s"
    output = (getattr(error, "stderr", None) or b"").decode(errors="replace").strip()
    return output.splitlines()[0] if output else getattr(error, "strerror", None) or str(error)
