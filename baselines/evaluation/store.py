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

from baselines.tools.files import LARGEST_FILE, read_bytes, write_atomically

_LARGEST_CONTENT = 2**29  # [bytes] largest uncompressed size of a file
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
    file.parent.mkdir(parents=True, exist_ok=True)
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
    try:
        yield _read(file, largest, _LARGEST_CONTENT if content is None else content)
    except OSError:
        raise
    except Exception as error:  # of any kind: zlib.error, TypeError, MemoryError, RuntimeError ...
        raise ValueError(f"{file} is damaged: {' '.join(f'{type(error).__name__}: {error}'.split())}") from error


def _read(file: Path, largest: int, content: int) -> Stored:
    data = read_bytes(file, largest)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        size = sum(entry.file_size for entry in archive.infolist())
    if size > content:
        raise ValueError(f"it is larger than {content} bytes unpacked")
    with np.load(io.BytesIO(data), allow_pickle=False) as arrays:
        found = {name: arrays[name] for name in arrays.files}
    record = json.loads(str(found.pop(_RECORD)))
    if not isinstance(record, dict):
        raise ValueError("its record is no table")
    return Stored(record, found)
