"""Make the live page: `python -m research web-demo --help`.

Its files are printed from the equations, computed beforehand, or written by hand in static/.
"""

from __future__ import annotations

import importlib.metadata
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from auv_gym.scenarios.presets import SPEED_RANGES
from baselines.export.parts import Exported, exported
from baselines.tools.command_line import DONE, parse
from baselines.tools.files import write_atomically
from research.site.live.data import data
from research.site.live.equations import equations

PROGRAM = "python -m research web-demo"
_FOLDER = Path(__file__).parent / "static"
_AGENTS = ("apg", "apg-preview")
"""Shipped agents of the page, one for each regime."""
LINKED = {"Homepage": "Source", "Documentation": "Documentation"}
"""Addresses of the package that the page shows, and what it calls them."""
LARGEST_PAGE = 3_000_000
"""Bytes that all files together may have."""


@dataclass(frozen=True)
class Options:
    """Make the live page: static files for any browser, which run the simulation and need no server.

    Exit status: 0 done, 2 wrong usage.
    """

    out: Path = Path("runs/live")
    """Folder of the files."""


def page_agents() -> dict[str, Exported]:
    """Return the page's agents by name and regime, as "apg cruise"."""
    return {
        f"{name} {speed_range}": exported(f"{name}-{speed_range}") for name in _AGENTS for speed_range in SPEED_RANGES
    }


def files() -> dict[str, str]:
    """Return the page's files by name: text that a browser opens from anywhere, a disk too, without a network."""
    agents = page_agents()
    written = {file.name: file.read_text(encoding="utf-8") for file in sorted(_FOLDER.iterdir())}
    printed = {"equations.js": equations([*agents.values()]), "data.js": data(agents) + links()}
    return {**written, **printed}


def links() -> str:
    """Return the script that tells the page where project and documentation are, as far as the package says so."""
    try:
        entries = importlib.metadata.metadata("auv-gym").get_all("Project-URL") or []
    except importlib.metadata.PackageNotFoundError:
        entries = []
    known = dict(entry.split(", ", 1) for entry in entries)
    shown = {text: known[name] for name, text in LINKED.items() if name in known}
    return f"window.LINKS = {json.dumps(shown)};\n"


def write_page(folder: Path) -> None:
    """Write the page into a folder, which is made if it is not there; `index.html` is what a browser opens.

    Raises:
        OSError: a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files().items():
        write_atomically(folder / name, text)


def main(arguments: Sequence[str]) -> int:
    """Write the page as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
        OSError: a file cannot be written.
    """
    options = parse(Options, arguments, PROGRAM)
    write_page(options.out)
    size = sum(file.stat().st_size for file in options.out.iterdir() if file.is_file())
    print(f"written: {options.out}, {size / 1e6:.2f} MB; open {options.out / 'index.html'} in a browser")
    return DONE
