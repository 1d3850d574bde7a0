"""Make the live page: `python -m research web-demo --help`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from baselines.tools.command_line import DONE, parse
from research.site.live.page import write

PROGRAM = "python -m research web-demo"


@dataclass(frozen=True)
class Options:
    """Make the live page: static files for any browser, which run the simulation and need no server.

    Exit status: 0 done, 2 wrong usage.
    """

    out: Path = Path("runs/live")
    """Folder of the files."""


def main(arguments: Sequence[str]) -> int:
    """Write the page as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
        OSError: a file cannot be written.
    """
    options = parse(Options, arguments, PROGRAM)
    write(options.out)
    size = sum(file.stat().st_size for file in options.out.iterdir() if file.is_file())
    print(f"written: {options.out}, {size / 1e6:.2f} MB; open {options.out / 'index.html'} in a browser")
    return DONE
