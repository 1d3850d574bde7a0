"""Shows the progress of an evaluation: a progress bar on a terminal, otherwise a line for each run."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from baselines.evaluation.runner import STEP_LIMIT, Cell, Run, runs
from baselines.tools.workers import Workers


def shown(found: Iterable[Run], count: int) -> Iterator[Run]:
    """Yield runs; each is shown on stderr after the caller has processed it.

    Args:
        found: the runs, which are computed one after the other.
        count: their number.
    """
    console = Console(stderr=True, highlight=False)
    if not console.is_terminal:
        for i, run in enumerate(found, 1):
            yield run
            print(f"[{i}/{count}] {_text(run)}", file=sys.stderr, flush=True)
        return
    columns = TextColumn("{task.completed}/{task.total} {task.description}"), BarColumn(), TimeElapsedColumn()
    with Progress(*columns, TextColumn("left"), TimeRemainingColumn(), console=console, transient=True) as bar:
        task = bar.add_task("runs", total=count)
        for run in found:
            yield run
            bar.update(task, advance=1, description=_text(run))


def run_and_show(pairs: Sequence[tuple[str, Cell]], workers: Workers, step_limit: float = STEP_LIMIT) -> list[Run]:
    """Return the run of each policy in its cell, in the order of completion, and show the progress on stderr."""
    return list(shown(runs(pairs, workers, step_limit), len(pairs)))


def _text(run: Run) -> str:
    return f"{run.policy} in {run.scenario.name}: {'failed' if run.error else 'known' if run.known else 'done'}"
