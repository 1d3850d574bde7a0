"""Atomic writing of files, reading of CSV and JSON files, and the versions of the libraries."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import platform
from contextlib import suppress
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import scipy

import auv_gym
from auv_gym.scenarios.records import guarded

DATA_FOLDERS = [Path(__file__).parents[1] / "evaluation" / "data"]
"""Folders with frozen suites and recorded results: that of the package; `import research` adds that of a checkout."""


def data_files(name: str) -> list[Path]:
    """Return the existing files of this name in `DATA_FOLDERS`."""
    return [file for folder in DATA_FOLDERS if (file := folder / name).exists()]


def read_bytes(file: Path) -> bytes:
    """Return the content of a file.

    Raises:
        OSError: it cannot be read.
        ValueError: it is no regular file (a pipe or device may have no end).
    """
    if file.exists() and not file.is_file():
        raise ValueError(f"{file} is no regular file")
    return file.read_bytes()


def read_text(file: Path) -> str:
    """Return the text of a UTF-8 file; raises as `read_bytes`, and ValueError for a text that is not UTF-8."""
    data = read_bytes(file)
    with guarded(f"{file} is no UTF-8 text"):
        return data.decode()


def read_json(file: Path) -> Any:
    """Return the value in a JSON file; raises as `read_bytes`, and ValueError with the file's name for other text."""
    data = read_bytes(file)
    with guarded(f"{file} is not valid JSON"):
        return json.loads(data)


def read_csv(file: Path) -> list[dict[str, str]]:
    """Return the rows of a CSV file with one line of headings, without empty entries; raises as `read_json`."""
    text, rows = read_text(file), []
    with guarded(f"{file} is not valid CSV"):
        for row in csv.DictReader(io.StringIO(text), restkey="", strict=True):
            if "" in row:
                raise ValueError("a row is longer than the line of headings")
            rows.append({name: entry for name, entry in row.items() if entry})
    return rows


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
