"""The report on the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from baselines.evaluation.paper.numbers import Reproduction, Row
from baselines.evaluation.report.numbers import Result
from baselines.evaluation.score import LARGEST_TAIL, Pooled, interval_text, losses, regime_of, score_text

WIDTH = 200
"""Columns of a table that does not go to a terminal."""
CHOICE = ("tail [m]", "p95 [m]", "lost")
"""What is shown of a result on a terminal that is too narrow for all."""
LOOK: dict[str, Any] = {"box": box.SIMPLE_HEAD, "pad_edge": False}


def console() -> Console:
    """Return the console for tables on stdout, wide enough for them where it is no terminal."""
    out = Console(highlight=False)
    return out if out.is_terminal else Console(highlight=False, width=WIDTH)


def results_table(results: Sequence[Result], out: Console) -> Table:
    """Return the table of results, scenario by scenario, as wide as the console allows."""
    rows = [_cells(result) for result in results]
    columns = [name for name in rows[0] if any(row[name] != "-" for row in rows)]
    table = _results_table(results, columns)
    fits = out.measure(table, options=out.options.update(max_width=10**4)).maximum <= out.width
    return table if fits else _results_table(results, [column for column in columns if column in CHOICE])


def _results_table(results: Sequence[Result], columns: Sequence[str]) -> Table:
    table = Table(
        title="Position error of the centre of mass",
        caption="tail: RMSE after the first third of an episode; p95, worst 5 %: over episodes; * recorded earlier\n"
        "score: 0 the expert, 1 the oracle; effort, smoothness: relative to the expert's; settled in s; ms a decision",
        **LOOK,
    )
    for name in ("scenario", "policy"):
        table.add_column(name, no_wrap=True)
    for name in columns:
        table.add_column(escape(name), justify="right", no_wrap=True)
    compared = len({result.run.policy for result in results}) > 1
    for previous, result in zip([None, *results], results, strict=False):
        name, cells = result.run.scenario.name, _cells(result)
        first = previous is None or previous.run.scenario.name != name
        if first and previous is not None and compared:
            table.add_section()
        policy = result.run.policy + ("*" if result.run.recorded else "")
        table.add_row(name if first else "", policy, *(cells[column] for column in columns))
    return table


def _cells(result: Result) -> dict[str, str]:
    """Return the cells of a row by their column."""
    run, m = result.run, result.run.measures
    s, ratios = result.summary, (result.effort_ratio, result.smoothness_ratio)
    effort, smoothness = (f"{value:.2f}" if math.isfinite(value) else "-" for value in ratios)
    tail = s.tail_rmse_m if s else None
    interval = "{:.3g} ... {:.3g}".format(*tail.ci95) if tail and math.isfinite(tail.ci95[0]) else "-"
    return {
        "tail [m]": f"{tail.mean:.3g}" if tail else "[red]failed[/red]",
        "95 % interval": interval,
        "p95 [m]": f"{tail.p95:.3g}" if tail else "-",
        "worst 5 %": f"{tail.cvar95:.3g}" if tail else "-",
        "score": score_text(result.score),
        "settled": f"{s.settling_s:.3g}" if s else "-",
        "effort": effort,
        "smoothness": smoothness,
        "saturated": f"{100 * s.saturation:.1f} %" if s else "-",
        "lost": f"{losses(m, regime_of(run.scenario.name))} of {len(m)}" if m else "-",
        "ms": f"{1e3 * run.decision_seconds:.2g}" if s else "-",
    }


def score_table(scores: Sequence[Pooled]) -> Table:
    """Return the table of the scores of each regime, all cases together."""
    caps = ", ".join(f"{cap:g} m {regime}" for regime, cap in LARGEST_TAIL.items())
    table = Table(
        title="Score: 0 the expert, 1 the oracle, errors pooled over cases",
        caption=f"lost: beyond the lost distance, or a tail of {caps}; capped: no tail counts more than that",
        **LOOK,
    )
    table.add_column("regime")
    table.add_column("policy", no_wrap=True)
    for name in ("episodes", "tail [m]", "score", "95 % interval", "capped", "lost"):
        table.add_column(escape(name), justify="right", no_wrap=True)
    for entry in scores:
        cells = (f"{entry.tail_m:.4f}", score_text(entry.score), interval_text(entry.score), score_text(entry.capped))
        table.add_row(entry.regime, entry.policy, str(entry.episodes), *cells, f"{100 * entry.lost:.2f} %")
    return table


def reproduction_tables(reproduction: Reproduction) -> list[Table]:
    """Return the tables about the paper: its numbers, its starts, its slips."""
    starts = Table(
        title="Section V from all eight starts: |x_e| = 0.5 m, |y_e| = 1 m, |psi_e| = 20 deg, at rest", **LOOK
    )
    headings = ("signs", "to 5 cm [s]", "to 1 deg [s]", "peak |F_u| [N]", "peak |F_r| [N m]", "error at 100 s [m]")
    for heading in headings:
        starts.add_column(escape(heading), justify="right")
    for s in reproduction.starts:
        peaks = (f"{s.peak_F_u_N:.1f}", f"{s.peak_F_r_Nm:.1f}")
        starts.add_row(s.signs, f"{s.settling_5cm_s:.1f}", f"{s.settling_1deg_s:.1f}", *peaks, f"{s.error_100s_m:.1e}")
    rows, remarks = reproduction.rows, reproduction.remarks
    return [
        _row_table("The paper's numbers", rows),
        starts,
        _row_table("Where the printed equations do not hold", remarks),
    ]


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
