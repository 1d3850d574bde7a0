"""C sources compiled by whatever compiler the machine has, once, into a cache; without one, only speed is lost.

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

from auv_gym.codegen.cache import BUILD, cache_folders, open_own, own_folder, tidy, used
from auv_gym.codegen.cache import CACHE as CACHE  # noqa: PLC0414, part of this module for those who compile

logger = logging.getLogger(__name__)

SWITCH = "AUV_GYM_NATIVE"
"""Environment variable that turns compiled code off where it is 0."""
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
_PATIENCE = 60.0
"""Seconds that a compiler may take; one that takes longer is not asked again."""
_TRIAL = "#include <math.h>\n#include <stdint.h>\ndouble auv_trial(double x) { return floor(x); }\n"
"""Source that a compiler must be able to build before it is used."""
_SYSCTL = "/usr/sbin/sysctl"  # that names the processor on macOS
_PYTHON = "so equations run as Python, several times slower"
_AGAIN = "so each process compiles again, which takes seconds"
"""What it costs where no code can be compiled, and where it cannot be kept."""
_hung: set[str] = set()
"""Programs that have taken longer than `_PATIENCE`."""
_refused: dict[Path, str] = {}
"""Folders in which no library could be built and loaded, and why."""
_said: set[str] = set()
"""Costs that were named already."""


def wanted() -> bool:
    """Return whether compiled code may be used."""
    return os.environ.get(SWITCH, "1") != "0"


@cache
def compiler() -> tuple[str, str] | None:
    """Return command and version of the first C compiler that works; None if none does, which one line on stderr says.

    The environment variable CC may hold a command of several words, such as "ccache gcc".
    """
    reasons: list[str] = []
    for name in filter(None, (os.environ.get("CC"), *COMPILERS)):
        try:
            program, *words = shlex.split(name)
            if (path := shutil.which(program)) is None:
                raise ValueError("there is no such program")
            command = shlex.join([path, *words])
            version = _run([path, *words, "--version"]).decode(errors="replace")
        except (OSError, ValueError, subprocess.SubprocessError) as error:
            reason = f"{name}: {_reason(error)}"
        else:
            made, reason = _library(command, version, _TRIAL, (*_FLAGS, *_EXACT, *TUNED))
            if made is not None:
                return command, version
        logger.info("no code is compiled by %s", reason)
        reasons.append(reason)
    _say(f"there is no C compiler that works ({reasons[0]})", f"{_PYTHON}: install gcc or clang")
    return None


def _say(what: str, cost: str) -> None:
    """Say on stderr what has gone wrong, once for each cost, and not again in every worker process."""
    if cost not in _said and multiprocessing.parent_process() is None:
        _said.add(cost)
        logger.warning("auv_gym: %s, %s", what, cost)


@cache
def library(source: str, *, many: bool = True) -> ctypes.CDLL | None:
    """Return the library of a C source, from the cache if it is there; None where it cannot be made.

    Without `many` it is compiled in a fraction of the time, and is as fast for one vehicle.
    """
    if not wanted() or (found := compiler()) is None:
        return None
    made, reason = _library(*found, source, (*_FLAGS, *_EXACT, *TUNED, *(_SIMD if many else ())))
    if reason:
        _say(reason, _PYTHON if made is None else _AGAIN)
    return made


def _library(command: str, version: str, source: str, flags: tuple[str, ...]) -> tuple[ctypes.CDLL | None, str]:
    """Return the library of a source, None where there is none; and what stood against the first folder for it."""
    about = (command, version, *flags, platform.machine(), sys.platform, _processor())
    key = "\0".join((source, *about, str(struct.calcsize("P"))))
    digest, reasons = hashlib.sha256(key.encode()).hexdigest()[:32], list[str]()
    mark = f"auv_gym_{digest}"  # a symbol by which a library is known to be that of the source
    for folder in cache_folders():
        file = folder / f"{digest}.so"
        with suppress(OSError, AttributeError), open_own(file):
            made = _loaded(file, mark)
            used(file)
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
        AttributeError: it has no such symbol.
    """
    made = ctypes.CDLL(str(file))
    made[mark]
    return made


@cache
def _processor() -> str:
    """Return what tells processors with other instructions apart."""
    if sys.platform == "darwin":
        with suppress(OSError, subprocess.SubprocessError):
            return _run([_SYSCTL, "-n", "machdep.cpu.brand_string"]).decode(errors="replace")
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.processor()
    return "\n".join(sorted({line for line in lines if line.partition(":")[0].strip().lower() in _PROCESSOR}))


_PROCESSOR = ("model name", "flags", "features", "facilities", "cpu", "isa", "uarch", "cpu implementer", "cpu part")
"""Entries of /proc/cpuinfo that say which instructions there are: on x86, Arm, s390, POWER and RISC-V."""


@cache
def _announce() -> None:
    """Say in one line why the first use on a machine takes longer."""
    print("auv_gym: compiling the equations of motion for this machine; this happens once", file=sys.stderr, flush=True)


def _built(command: str, source: str, file: Path, mark: str, flags: tuple[str, ...]) -> ctypes.CDLL:
    """Return a new library, once it can be loaded and its file is in place; two at once leave one whole file.

    Raises:
        OSError: it cannot be written or loaded.
        AttributeError: it has no such symbol.
        SubprocessError: the compiler fails.
    """
    tidy(own_folder(file.parent))
    with tempfile.TemporaryDirectory(prefix=BUILD, dir=file.parent) as folder:
        made = Path(folder) / file.name
        try:
            _compile(command, source, made, flags)
        except subprocess.CalledProcessError:
            _compile(command, source, made, tuple(flag for flag in flags if flag not in TUNED))
        made.chmod(0o755)  # no umask lets others write
        found = _loaded(made, mark)
        made.replace(file)
    return found


def _compile(command: str, source: str, made: Path, flags: tuple[str, ...]) -> None:
    _run([*shlex.split(command), *flags, "-x", "c", "-", "-o", str(made), "-lm"], source, made.parent)


def _run(words: list[str], given: str = "", folder: Path | None = None) -> bytes:
    """Return what a program prints; one that is not done in time ends, with all that it has started.

    Args:
        words: of its command.
        given: its standard input.
        folder: for its temporary files.

    Raises:
        OSError: it cannot be started.
        SubprocessError: it fails, or takes longer than `_PATIENCE`, now or before.
    """
    if (program := os.path.realpath(words[0])) in _hung:
        raise subprocess.TimeoutExpired(words, _PATIENCE)
    pipe, more = subprocess.PIPE, {} if folder is None else {"TMPDIR": str(folder)}
    with subprocess.Popen(
        words, stdin=pipe, stdout=pipe, stderr=pipe, start_new_session=True, env={**os.environ, **more}
    ) as process:
        try:
            out, said = process.communicate(given.encode(), _PATIENCE)
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
        raise subprocess.CalledProcessError(process.returncode, words, out, said)
    return out


def _reason(error: Exception) -> str:
    """Return in a line why something went wrong."""
    if isinstance(error, subprocess.TimeoutExpired):
        return f"it is not done after {_PATIENCE:g} s"
    said = (getattr(error, "stderr", None) or b"").decode(errors="replace").strip()
    return said.splitlines()[0] if said else getattr(error, "strerror", None) or str(error)
