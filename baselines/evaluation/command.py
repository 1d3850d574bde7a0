"""An evaluation from request to report: runs, progress, tables, files."""

from __future__ import annotations

import sys

from rich.console import Console

from baselines.evaluation.paper.numbers import Reproduction, reproduce
from baselines.evaluation.progress import Listener, progress
from baselines.evaluation.report.html import report_html
from baselines.evaluation.report.numbers import Result, compare, pool, recordings, results_csv, results_json
from baselines.evaluation.report.terminal import console, reproduction_tables, results_table, score_table
from baselines.evaluation.request import Request
from baselines.evaluation.rows import RowStore
from baselines.evaluation.runner import Run, runs
from baselines.evaluation.score import ORACLE, Pooled
from baselines.tools.command_line import DONE, FAILED
from baselines.tools.files import write_atomically

ROWS = "rows"
"""Folder in DIR that keeps the finished runs."""


def evaluate(request: Request) -> int:
    """Run an evaluation, print its tables, write its files and return the exit status.

    Progress goes to stderr: a live line on a terminal, else a line for each policy and scenario.
    """
    reproduction, store = None, RowStore(request.out / ROWS)
    try:
        runs_to_do, steps = len(request.policies) * len(request.cells), len(request.policies) * request.steps
        with progress(runs_to_do, steps) as report:
            if request.suite == "paper":
                reproduction = reproduce(report.message)
            found = _run(request, store, report)
            report.message("plots")
            results, scores = compare(found), pool(found)
            _write(request, results, scores, reproduction)
    except OSError as error:
        print(f"cannot write to {request.out}: {error.strerror}", file=sys.stderr)
        return FAILED
    _print(request, results, scores, reproduction)
    return FAILED if any(run.error for run in found) else DONE


def _run(request: Request, store: RowStore, report: Listener) -> list[Run]:
    """Return the runs of a request; each is kept in the store when it is complete."""
    found, known = list(request.earlier), store.load if request.resume else lambda _: None
    note = report.board.note
    for run in runs(request.policies, request.cells, request.workers, request.step_limit, note, known):
        store.save(run)
        report.run(run)
        found.append(run)
    order = [cell.scenario.name for cell in request.cells]
    names = [*request.policies, *(run.policy for run in request.earlier)]
    return sorted(found, key=lambda run: (order.index(run.scenario.name), names.index(run.policy)))


def _write(request: Request, results: list[Result], scores: list[Pooled], reproduction: Reproduction | None) -> None:
    from baselines.evaluation.report.figures import evaluation_figures

    write_atomically(request.out / "results.json", results_json(request, results, scores, reproduction))
    write_atomically(request.out / "results.csv", results_csv(results))
    figures = evaluation_figures(results)
    if reproduction is not None:
        from baselines.evaluation.paper.figures import paper_figures

        figures |= paper_figures(reproduction)
    for name, png in figures.items():
        write_atomically(request.out / f"{name}.png", png)
    write_atomically(request.out / "report.html", report_html(request, results, scores, figures))


def _print(request: Request, results: list[Result], scores: list[Pooled], reproduction: Reproduction | None) -> None:
    out, err = console(), Console(stderr=True, highlight=False, soft_wrap=True)
    for table in reproduction_tables(reproduction) if reproduction else []:
        out.print(table)
    shown = [r for r in results if r.run.recorded is None or r.run.policy == ORACLE]
    out.print(results_table(shown, out))
    if any(entry.score for entry in scores):
        out.print(score_table(scores))
    if (when := recordings(results)) and shown != results:
        out.print(f"Recorded, not run now: {when}; case by case in report.html", soft_wrap=True)
    elif when:
        out.print(f"Recorded, not run now: {when}", soft_wrap=True)
    out.print(f"Wrote report.html, results.json, results.csv and plots to {request.out}", soft_wrap=True)
    notes: dict[str, list[str]] = {}
    for result in results:
        notes.setdefault(result.run.policy, []).extend(result.run.warnings)
    for policy, messages in notes.items():
        if messages:
            more = f" ({len(messages)} warnings, see results.json)" if len(messages) > 1 else ""
            err.print(f"note: {policy}: {messages[0]}{more}", markup=False)
    for result in results:
        if result.run.error:
            err.print(f"failed: {result.run.policy} in {result.run.scenario.name}, {result.run.error}", markup=False)
