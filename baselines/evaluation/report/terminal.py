"""Prints the progress and the report of an evaluation on the terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from itertools import groupby
from pathlib import Path

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from baselines.evaluation.cells import Cell
from baselines.evaluation.report.columns import Column, ranked, used
from baselines.evaluation.report.numbers import Entry, Result, Trained, recordings
from baselines.evaluation.runner import STEP_LIMIT, Run, runs
from baselines.evaluation.score import EXPERT, FULL_INFORMATION, SCALE, interval_text
from baselines.tools.workers import Workers

_WIDTH = 200  # [characters] width of tables without a terminal


def shown(results: Iterable[Run], count: int) -> Iterator[Run]:
    """Yield runs; each is shown on stderr after the caller has processed it.

    Args:
        results: the runs, which are computed one after the other.
        count: their number.
    """
    console = Console(stderr=True, highlight=False)
    if not console.is_terminal:
        for i, run in enumerate(results, 1):
            yield run
            print(f"[{i}/{count}] {_text(run)}", file=sys.stderr, flush=True)
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = TextColumn("{task.completed}/{task.total} {task.description}"), BarColumn(), TimeElapsedColumn()
    with Progress(*columns, TextColumn("left"), TimeRemainingColumn(), console=console, transient=True) as bar:
        task = bar.add_task("runs", total=count)
        for run in results:
            yield run
            bar.update(task, advance=1, description=_text(run))


def run_and_show(pairs: Sequence[tuple[str, Cell]], workers: Workers, step_limit: float = STEP_LIMIT) -> list[Run]:
    """Return the run of each policy in its cell, in the order of completion, and show the progress on stderr."""
    return list(shown(runs(pairs, workers, step_limit), len(pairs)))


def _text(run: Run) -> str:
    return f"{run.policy} in {run.scenario.name}: {'failed' if run.error else 'known' if run.known else 'done'}"


def console() -> Console:
    """Return the console for tables on stdout; without a terminal it has a fixed width."""
    out = Console(highlight=False)
    return out if out.is_terminal else Console(highlight=False, width=_WIDTH)


def print_report(
    results: Sequence[Result], pooled: Sequence[Entry], folder: Path, trained: Sequence[Trained] = ()
) -> None:
    """Print the tables, and warnings and failures on stderr."""
    out, err = console(), Console(stderr=True, highlight=False, soft_wrap=True)
    shown = [r for r in results if r.run.recorded is None or r.run.policy in FULL_INFORMATION]
    out.print(entries_table("Position error of the centre of mass", "scenario", [r.entry for r in shown], out))
    if any(entry.score for entry in pooled):
        out.print(entries_table("All cases of a speed range together", "speed range", pooled, out))
    for one in trained:
        line = (
            f"{Path(one.policies[0]).parent}, {len(one.policies)} seeds, {one.place}: {one.to_expert.mean:.3f} "
            f"({interval_text(one.to_expert)}) times the error of {EXPERT}, interval over seeds and episodes; "
            f"interquartile mean of the seeds {one.middle:.3f}"
        )
        out.print(line, soft_wrap=True, markup=False)
    if when := recordings(results):
        more = "; case by case in report.html" if len(shown) < len(results) else ""
        out.print(f"* recorded, not run now: {when}{more}", soft_wrap=True, markup=False)
    out.print(f"Wrote report.html, results.json, results.csv and results.npz to {folder}", soft_wrap=True, markup=False)
    for line in _messages(results):
        err.print(line, markup=False)


def _messages(results: Sequence[Result]) -> Iterator[str]:
    """Yield a line for each policy with warnings, and for each failed run."""
    for policy, group in groupby(sorted(results, key=lambda r: r.run.policy), key=lambda r: r.run.policy):
        messages = [message for result in group for message in result.run.warnings]
        if messages:
            more = f" ({len(messages)} warnings, see results.json)" if len(messages) > 1 else ""
            yield f"note: {policy}: {messages[0]}{more}"
    for run in (result.run for result in results):
        if run.error:
            yield f"failed: {run.policy} in {run.scenario.name}, {run.error}"


def entries_table(title: str, kind: str, entries: Sequence[Entry], out: Console) -> Table:
    """Return a table by scenario or speed range, the best policies first, with the columns that fit into the console.

    Columns are left out in the order of `Column.keep`.
    """
    columns = used(entries)
    table = _table(title, kind, entries, columns)
    while len(columns) > 1 and out.measure(table, options=out.options.update(max_width=10**4)).maximum > out.width:
        columns.remove(min(columns, key=lambda column: column.keep))
        table = _table(title, kind, entries, columns)
    return table


def _table(title: str, kind: str, entries: Sequence[Entry], columns: Sequence[Column]) -> Table:
    scored = any(column.key == "score.mean" for column in columns)
    caption = "steady: RMSE after the first third of an episode" + (f"; score: {SCALE}" if scored else "")
    table = Table(title=title, caption=caption, box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column(kind, no_wrap=True)
    table.add_column("policy", no_wrap=True)
    for column in columns:
        table.add_column(escape(column.heading), justify="right", no_wrap=True)
    groups = [(place, ranked(list(order))) for place, order in groupby(entries, key=lambda entry: entry.place)]
    for place, order in groups:
        if len(order) > 1:
            table.add_section()
        for i, entry in enumerate(order):
            cells = [column.text(entry) for column in columns] if entry.summary else ["[red]failed[/red]"]
            name = entry.policy + ("*" if entry.recorded else "")
            table.add_row(escape(place) if i == 0 else "", escape(name), *cells)
    return table
