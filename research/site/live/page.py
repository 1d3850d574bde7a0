"""Make the live page: `python -m research web-demo --help`.

Some files are printed from the equations, one contains computed data, and those in static/ are written by hand.
"""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from baselines.export.parts import Exported, exported
from baselines.tools.command_line import DONE, parse
from baselines.tools.files import write_atomically
from research.site.live.data import data
from research.site.live.equations import equations

PROGRAM = "python -m research web-demo"
_FOLDER = Path(__file__).parent / "static"
AGENTS = ("helm",)
"""Shipped agents on the page, each for both speed ranges."""
LINKED = {"Homepage": "Source", "Documentation": "Documentation"}
"""Labels of the package's addresses in its metadata, and their labels on the page."""
LARGEST_PAGE = 3_000_000
"""Largest total size of all files, in bytes."""


@dataclass(frozen=True)
class Options:
    """Write the live page: static files that run the simulation in a browser, without a server.

    Exit status: 0 done, 2 wrong usage.
    """

    out: Path = Path("runs/live")
    """Folder for the files."""


def page_agents() -> dict[str, Exported]:
    """Return the agents of the page by name."""
    return {name: exported(name) for name in AGENTS}


def files() -> dict[str, str]:
    """Return the texts of the page's files by name. They need no network."""
    agents = page_agents()
    written = {file.name: file.read_text(encoding="utf-8") for file in sorted(_FOLDER.iterdir())}
    printed = {"equations.js": equations([*agents.values()]), "data.js": data(agents) + links()}
    return {**written, **printed}


def links() -> str:
    """Return the script with the links to the source and the documentation, from the metadata of the package."""
    try:
        entries = importlib.metadata.metadata("auv-gym").get_all("Project-URL") or []
    except importlib.metadata.PackageNotFoundError:
        entries = []
    known = dict(entry.split(", ", 1) for entry in entries)
    shown = {text: known[name] for name, text in LINKED.items() if name in known}
    return f"window.LINKS = {json.dumps(shown)};\n"


def write_page(folder: Path) -> None:
    """Write the page into a folder, which is made if it is missing. Open its `index.html`.

    Raises:
        OSError: a file cannot be written.
    """
    for name, text in files().items():
        write_atomically(folder / name, text)


def main(arguments: Sequence[str]) -> int:
    """Write the page and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
        OSError: a file cannot be written.
    """
    options = parse(Options, arguments, PROGRAM)
    write_page(options.out)
    size = sum(file.stat().st_size for file in options.out.iterdir() if file.is_file())
    print(f"written: {options.out}, {size / 1e6:.2f} MB; open {options.out / 'index.html'} in a browser")
    return DONE
