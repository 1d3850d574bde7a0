"""Recompute numbers and figures of the paper: `python -m research paper --help`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from baselines.tools.command_line import DONE, FAILED, checked_folder, parse
from baselines.tools.files import json_text, write_atomically
from research.paper.figures import paper_figures
from research.paper.numbers import reproduce_paper
from research.paper.page import numbers_section, remarks_section, starts_section

PROGRAM = "python -m research paper"


@dataclass(frozen=True)
class Options:
    """Print the printed and the recomputed numbers of the paper; write paper.json and the figures 3 to 6.

    Exit status: 0 done, 1 the files cannot be written, 2 wrong usage.
    """

    out: Path = Path("runs/paper")
    """Folder for the files."""


def main(arguments: Sequence[str]) -> int:
    """Recompute the paper and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    folder = checked_folder(parse(Options, arguments, PROGRAM).out)
    found = reproduce_paper(lambda part: print(part, file=sys.stderr))
    for section in (numbers_section, starts_section, remarks_section):
        print(f"{section(found)}\n")
    files: dict[str, str | bytes] = {f"{name}.png": png for name, png in paper_figures(found).items()}
    files["paper.json"] = json_text(found.to_dict())
    try:
        for name, content in files.items():
            write_atomically(folder / name, content)
    except OSError as error:
        print(f"cannot write to {folder}: {error.strerror}", file=sys.stderr)
        return FAILED
    print(f"Wrote {', '.join(sorted(files))} to {folder}")
    return DONE
