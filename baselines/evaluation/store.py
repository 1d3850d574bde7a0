"""What is measured, on disk: a record of plain JSON and arrays in one .npz file, whole or absent, checked when read."""

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
from baselines.tools.files import LARGEST_FILE, checked_plain, read_bytes, write_atomically

_LARGEST_CONTENT = 2**27  # [bytes] that a file unpacks to
_PIECE = 2**12  # [bytes] that are unpacked at once: LZMA says how large they become only afterwards
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA)
_RECORD = "record"
"""Name of the array that holds the JSON text."""


@dataclass(frozen=True)
class Stored:
    """The content of a file."""

    record: Mapping[str, Any]
    arrays: Mapping[str, NDArray[Any]]


def write(file: Path, stored: Stored) -> None:
    """Write a file; no reader ever sees half of it.

    Raises:
        OSError: it cannot be written.
    """
    buffer = io.BytesIO()
    arrays: dict[str, Any] = {**stored.arrays, _RECORD: np.array(json.dumps(stored.record))}
    # As `numpy.savez_compressed`, whose deflate makes files larger by a fifth; `numpy.load` reads both.
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_LZMA) as archive:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.lib.format.write_array(content, np.asanyarray(array), allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), content.getvalue(), zipfile.ZIP_LZMA)
    file.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(file, buffer.getvalue())


@contextmanager
def reading(file: Path, largest: int = LARGEST_FILE, content: int | None = None) -> Iterator[Stored]:
    """Give the content of a file; whatever goes wrong while it is taken apart is the file's fault.

    Args:
        file: what is read.
        largest: most bytes of it.
        content: most bytes that it unpacks to; None: `_LARGEST_CONTENT`.

    Raises:
        OSError: it cannot be read.
        ValueError: it is too large, damaged, or holds something else than is looked for.
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
    record = checked_plain(json.loads(str(found.pop(_RECORD))))
    if not isinstance(record, dict):
        raise ValueError("its record is no table")
    return Stored(record, found)


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(entry) as stream:
        content = io.BytesIO(b"".join(iter(lambda: stream.read(_PIECE), b"")))
    array: NDArray[Any] = np.lib.format.read_array(content, allow_pickle=False)
    return array
