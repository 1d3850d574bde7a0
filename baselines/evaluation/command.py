"""Runs an evaluation: episodes, progress, tables, and files of results."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from baselines.evaluation import suites
from baselines.evaluation.fingerprints import simulator_fingerprint
from baselines.evaluation.progress import shown
from baselines.evaluation.report.files import results_csv, results_json
from baselines.evaluation.report.html import report_html
from baselines.evaluation.report.numbers import Entry, Result, compare, pool
from baselines.evaluation.report.terminal import print_report
from baselines.evaluation.request import Request
from baselines.evaluation.rows import RowStore
from baselines.evaluation.runner import Run, runs
from baselines.evaluation.submission.files import save_submission, submission_of
from baselines.tools.command_line import DONE, FAILED
from baselines.tools.files import versions, write_atomically

_ROWS = "rows"
"""Subfolder of --out with the finished runs."""


def evaluate(request: Request) -> int:
    """Run an evaluation, print its tables, write its files and return the exit status.

    Progress is shown on stderr: a progress bar on a terminal, otherwise a line for each policy and scenario.
    """
    out = request.options.out
    for note in request.notes:
        print(f"note: {note}", file=sys.stderr)
    try:
        found = _run(request, RowStore(out / _ROWS))
        results, pooled = compare(found, request.anchors), pool(found, request.anchors)
        _write(request, results, pooled)
    except OSError as error:
        print(f"cannot write to {out}: {error.strerror}", file=sys.stderr)
        return FAILED
    print_report(results, pooled, out)
    if request.options.submit is not None and _submit(request, found) != DONE:
        return FAILED
    return FAILED if any(run.error for run in found) else DONE


def _run(request: Request, store: RowStore) -> list[Run]:
    """Return the runs of a request, cell by cell; each complete run is saved in the store."""
    found, options, simulator = list(request.earlier), request.options, simulator_fingerprint()
    outdated: list[str] = []  # keys of runs of another version of the simulator

    def known(key: str) -> Run | None:
        run = store.load(key) if options.resume else None
        if run is not None and run.simulator != simulator:
            if not outdated:
                print("note: runs of another version of the simulator are run again", file=sys.stderr)
            outdated.append(key)
        return run

    every = runs(request.pairs, request.workers, options.step_limit, known)
    for run in shown(every, len(request.pairs)):
        store.save(run)
        found.append(run)
    cells = [cell.scenario.name for cell in request.cells]
    names = list(dict.fromkeys((*request.policies, *(run.policy for run in request.earlier))))
    return sorted(found, key=lambda run: (cells.index(run.scenario.name), names.index(run.policy)))


def _write(request: Request, results: list[Result], pooled: list[Entry]) -> None:
    out = request.options.out
    write_atomically(out / "results.json", results_json(request, results, pooled))
    write_atomically(out / "results.csv", results_csv(results))
    write_atomically(out / "report.html", report_html(request, results, pooled))


def _submit(request: Request, found: Sequence[Run]) -> int:
    """Write the submission of an evaluation into its folder, print the file's name and return the exit status.

    Raises:
        OSError: the file cannot be written.
    """
    options = request.options
    (policy,) = set(options.policy)
    assert options.submit is not None
    own = [run for run in found if run.policy == policy]
    file = options.out / f"{options.submit}.npz"
    try:
        suite = suites.load_suite(request.suite or "")
        made = submission_of(suite, own, options.submit, options.about, versions(), request.command)
        size = save_submission(made, file)
    except ValueError as error:
        print(f"no submission: {error}", file=sys.stderr)
        return FAILED
    print(f"Wrote {file}, {size / 1000:.0f} kB: {made.episodes} episodes of {suite.name}")
    print(f"Check it with `auv-gym submit {file} {policy!r}`")
    return DONE
