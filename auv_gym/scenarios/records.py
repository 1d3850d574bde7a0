"""Conversion of frozen dataclasses to and from records, which are dicts, lists, numbers and strings."""

from __future__ import annotations

import json
import os
import sys
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import MISSING, fields, is_dataclass
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

T = TypeVar("T")


def to_record(instance: Any) -> dict[str, Any]:
    """Return a dataclass as a dict of plain values, without default values and fields that are not compared."""
    return {
        f.name: _plain(value)
        for f in fields(instance)
        if f.compare and (value := getattr(instance, f.name)) != _default(f)
    }


def _default(field: Any) -> Any:
    return field.default_factory() if field.default_factory is not MISSING else field.default


def _plain(value: Any) -> Any:
    if is_dataclass(value):
        return to_record(value)
    value = value.item() if hasattr(value, "item") else value  # a number of NumPy
    return [_plain(v) for v in value] if isinstance(value, tuple) else value


def from_record(cls: type[T], record: Any, where: str, special: Mapping[str, Callable[[Any], Any]] | None = None) -> T:
    """Return the dataclass of a record.

    Args:
        cls: the dataclass.
        record: its values by the names of the fields.
        where: name of the record in messages.
        special: functions that convert the values of some fields, also of those that are not compared.

    Raises:
        ValueError: the record is not a mapping, an entry is unknown or missing, or the dataclass raises it.
    """
    if not isinstance(record, Mapping):
        raise ValueError(f"{where} is {record!r}; it must be a table of named values")
    known = {f.name: f for f in fields(cls) if f.compare or f.name in (special or ())}  # type: ignore[arg-type]
    if unknown := [key for key in record if key not in known]:
        raise ValueError(
            f"{where} has no entry {unknown[0]!r}{meant(unknown[0], known)}; allowed are {', '.join(known)}"
        )
    required = [n for n, f in known.items() if f.default is MISSING and f.default_factory is MISSING]
    if missing := [name for name in required if name not in record]:
        raise ValueError(f"{where} lacks the entry {missing[0]!r}; required are {', '.join(required)}")
    nested, values = _nested(cls), {}  # type: ignore[arg-type]
    for name, value in record.items():
        if special and name in special:
            values[name] = special[name](value)
        elif name in nested and not isinstance(value, nested[name]):
            values[name] = None if value is None else from_record(nested[name], value, name)
        else:
            values[name] = _tupled(value)
    try:
        return cls(**values)
    except TypeError as error:  # comparison with a value of a wrong type
        raise ValueError(f"{where}: {error}") from error


@cache
def _nested(cls: Any) -> dict[str, type]:
    """Return the fields whose type is another dataclass, or a dataclass or None."""
    nested = {}
    for name, hint in typing.get_type_hints(cls).items():
        for option in typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,):
            if is_dataclass(option) and isinstance(option, type):
                nested[name] = option
    return nested


def _tupled(value: Any) -> Any:
    return tuple(_tupled(v) for v in value) if isinstance(value, (list, tuple)) else value


def meant(name: object, known: Iterable[str]) -> str:
    """Return " (did you mean ...?)" for an unknown name that is similar to a known one; else "".

    Upper case, and hyphens in place of underscores, do not matter.
    """
    alike = {one.lower().replace("_", "-"): one for one in known}
    similar = get_close_matches(str(name).lower().replace("_", "-"), alike, 1, 0.7)
    return f" (did you mean {alike[similar[0]]!r}?)" if similar else ""


@contextmanager
def guarded(what: str) -> Iterator[None]:
    """Turn every exception that a reader raises on damaged input into ValueError.

    ImportError and OSError pass unchanged; the message of an OSError has the name of the file already.

    Args:
        what: beginning of the message.

    Raises:
        ValueError: the input is damaged.
    """
    try:
        yield
    except (ImportError, OSError):
        raise
    except Exception as error:  # zlib.error, TypeError, RecursionError, MemoryError ...
        kind = "" if isinstance(error, (ValueError, Warning)) else f"{type(error).__name__}: "
        raise ValueError(f"{what}: {' '.join(f'{kind}{error}'.split())[:1000]}") from error


def table_file(name: object) -> Path | None:
    """Return the path of a .json or .toml file for its name or path; None for anything else."""
    file = Path(name) if isinstance(name, (str, os.PathLike)) else None
    return file if file is not None and file.suffix.lower() in (".json", ".toml") else None


def checked_suffix(file: Path) -> str:
    """Return the suffix of a file name in lower case; raise ValueError if it is neither .json nor .toml."""
    if table_file(file) is None:
        raise ValueError(f"file {file} ends in {file.suffix!r}; it must end in .json or .toml")
    return file.suffix.lower()


def read_table(file: Path) -> Any:
    """Return the record of a .json or .toml file.

    Raises:
        ValueError: the file is of another kind, or is not valid JSON or TOML.
        OSError: the file cannot be read.
    """
    suffix, data = checked_suffix(file), file.read_bytes()
    with guarded(f"{file} is not valid {suffix[1:].upper()}"):
        return (json if suffix == ".json" else tomllib).loads(data.decode())
