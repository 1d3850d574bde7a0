"""What is kept of a traced equation between processes, so that a warm process compiles and traces nothing.

Tracing runs an equation on symbols in Python, which can take half a second. The result depends on the function, on the
values that it uses, and on the sources of this distribution. Their hash is the key of a file in the cache of compiled
code. The file has the hash of the C source, by which the library is found, and the sizes of the results.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import partial
from types import FunctionType, MethodType
from typing import Any, NamedTuple

import numpy as np

from auv_gym.codegen.cache import cache_folders, mark_used, open_own, own_folder
from auv_gym.installation import ROOT

PACKAGES = ("auv_gym", "baselines")
"""Packages of this distribution. Their equations depend on nothing outside of them, except on their arguments."""
_SOURCES = (".py", ".json", ".toml")
"""Suffixes of files from which numbers can enter equations."""
_PLAIN = (type(None), bool, int, float, str, bytes, np.generic)


class Trace(NamedTuple):
    """What is kept of a traced equation."""

    digest: str  # SHA-256 of the C source
    rows: dict[str, int]  # number of rows of each array: the arguments, then the other results
    written: list[str]  # names of the results


class _UnknownError(Exception):
    """A value cannot be identified in another process."""


def _sources() -> str:
    """Return the hash of the source files of `PACKAGES`."""
    digest = hashlib.sha256(f"{platform.python_version()} {np.__version__}".encode())
    for file in sorted(file for package in PACKAGES for file in (ROOT / package).rglob("*.*")):
        if file.suffix in _SOURCES:
            digest.update(file.relative_to(ROOT).as_posix().encode() + file.read_bytes())
    return digest.hexdigest()


_AT_IMPORT = _sources()


def trace_key(*parts: Any) -> str:
    """Return the key of an equation and its arguments; "" if a part of them cannot be identified in another process.

    Parts are functions and classes of `PACKAGES`, numbers, strings, arrays, and containers and dataclasses of them.
    """
    try:
        return hashlib.sha256(f"{_AT_IMPORT} {_identified(parts)}".encode()).hexdigest()[:32]
    except _UnknownError:
        return ""


def _identified(value: Any) -> str:
    """Return a text that identifies a value in every process; raise `_UnknownError` if there is none."""
    if isinstance(value, _PLAIN):
        return f"{type(value).__name__}:{value!r}"
    if isinstance(value, np.ndarray):
        return f"{value.dtype}{value.shape}:{hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, (tuple, list)):
        return f"{_named(type(value))}({','.join(map(_identified, value))})"
    if isinstance(value, (frozenset, set)):
        return f"{{{','.join(sorted(map(_identified, value)))}}}"
    if isinstance(value, Mapping):
        return f"{{{','.join(f'{_identified(key)}={_identified(x)}' for key, x in value.items())}}}"
    if isinstance(value, type):
        return _named(value)
    if isinstance(value, partial):
        return _identified((value.func, value.args, value.keywords))
    if isinstance(value, MethodType):
        return f"{_identified(value.__func__)} of {_identified(value.__self__)}"
    if isinstance(value, FunctionType):
        if "<" not in value.__qualname__:  # a function of a module or a class, which its source defines
            return _named(value)
        code, cells = value.__code__, [cell.cell_contents for cell in value.__closure__ or ()]
        where = f"{code.co_firstlineno} {code.co_code.hex()} {code.co_names}"  # distinguishes lambdas
        return f"{_named(value)} {where} {_identified((cells, value.__defaults__, value.__kwdefaults__))}"
    if is_dataclass(value):
        entries = (f"{f.name}={_identified(getattr(value, f.name))}" for f in fields(value))
        return f"{_named(type(value))}({','.join(entries)})"
    raise _UnknownError


def _named(item: Any) -> str:
    if item.__module__.partition(".")[0] not in (*PACKAGES, "builtins"):
        raise _UnknownError
    return f"{item.__module__}.{item.__qualname__}"


def read_trace(key: str) -> Trace | None:
    """Return what is kept of the equation of a key; None if there is nothing."""
    for folder in cache_folders():
        file = folder / f"{key}.json"
        with suppress(OSError, ValueError, TypeError), open_own(file) as stream:
            mark_used(file)
            return Trace(**json.load(stream))
    return None


def write_trace(key: str, trace: Trace) -> None:
    """Keep a trace for other processes, if the sources have not changed since they were imported."""
    if not key or _sources() != _AT_IMPORT:
        return
    file = next(cache_folders()) / f"{key}.json"
    temporary = file.with_suffix(f".{os.getpid()}")
    with suppress(OSError):
        own_folder(file.parent)
        temporary.write_text(json.dumps(trace._asdict()), encoding="ascii")
        temporary.chmod(0o644)
        temporary.replace(file)
