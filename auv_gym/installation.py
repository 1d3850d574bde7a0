"""The origin of the installation, and the commands that install optional dependencies."""

from __future__ import annotations

import json
from pathlib import Path

DISTRIBUTION = "auv-gym"
"""Name of the distribution."""
ROOT = Path(__file__).parents[1]
"""Folder of the packages: a checkout, or `site-packages` of an environment."""


def install(*extras: str) -> str:
    """Return the command that installs extras, from the origin of this installation: a clone, an address or an index.

    Args:
        extras: names of `[project.optional-dependencies]` in pyproject.toml.
    """
    names = ",".join(extras)
    if (ROOT / "pyproject.toml").is_file():  # a checkout
        return f"pip install -e '{'.' if Path.cwd() == ROOT else ROOT}[{names}]'"
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
