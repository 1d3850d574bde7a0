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
import signal
import struct
import subprocess
import sys
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

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
TUNED = ("-march=native", "-fno-ivopts")
"""Flags for this processor, and without a slow search for loop counters by gcc; left out if a compiler refuses them."""
_PATIENCE = 60.0
"""Time limit of a compiler [s]. A compiler that exceeds it is not used again."""
_TRIAL = "#include <math.h>\n#include <stdint.h>\ndouble auv_trial(double x) { return floor(x); }\n"
"""Source that a compiler must be able to build before it is used."""
_SYSCTL = "/usr/sbin/sysctl"  # prints the name of the processor on macOS
_PYTHON = "so equations run as Python, several times slower"
"""Consequence if no code can be compiled."""
_AGAIN = "so each process compiles again, which takes seconds"
"""Consequence if compiled code cannot be kept."""
_hung: set[str] = set()
"""Programs that have exceeded `_PATIENCE`."""
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
            made, reason = _library(command, version, _TRIAL, (*_FLAGS, *_EXACT, *TUNED))
            if made is not None:
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


@cache
def library(source: str, *, many: bool = True) -> ctypes.CDLL | None:
    """Return the library of a C source, from the cache if possible; None if it cannot be compiled.

    Without `many` the compilation takes a fraction of the time, and the code is as fast for one vehicle.
    """
    if not wanted() or (found := compiler()) is None:
        return None
    made, reason = _library(*found, source, (*_FLAGS, *_EXACT, *TUNED, *(_MANY if many else _ONE)))
    if reason:
        _warn(reason, _PYTHON if made is None else _AGAIN)
    return made


def _library(command: str, version: str, source: str, flags: tuple[str, ...]) -> tuple[ctypes.CDLL | None, str]:
    """Return the library of a source, or None; and the reason why the first folder could not be used, or ""."""
    build = (command, version, *flags, platform.machine(), sys.platform, _processor())
    key = "\0".join((source, *build, str(struct.calcsize("P"))))
    digest, reasons = hashlib.sha256(key.encode()).hexdigest()[:32], list[str]()
    mark = f"auv_gym_{digest}"  # a symbol that identifies the library of this source
    for folder in cache_folders():
        file = folder / f"{digest}.so"
        with suppress(OSError, AttributeError), open_own(file):
            made = _loaded(file, mark)
            mark_used(file)
            return made, "".join(reasons[:1])
        try:
            if folder not in _refused:
                if source != _TRIAL and not _refused:
                    _announce()
                made = _built(command, f"{source}\nint {mark}(void) {{ return 1; }}\n", file, mark, flags)
                return made, "".join(reasons[:1])
        except subprocess.SubprocessError as error:
            reasons.append(f"{command}: {_reason(error)}")
        except (OSError, AttributeError) as error:
            _refused[folder] = f"compiled code cannot be kept in {folder}: {_reason(error)}"
        if folder in _refused:
            reasons.append(_refused[folder])
    return None, "".join(reasons[:1]) or "there is no folder for compiled code"


def _loaded(file: Path, mark: str) -> ctypes.CDLL:
    """Return the library of a file.

    Raises:
        OSError: it cannot be loaded.
        AttributeError: it does not have the symbol `mark`.
    """
    made = ctypes.CDLL(str(file))
    made[mark]
    return made


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


_PROCESSOR = ("model name", "flags", "features", "facilities", "cpu", "isa", "uarch", "cpu implementer", "cpu part")
"""Entries of /proc/cpuinfo that identify the instruction set on x86, Arm, s390, POWER and RISC-V."""


@cache
def _announce() -> None:
    """Print why the first use on a machine takes longer."""
    print(
        "auv_gym: compiling equations for this machine, once for each kind of scenario and policy",
        file=sys.stderr,
        flush=True,
    )


def _built(command: str, source: str, file: Path, mark: str, flags: tuple[str, ...]) -> ctypes.CDLL:
    """Build a library, load it, then move its file into place; concurrent builds leave one complete file.

    Raises:
        OSError: it cannot be written or loaded.
        AttributeError: it does not have the symbol `mark`.
        SubprocessError: the compiler fails.
    """
    remove_unused(own_folder(file.parent))
    # Windows removes no library that is loaded.
    with tempfile.TemporaryDirectory(prefix=BUILD, dir=file.parent, ignore_cleanup_errors=True) as folder:
        made = Path(folder) / file.name
        try:
            _compile(command, source, made, flags)
        except subprocess.CalledProcessError:
            _compile(command, source, made, tuple(flag for flag in flags if flag not in TUNED))
        made.chmod(0o755)  # not writable by other users, whatever the umask
        found = _loaded(made, mark)
        try:
            made.replace(file)
        except PermissionError:
            if sys.platform != "win32" or not file.exists():  # Windows replaces no library that another process uses
                raise
    return found


def _compile(command: str, source: str, made: Path, flags: tuple[str, ...]) -> None:
    _run([*shlex.split(command), *flags, "-x", "c", "-", "-o", str(made), "-lm"], source, made.parent)


def _run(words: list[str], given: str = "", folder: Path | None = None) -> bytes:
    """Return the output of a program; kill it and its child processes if it exceeds the time limit.

    Args:
        words: the command.
        given: its standard input.
        folder: for its temporary files.

    Raises:
        OSError: it cannot be started.
        SubprocessError: it fails, or has exceeded `_PATIENCE`, now or in an earlier call.
    """
    if (program := os.path.realpath(words[0])) in _hung:
        raise subprocess.TimeoutExpired(words, _PATIENCE)
    pipe, more = subprocess.PIPE, {} if folder is None else {"TMPDIR": str(folder)}
    with subprocess.Popen(
        words, stdin=pipe, stdout=pipe, stderr=pipe, start_new_session=True, env={**os.environ, **more}
    ) as process:
        try:
            out, errors = process.communicate(given.encode(), _PATIENCE)
        except BaseException as error:
            if isinstance(error, subprocess.TimeoutExpired):
                _hung.add(program)
            with suppress(OSError):
                if sys.platform == "win32":
                    process.kill()
                else:
                    os.killpg(process.pid, signal.SIGKILL)
            raise
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, words, out, errors)
    return out


def _reason(error: Exception) -> str:
    """Return the message of an error in one line."""
    if isinstance(error, subprocess.TimeoutExpired):
        return f"it exceeds {_PATIENCE:g} s"
    output = (getattr(error, "stderr", None) or b"").decode(errors="replace").strip()
    return output.splitlines()[0] if output else getattr(error, "strerror", None) or str(error)
