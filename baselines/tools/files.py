"""Files that are either whole or absent, strict JSON, and the versions that they name."""

from __future__ import annotations

import json
import math
import os
import platform
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import scipy

import auv_gym


def write_atomically(file: Path, content: str | bytes) -> None:
    """Write a file so that no reader ever sees half of it."""
    temporary = file.with_name(f".{file.name}.{os.getpid()}.tmp")
    try:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)
        temporary.replace(file)
    finally:
        temporary.unlink(missing_ok=True)


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
