"""Recompute numbers and figures of the paper: `python -m research paper --help`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from baselines.tools.command_line import DONE, checked_folder, parse
from baselines.tools.files import write_atomically
from research.pages import table
from research.paper.figures import paper_figures
from research.paper.numbers import TableRow, reproduce_paper

_VERDICTS = {True: "yes", False: "no", None: "-"}


@dataclass(frozen=True)
class Options:
    """Print the printed and the recomputed numbers of the paper, and write the figures 3 to 6.

    Exit status: 0 done, 2 wrong usage.
    """

    out: Path = Path("runs/paper")
    """Folder for the figures."""


def numbers_section() -> str:
    """Return the printed and the recomputed numbers as a table in Markdown."""
    rows = [(*_cells(r), r.unit, _VERDICTS[r.agrees], r.note) for r in reproduce_paper().rows]
    return table(("quantity", "place", "printed", "recomputed", "unit", "agrees", "note"), rows, right=False)


def starts_section() -> str:
    """Return the responses from the eight starts of section V as a table in Markdown."""
    heads = (
        "signs of x_e, y_e, psi_e", "within 5 cm [s]", "within 1 deg [s]", "peak F_u [N]", "peak F_r [N m]",
        "error at 100 s [m]",
    )  # fmt: skip
    rows = [(f"`{signs}`", *(f"{number:.3g}" for number in numbers)) for signs, *numbers in reproduce_paper().starts]
    return table(heads, rows, right=False)


def remarks_section() -> str:
    """Return the printed equations that do not hold as a table in Markdown."""
    rows = [
        (place, what, printed, holds, r.unit, r.note)
        for r in reproduce_paper().remarks
        for what, place, printed, holds in (_cells(r),)
    ]
    return table(("place", "what", "printed", "what holds", "unit", "why"), rows, right=False)


def _cells(row: TableRow) -> tuple[str, str, str, str]:
    """Return quantity, place, printed and recomputed value."""
    paper, measured = ("-" if value is None else f"{value:.4g}" for value in (row.paper, row.measured))
    return row.quantity.replace("|", "\\|"), row.place, paper, measured


def main(arguments: Sequence[str]) -> int:
    """Recompute the paper and return the exit status."""
    folder = checked_folder(parse(Options, arguments, "python -m research paper").out)
    for section in (numbers_section, starts_section, remarks_section):
        print(f"{section()}\n")
    for name, png in paper_figures(reproduce_paper()).items():
        write_atomically(folder / f"{name}.png", png)
    print(f"figures: {folder}")
    return DONE
