"""Files that are whole or absent, one guard for all that is read, and the versions that files name."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import platform
import stat
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import scipy

import auv_gym
from auv_gym.scenarios.records import guarded

LARGEST_FILE = 2**26
"""Largest file [bytes] that is read."""
_LARGEST_JSON = 2**22
"""Largest JSON file [bytes]: what it holds takes some 20 times its size in memory."""
_LARGEST_YAML = 2**16
"""Largest YAML file [bytes]: its parser takes 50 microseconds a byte."""
DEEPEST = 50
"""Most lists and tables inside of one another."""
LARGEST_TREE = 2**20
"""Most entries of a file, aliases counted as often as they are used."""
LARGEST_INTEGER = 2**1000
"""Magnitude of an integer that a float can still hold."""


def read_bytes(file: Path, largest: int = LARGEST_FILE) -> bytes:
    """Return what is in a file of at most `largest` bytes.

    Raises:
        OSError: it cannot be read.
        ValueError: it is larger, or no regular file: a pipe or device may have no end.
    """
    if not stat.S_ISREG(file.stat().st_mode):
        raise ValueError(f"{file} is no regular file")
    with file.open("rb") as stream:
        data = stream.read(largest + 1)
    if len(data) > largest:
        raise ValueError(f"{file} is larger than {largest} bytes")
    return data


def read_text(file: Path, largest: int = LARGEST_FILE) -> str:
    """Return the text of a UTF-8 file; raises as `read_bytes`, and ValueError where it is no such text."""
    data = read_bytes(file, largest)
    with guarded(f"{file} is no UTF-8 text"):
        return data.decode()


def read_json(file: Path) -> Any:
    """Return the value that a JSON file holds.

    Raises:
        OSError: it cannot be read.
        ValueError: it is no JSON, or not one that `checked_plain` takes; the message names the file.
    """
    data = read_bytes(file, _LARGEST_JSON)
    with guarded(f"{file} is not valid JSON"):
        return checked_plain(json.loads(data))


def read_csv(file: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file with one line of headings, empty entries left out; raises as `read_json`."""
    text = read_text(file)
    with guarded(f"{file} is not valid CSV"):
        rows = list(csv.DictReader(io.StringIO(text), restkey="", strict=True))
        if any("" in row for row in rows):
            raise ValueError("a row is longer than the line of headings")
        return [{name: entry for name, entry in row.items() if entry} for row in rows]


def read_yaml(file: Path) -> Any:
    """Return the value that a YAML file holds; raises as `read_json`."""
    text = read_text(file, _LARGEST_YAML)
    with guarded(f"{file} is not valid YAML"):
        return parse_yaml(text)


def parse_yaml(text: str) -> Any:
    """Return the value of a YAML text.

    Raises:
        ValueError: it is no YAML, or not one that `checked_plain` takes, or its aliases make it too large.
    """
    import yaml

    with guarded("YAML"):
        loader = yaml.SafeLoader(text)
        if (node := loader.get_single_node()) is None:
            return None
        _weigh(node, {})
        return checked_plain(loader.construct_document(node))


def _weigh(node: Any, known: dict[int, float]) -> float:
    """Return how many entries a YAML node has once its aliases are written out, before anything is written out."""
    if id(node) not in known:
        known[id(node)] = math.inf  # what it has if it is inside of itself
        children = node.value if isinstance(node.value, list) else []
        pairs = (child if isinstance(child, tuple) else (child,) for child in children)
        known[id(node)] = 1 + sum(_weigh(child, known) for pair in pairs for child in pair)
    if known[id(node)] > LARGEST_TREE:
        raise ValueError(f"its aliases make it larger than {LARGEST_TREE} entries")
    return known[id(node)]


def checked_plain(value: Any) -> Any:
    """Return a value that is made of tables, lists, numbers, strings and nothing else.

    Raises:
        ValueError: it is not; or it is nested deeper than `DEEPEST`, has more than `LARGEST_TREE` entries, an integer
            beyond `LARGEST_INTEGER`, or text that UTF-8 cannot hold.
    """
    left, count = [(value, 0)], 0
    while left:
        entry, depth = left.pop()
        count += 1
        if depth > DEEPEST or count > LARGEST_TREE:
            raise ValueError(f"it is nested deeper than {DEEPEST} or has more than {LARGEST_TREE} entries")
        if isinstance(entry, Mapping):
            left += [(x, depth + 1) for pair in entry.items() for x in pair]
        elif isinstance(entry, list):
            left += [(x, depth + 1) for x in entry]
        elif isinstance(entry, str):
            entry.encode()
        elif isinstance(entry, int) and abs(entry) > LARGEST_INTEGER:
            raise ValueError(f"it holds an integer of {entry.bit_length()} bits")
        elif not isinstance(entry, (int, float, type(None))):
            raise ValueError(f"it holds {entry!r}, which is no number, text, list or table")
    return value


def write_atomically(file: Path, content: str | bytes) -> None:
    """Write a file so that no reader ever sees half of it, whatever is killed or loses its power in between."""
    temporary = file.with_name(f".{file.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as stream:
            stream.write(content.encode(errors="backslashreplace") if isinstance(content, str) else content)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.replace(file)
        synchronise(file.parent)
    finally:
        temporary.unlink(missing_ok=True)


def synchronise(folder: Path) -> None:
    """Make what has been renamed in a folder last, where the system lets a folder be opened."""
    with suppress(PermissionError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def json_text(record: Any) -> str:
    """Return strict JSON, null for every number that is not finite."""
    return json.dumps(finite(record), indent=2, allow_nan=False) + "\n"


def finite(value: Any) -> Any:
    """Return the value with None for every number in it that is not finite."""
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def versions() -> dict[str, str]:
    """Return the versions of what the numbers depend on."""
    return {
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "gymnasium": gymnasium.__version__,
        "auv_gym": auv_gym.__version__,
    }
