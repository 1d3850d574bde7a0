"""Where this code was installed from, and what to type for what is not installed."""

from __future__ import annotations

import json
import os
from pathlib import Path

DISTRIBUTION = "auv-gym"
"""Name of the distribution that holds both packages."""
ROOT = Path(__file__).parents[1]
"""Folder that the packages lie in: a checkout, or an environment's `site-packages`."""


RECORD = ROOT / "research" / "data"
"""Folder of what was measured and trained for studies; only a checkout has it."""


def found(folder: Path, name: str) -> Path:
    """Return a file of a folder of the package; where it is not there, the one of the folder's namesake in `RECORD`."""
    other = RECORD / folder.name / name
    kept = folder.is_relative_to(ROOT) and other.exists() and not (folder / name).exists()
    return other if kept else folder / name


def checkout() -> Path | None:
    """Return the folder of the checkout that this code runs from; None where it was installed as a package."""
    return ROOT if (ROOT / "pyproject.toml").is_file() else None


def install(*extras: str) -> str:
    """Return the line that installs extras into what is there, from where that came: a clone, a file or an index.

    Args:
        extras: names of `[project.optional-dependencies]` in pyproject.toml.
    """
    names = ",".join(extras)
    if (folder := checkout()) is not None:
        return f"pip install -e '{'.' if folder == Path.cwd() else folder}[{names}]'"
    origin = _origin()
    return f"pip install '{DISTRIBUTION}[{names}]{f' @ {origin}' if origin else ''}'"


def _origin() -> str:
    """Return the address that pip has noted for a package that is from no index, see PEP 610; else nothing."""
    from importlib import metadata  # it takes a tenth of the time to a first environment, which does not need it

    try:
        noted = json.loads(metadata.distribution(DISTRIBUTION).read_text("direct_url.json") or "{}")
    except (metadata.PackageNotFoundError, ValueError):
        return ""
    version = noted.get("vcs_info", {})
    prefix, at = (f"{version['vcs']}+", f"@{version['commit_id']}") if version else ("", "")
    return f"{prefix}{noted['url']}{at}" if "url" in noted else ""


def sources() -> str:
    """Return where the sources of this version lie: the folder of a checkout, else the project's address."""
    if (folder := checkout()) is not None:
        return os.fspath(folder)
    from importlib import metadata

    urls = metadata.metadata(DISTRIBUTION).get_all("Project-URL") or []
    return next((url.split(", ", 1)[1] for url in urls if url.startswith("Source, ")), DISTRIBUTION)


def left_out(what: str) -> str:
    """Return that something is not part of the installed package, and where it is."""
    return f"{what} not part of the installed package; the sources have them: {sources()}"
