"""Checkpoints as bytes: SHA-256, digest of the source code, pickled objects.

If the code has changed since, unpickling could give wrong objects without an error. Such a checkpoint is rejected
before anything is unpickled.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import auv_gym

DIGEST = hashlib.sha256().digest_size
"""Length of each of the two digests in front of a checkpoint: of the rest, and of the code."""
UNREADABLE = (
    AttributeError,
    EOFError,
    ImportError,
    IndexError,
    KeyError,
    RuntimeError,
    TypeError,
    ValueError,
    UnpicklingError,
)
"""Exceptions that a damaged checkpoint, or one of other versions of the libraries, can raise."""


def packed(record: Mapping[str, Any]) -> bytes:
    """Return a record as a checkpoint's bytes.

    Args:
        record: objects that can be pickled.
    """
    import torch

    buffer = io.BytesIO()
    torch.save(dict(record), buffer)
    data = code_digest() + buffer.getvalue()
    return hashlib.sha256(data).digest() + data


def unpacked(content: bytes) -> dict[str, Any]:
    """Return the record of a checkpoint's bytes.

    Raises:
        ValueError: the bytes are damaged, or the code has changed; nothing is unpickled then.
        Exception: one of `UNREADABLE`, if libraries have changed.
    """
    import torch

    digest, data = content[:DIGEST], content[DIGEST:]
    if hashlib.sha256(data).digest() != digest:
        raise ValueError("it is damaged, its SHA-256 differs")
    if data[:DIGEST] != code_digest():
        raise ValueError("the code of auv_gym or baselines has changed since")
    record: dict[str, Any] = torch.load(io.BytesIO(data[DIGEST:]), map_location="cpu", weights_only=False)
    return record


@cache
def code_digest() -> bytes:
    """Return the SHA-256 of the Python source files of `auv_gym` and `baselines` at the first call."""
    found = hashlib.sha256()
    for package in (Path(auv_gym.__file__).parent, Path(__file__).parents[1]):
        for file in sorted(package.rglob("*.py")):
            found.update(file.read_bytes())
    return found.digest()
