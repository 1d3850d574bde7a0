"""Checkpoints as bytes: SHA-256, digests of the code of the pickled classes, pickled objects.

If the code of a class has changed since, unpickling its objects could give wrong objects without an error. Such a
checkpoint is rejected before anything is unpickled.
"""

from __future__ import annotations

import ast
import hashlib
import importlib
import inspect
import io
import json
import pickletools
import textwrap
import zipfile
from collections.abc import Mapping
from pickle import UnpicklingError
from typing import Any

DIGEST = hashlib.sha256().digest_size
"""Bytes in front of a checkpoint: the SHA-256 of the rest."""
OURS = ("auv_gym", "baselines")
"""Packages whose classes are compared."""
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
    pickled = buffer.getvalue()
    code = json.dumps({name: code_of(name) for name in sorted(names_in(pickled))}).encode()
    data = len(code).to_bytes(8, "big") + code + pickled
    return hashlib.sha256(data).digest() + data


def unpacked(content: bytes) -> dict[str, Any]:
    """Return the record of a checkpoint's bytes.

    Raises:
        ValueError: the bytes are damaged, or the code of a pickled class has changed; nothing is unpickled then.
        Exception: one of `UNREADABLE`, if libraries have changed.
    """
    import torch

    digest, data = content[:DIGEST], content[DIGEST:]
    if hashlib.sha256(data).digest() != digest:
        raise ValueError("it is damaged, its SHA-256 differs")
    size = int.from_bytes(data[:8], "big")
    if not 0 < size <= len(data) - 8:
        raise ValueError("it is of an older version, without digests of its classes")
    kept, pickled = json.loads(data[8 : 8 + size]), data[8 + size :]
    if changed := [name for name, code in kept.items() if code_of(name) != code]:
        more = f" and {len(changed) - 1} more" if len(changed) > 1 else ""
        raise ValueError(f"it holds objects of {changed[0].replace(' ', '.')}{more}, whose code has changed since")
    record: dict[str, Any] = torch.load(io.BytesIO(pickled), map_location="cpu", weights_only=False)
    return record


def names_in(pickled: bytes) -> set[str]:
    """Return the classes and functions of `OURS` that a file of `torch.save` names, as "module name"."""
    with zipfile.ZipFile(io.BytesIO(pickled)) as archive:
        data = next(archive.read(name) for name in archive.namelist() if name.endswith("data.pkl"))
    named = {str(argument) for opcode, argument, _ in pickletools.genops(data) if opcode.name == "GLOBAL"}
    return {name for name in named if name.partition(" ")[0].partition(".")[0] in OURS}


def code_of(name: str) -> str | None:
    """Return the SHA-256 of the code of a class or function without comments and docstrings; None if it is missing.

    Args:
        name: its module and its name in the module, separated by a space.
    """
    module, _, path = name.partition(" ")
    try:
        found: Any = importlib.import_module(module)
        for part in path.split("."):
            found = getattr(found, part)
        tree = ast.parse(textwrap.dedent(inspect.getsource(found)))
    except (AttributeError, ImportError, OSError):
        return None
    for node in ast.walk(tree):
        if isinstance(node, (ast.ClassDef, ast.FunctionDef)) and ast.get_docstring(node, clean=False) is not None:
            node.body = node.body[1:] or [ast.Pass()]
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest()
