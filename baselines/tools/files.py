"""Atomic writing of files, checked reading of CSV, JSON and YAML, and the versions of the libraries."""

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
LARGEST_JSON = 2**22
"""Largest JSON file [bytes]: what it holds takes some 20 times its size in memory."""
_LARGEST_CSV = 2**21
"""Largest CSV file [bytes]: a row of one character becomes a table of hundreds of bytes."""
_LARGEST_YAML = 2**16
"""Largest YAML file [bytes]: its parser takes 50 microseconds a byte."""
DEEPEST = 50
"""Largest nesting depth of lists and tables."""
LARGEST_TREE = 2**20
"""Largest number of entries of a file, with YAML aliases expanded."""
LARGEST_INTEGER = 2**1000
"""Largest magnitude of an integer; a float can hold it."""


def read_bytes(file: Path, largest: int = LARGEST_FILE) -> bytes:
    """Return the content of a file of at most `largest` bytes.

    Raises:
        OSError: it cannot be read.
        ValueError: it is larger, or no regular file (a pipe or device may have no end).
    """
    if not stat.S_ISREG(file.stat().st_mode):
        raise ValueError(f"{file} is no regular file")
    with file.open("rb") as stream:
        data = stream.read(largest + 1)
    if len(data) > largest:
        raise ValueError(f"{file} is larger than {largest} bytes")
    return data


def read_text(file: Path, largest: int = LARGEST_FILE) -> str:
    """Return the text of a UTF-8 file; raises as `read_bytes`, and ValueError for a text that is not UTF-8."""
    data = read_bytes(file, largest)
    with guarded(f"{file} is no UTF-8 text"):
        return data.decode()


def read_json(file: Path) -> Any:
    """Return the value in a JSON file.

    Raises:
        OSError: it cannot be read.
        ValueError: it is no JSON, or `checked_plain` refuses it; the message has the name of the file.
    """
    data = read_bytes(file, LARGEST_JSON)
    with guarded(f"{file} is not valid JSON"):
        return checked_plain(json.loads(data))


def read_csv(file: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file with one line of headings, without empty entries; raises as `read_json`."""
    text, rows = read_text(file, _LARGEST_CSV), []
    with guarded(f"{file} is not valid CSV"):
        for row in csv.DictReader(io.StringIO(text), restkey="", strict=True):
            if "" in row:
                raise ValueError("a row is longer than the line of headings")
            rows.append({name: entry for name, entry in row.items() if entry})
    return rows


def read_yaml(file: Path) -> Any:
    """Return the value in a YAML file; raises as `read_json`."""
    text = read_text(file, _LARGEST_YAML)
    with guarded(f"{file} is not valid YAML"):
        return parse_yaml(text)


def parse_yaml(text: str) -> Any:
    """Return the value of a YAML text.

    Raises:
        ValueError: it is no YAML, `checked_plain` refuses it, or it is too large with its aliases expanded.
    """
    import yaml

    with guarded("YAML"):
        loader = yaml.SafeLoader(text)
        if (node := loader.get_single_node()) is None:
            return None
        _count_entries(node, {})
        return checked_plain(loader.construct_document(node))


def _count_entries(node: Any, known: dict[int, float]) -> float:
    """Return the number of entries of a YAML node with its aliases expanded, without expanding them.

    Raises:
        ValueError: there are more than `LARGEST_TREE`.
    """
    if id(node) not in known:
        known[id(node)] = math.inf  # the count of a node that contains itself
        children = node.value if isinstance(node.value, list) else []
        pairs = (child if isinstance(child, tuple) else (child,) for child in children)
        known[id(node)] = 1 + sum(_count_entries(child, known) for pair in pairs for child in pair)
    if known[id(node)] > LARGEST_TREE:
        raise ValueError(f"it has more than {LARGEST_TREE} entries with its aliases expanded")
    return known[id(node)]


def checked_plain(value: Any) -> Any:
    """Return the value itself if it consists of tables, lists, numbers, strings, truth values and None.

    Raises:
        ValueError: it has another type in it, is nested deeper than `DEEPEST`, has more than `LARGEST_TREE` entries, an
            integer larger than `LARGEST_INTEGER`, or text that cannot be encoded as UTF-8.
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
            raise ValueError(f"it contains an integer of {entry.bit_length()} bits")
        elif not isinstance(entry, (int, float, type(None))):
            raise ValueError(f"it contains {entry!r}, which is no number, text, list or table")
    return value


def write_atomically(file: Path, content: str | bytes) -> None:
    """Write a file atomically: after a crash or a power failure it has the old or the new content, never a part.

    Its folder is made if it does not exist.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
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
    """Write the entries of a folder to disk, so that a rename in it survives a power failure.

    It does nothing on systems that cannot open a folder.
    """
    with suppress(PermissionError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def json_text(record: Any) -> str:
    """Return a record as strict JSON, with null for every number that is not finite."""
    return json.dumps(finite(record), indent=2, allow_nan=False) + "\n"


def finite(value: Any) -> Any:
    """Return a value in which every number that is not finite is replaced by None."""
    if isinstance(value, dict):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def versions() -> dict[str, str]:
    """Return the versions of Python and of the libraries that the results depend on."""
    return {
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "gymnasium": gymnasium.__version__,
        "auv_gym": auv_gym.__version__,
    }
