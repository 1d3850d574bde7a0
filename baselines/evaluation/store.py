"""Files of results: a JSON record and arrays in one .npz file, written atomically and checked when read."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.scenarios.records import guarded
from baselines.tools.files import LARGEST_FILE, LARGEST_JSON, checked_plain, read_bytes, write_atomically

_LARGEST_CONTENT = 2**27  # [bytes] largest uncompressed size of a file
_PIECE = 2**12  # [bytes] that are unpacked at once, since LZMA gives their size only afterwards
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA)
_RECORD = "record"
"""Name of the array with the JSON text."""


@dataclass(frozen=True)
class Stored:
    """The content of a file."""

    record: Mapping[str, Any]
    arrays: Mapping[str, NDArray[Any]]


def write(file: Path, stored: Stored) -> None:
    """Write a file atomically.

    Raises:
        OSError: it cannot be written.
    """
    buffer = io.BytesIO()
    arrays: dict[str, Any] = {**stored.arrays, _RECORD: np.array(json.dumps(stored.record))}
    # The same as `numpy.savez_compressed`, but with LZMA, which saves a fifth; `numpy.load` reads both.
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_LZMA) as archive:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asanyarray(array), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), content.getvalue(), zipfile.ZIP_LZMA)
    write_atomically(file, buffer.getvalue())


@contextmanager
def reading(file: Path, largest: int = LARGEST_FILE, content: int | None = None) -> Iterator[Stored]:
    """Read a file for a `with` block; an exception in the block means that the file is damaged.

    Args:
        file: the file.
        largest: largest size of the file [bytes].
        content: largest uncompressed size [bytes]; None: `_LARGEST_CONTENT`.

    Raises:
        OSError: it cannot be read.
        ValueError: it is too large or damaged, or the block raised an exception.
    """
    with guarded(f"{file} is damaged"):
        yield _read(file, largest, _LARGEST_CONTENT if content is None else content)


def _read(file: Path, largest: int, content: int) -> Stored:
    data = read_bytes(file, largest)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = archive.infolist()
        if sum(entry.file_size for entry in entries) > content:
            raise ValueError(f"it is larger than {content} bytes unpacked")
        if any(entry.compress_type not in _METHODS for entry in entries):
            raise ValueError("it is not compressed by deflate or LZMA")
        found = {entry.filename.removesuffix(".npy"): _array(archive, entry) for entry in entries}
    if len(text := str(found.pop(_RECORD))) > LARGEST_JSON:
        raise ValueError(f"its record is longer than {LARGEST_JSON} characters")
    record = checked_plain(json.loads(text))
    if not isinstance(record, dict):
        raise ValueError("its record is no table")
    return Stored(record, found)


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(entry) as stream:
        content = io.BytesIO(b"".join(iter(lambda: stream.read(_PIECE), b"")))
    array: NDArray[Any] = np.lib.format.read_array(content, allow_pickle=False)
    return array
