"""Make the live page: `python -m research web-demo --help`.

Some files are printed from the equations, one contains computed data, and those in static/ are written by hand.
"""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from baselines.export.parts import exported
from baselines.tools.command_line import DONE, parse
from baselines.tools.files import write_atomically
from research.site.live.data import data
from research.site.live.equations import equations

AGENTS = ("helm",)
"""Shipped agents on the page, each for both speed ranges."""
LINKED = {"Homepage": "Source", "Documentation": "Documentation"}
"""Labels of the package's addresses in its metadata, and their labels on the page."""


@dataclass(frozen=True)
class Options:
    """Write the live page: static files that run the simulation in a browser, without a server.

    Exit status: 0 done, 2 wrong usage.
    """

    out: Path = Path("runs/live")
    """Folder for the files."""


def links() -> str:
    """Return the script with the links to the source and the documentation, from the metadata of the package."""
    entries = importlib.metadata.metadata("auv-gym").get_all("Project-URL") or []
    addresses = dict(entry.split(", ", 1) for entry in entries)
    shown = {text: addresses[name] for name, text in LINKED.items() if name in addresses}
    return f"window.LINKS = {json.dumps(shown)};\n"


def write_page(folder: Path) -> int:
    """Write the page into a folder, which is made if it is missing, and return its size in bytes.

    The files need no network. Open `index.html`.

    Raises:
        OSError: a file cannot be written.
    """
    agents = {name: exported(name) for name in AGENTS}
    static = Path(__file__).parent / "static"
    files = {file.name: file.read_text(encoding="utf-8") for file in sorted(static.iterdir())}
    files |= {"equations.js": equations([*agents.values()]), "data.js": data(agents) + links()}
    for name, text in files.items():
        write_atomically(folder / name, text)
    return sum(len(text.encode()) for text in files.values())


def main(arguments: Sequence[str]) -> int:
    """Write the page and return the exit status."""
    folder = parse(Options, arguments, "python -m research web-demo").out
    size = write_page(folder)
    print(f"written: {folder}, {size / 1e6:.2f} MB; open {folder / 'index.html'} in a browser")
    return DONE
