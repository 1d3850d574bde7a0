"""Recompute numbers and figures of the paper: `python -m research paper --help`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from baselines.evaluation.report.terminal import LOOK, console
from baselines.evaluation.request import checked_folder
from baselines.tools.command_line import DONE, FAILED, parse
from baselines.tools.files import json_text, write_atomically
from research.paper.figures import paper_figures
from research.paper.numbers import Reproduction, Row, reproduce_paper

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
    found, out = reproduce_paper(lambda part: print(part, file=sys.stderr)), console()
    for table in tables(found):
        out.print(table)
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


def tables(reproduction: Reproduction) -> list[Table]:
    """Return the tables: the numbers of the paper, the responses from its starts, its errors."""
    starts = Table(
        title="Section V from all eight starts: |x_e| = 0.5 m, |y_e| = 1 m, |psi_e| = 20 deg, at rest", **LOOK
    )
    headings = ("signs", "to 5 cm [s]", "to 1 deg [s]", "peak |F_u| [N]", "peak |F_r| [N m]", "error at 100 s [m]")
    for heading in headings:
        starts.add_column(escape(heading), justify="right")
    for s in reproduction.starts:
        peaks = (f"{s.peak_F_u_N:.1f}", f"{s.peak_F_r_Nm:.1f}")
        starts.add_row(s.signs, f"{s.settling_5cm_s:.1f}", f"{s.settling_1deg_s:.1f}", *peaks, f"{s.error_100s_m:.1e}")
    numbers = _row_table("The paper's numbers", reproduction.rows)
    return [numbers, starts, _row_table("Where the printed equations do not hold", reproduction.remarks)]


def _row_table(title: str, rows: Sequence[Row]) -> Table:
    table = Table(title=title, **LOOK)
    for name, justify in (("quantity", "left"), ("place", "left"), ("paper", "right"), ("measured", "right")):
        table.add_column(name, justify=justify)  # type: ignore[arg-type]
    for name in ("unit", "agrees", "note"):
        table.add_column(name)
    verdicts = {True: "yes", False: "[yellow]no[/yellow]", None: "-"}
    for row in rows:
        paper = "-" if row.paper is None else f"{row.paper:.6g}"
        table.add_row(row.quantity, row.place, paper, f"{row.measured:.6g}", row.unit, verdicts[row.agrees], row.note)
    return table
