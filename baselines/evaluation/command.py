"""An evaluation from request to report: runs, progress, tables, files."""

from __future__ import annotations

import sys

from baselines.evaluation.progress import Listener, progress
from baselines.evaluation.report.files import results_csv, results_json
from baselines.evaluation.report.html import report_html
from baselines.evaluation.report.numbers import Entry, Result, compare, pool
from baselines.evaluation.report.terminal import print_report
from baselines.evaluation.request import Request
from baselines.evaluation.rows import RowStore
from baselines.evaluation.runner import Run, runs
from baselines.evaluation.submission.making import write_submission
from baselines.tools.command_line import DONE, FAILED
from baselines.tools.files import write_atomically
from research.paper.numbers import Reproduction, reproduce

ROWS = "rows"
"""Folder in DIR that keeps the finished runs."""


def evaluate(request: Request) -> int:
    """Run an evaluation, print its tables, write its files and return the exit status.

    Progress goes to stderr: a live line on a terminal, else a line for each policy and scenario.
    """
    reproduction, out = None, request.options.out
    for note in request.notes:
        print(f"note: {note}", file=sys.stderr)
    try:
        with progress(len(request.pairs), request.steps) as report:
            if request.suite == "paper":
                reproduction = reproduce(report.message)
            found = _run(request, RowStore(out / ROWS), report)
            report.message("plots")
            results, pooled = compare(found, request.anchors), pool(found, request.anchors)
            _write(request, results, pooled, reproduction)
    except OSError as error:
        print(f"cannot write to {out}: {error.strerror}", file=sys.stderr)
        return FAILED
    print_report(results, pooled, reproduction, out)
    if request.options.submit is not None and write_submission(request, found) != DONE:
        return FAILED
    return FAILED if any(run.error for run in found) else DONE


def _run(request: Request, store: RowStore, report: Listener) -> list[Run]:
    """Return the runs of a request, cell by cell; each is kept in the store when it is complete."""
    found, options = list(request.earlier), request.options
    known = store.load if options.resume else lambda _: None
    for run in runs(request.pairs, request.workers, options.step_limit, report.board.note, known):
        store.save(run)
        report.run(run)
        found.append(run)
    cells = [cell.scenario.name for cell in request.cells]
    names = list(dict.fromkeys((*request.policies, *(run.policy for run in request.earlier))))
    return sorted(found, key=lambda run: (cells.index(run.scenario.name), names.index(run.policy)))


def _write(request: Request, results: list[Result], pooled: list[Entry], reproduction: Reproduction | None) -> None:
    from baselines.evaluation.report.figures import evaluation_figures

    out, figures = request.options.out, evaluation_figures(results)
    files: dict[str, str | bytes] = {}
    if reproduction is not None:
        from research.paper.figures import paper_figures
        from research.paper.page import paper_html

        figures |= paper_figures(reproduction)
        files["paper.html"] = paper_html(reproduction, request.command)
    files |= {f"{name}.png": png for name, png in figures.items()}
    files["results.json"] = results_json(request, results, pooled, reproduction)
    files["results.csv"] = results_csv(results)
    files["report.html"] = report_html(request, results, pooled, paper=reproduction is not None)
    for name, content in files.items():
        write_atomically(out / name, content)
