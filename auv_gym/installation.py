"""The origin of the installation, and the commands that install optional dependencies."""

from __future__ import annotations

import json
import os
from pathlib import Path

DISTRIBUTION = "auv-gym"
"""Name of the distribution."""
ROOT = Path(__file__).parents[1]
"""Folder of the packages: a checkout, or `site-packages` of an environment."""
RECORD = ROOT / "research" / "data"
"""Folder of the measurements and trained agents of studies; only a checkout has it."""


def found(folder: Path, name: str) -> Path:
    """Return a file of a folder of the package, or of the folder of the same name in `RECORD` if only that has it."""
    other = RECORD / folder.name / name
    kept = folder.is_relative_to(ROOT) and other.exists() and not (folder / name).exists()
    return other if kept else folder / name


def checkout() -> Path | None:
    """Return the folder of the checkout that this code runs from; None for an installed package."""
    return ROOT if (ROOT / "pyproject.toml").is_file() else None


def install(*extras: str) -> str:
    """Return the command that installs extras, from the origin of this installation: a clone, an address or an index.

    Args:
        extras: names of `[project.optional-dependencies]` in pyproject.toml.
    """
    names = ",".join(extras)
    if (folder := checkout()) is not None:
        return f"pip install -e '{'.' if folder == Path.cwd() else folder}[{names}]'"
    origin = _origin()
    return f"pip install '{DISTRIBUTION}[{names}]{f' @ {origin}' if origin else ''}'"


def _origin() -> str:
    """Return the address that pip has recorded (PEP 610) if the package is not from an index, else an empty string."""
    from importlib import metadata  # slow to import, and not needed to make an environment

    try:
        record = json.loads(metadata.distribution(DISTRIBUTION).read_text("direct_url.json") or "{}")
    except (metadata.PackageNotFoundError, ValueError):
        return ""
    version = record.get("vcs_info", {})
    prefix, at = (f"{version['vcs']}+", f"@{version['commit_id']}") if version else ("", "")
    return f"{prefix}{record['url']}{at}" if "url" in record else ""


def sources() -> str:
    """Return the location of the sources of this version: the folder of a checkout, else the address of the project."""
    if (folder := checkout()) is not None:
        return os.fspath(folder)
    from importlib import metadata

    urls = metadata.metadata(DISTRIBUTION).get_all("Project-URL") or []
    return next((url.split(", ", 1)[1] for url in urls if url.startswith("Source, ")), DISTRIBUTION)


def left_out(what: str) -> str:
    """Return the message that something is not part of the installed package, with the location of the sources."""
    return f"{what} not part of the installed package; the sources have them: {sources()}"
