"""Runs an evaluation: episodes, progress, tables, and files of results."""

from __future__ import annotations

import csv
import io
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from typing import Any, cast

from auv_gym.planning.paths import Path
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.report.columns import line, record
from baselines.evaluation.report.html import report_html
from baselines.evaluation.report.numbers import Entry, Result, Trained, compare, over_seeds, pool
from baselines.evaluation.report.terminal import print_report, shown
from baselines.evaluation.request import Request
from baselines.evaluation.results import ResultFile
from baselines.evaluation.runner import Run, runs
from baselines.tools.command_line import DONE, FAILED
from baselines.tools.files import finite, json_text, versions, write_atomically

_FINISHED = "finished"
"""Subfolder of --out with a file of results for each finished run, by its key."""


def evaluate(request: Request) -> int:
    """Run an evaluation, print its tables, write its files and return the exit status.

    Progress is shown on stderr: a progress bar on a terminal, otherwise a line for each policy and scenario.
    """
    out = request.options.out
    for note in request.notes:
        print(f"note: {note}", file=sys.stderr)
    try:
        done = request.ordered(run_request(request))
        everything = request.ordered([*request.earlier, *done])
        beyond = {} if request.frozen else {cell.scenario.name: cell.beyond for cell in request.cells}
        results, pooled = compare(everything, beyond), pool(everything)
        trained = over_seeds(everything, request.trainings)
        texts = {
            "results.json": results_json(request, results, pooled, trained),
            "results.csv": results_csv(results),
            "report.html": report_html(request, results, pooled),
        }
        if request.options.mission is not None:
            texts["reference.csv"] = reference_csv(request.cells[0].scenario)
        for name, text in texts.items():
            write_atomically(out / name, text)
        content = tuple(replace(run, tracks=(), bands=None) for run in done)
        suite = (request.suite or "") if request.frozen else ""
        ResultFile(content, suite, request.hash, request.command).write(out / "results.npz")
    except OSError as error:
        print(f"cannot write to {out}: {error.strerror}", file=sys.stderr)
        return FAILED
    print_report(results, pooled, out, trained)
    return FAILED if any(run.error for run in done) else DONE


def run_request(request: Request) -> list[Run]:
    """Return the runs of a request; each finished run is kept in a file, so that an interruption does not repeat it."""
    folder, options = request.options.out / _FINISHED, request.options

    def finished(key: str) -> Run | None:
        """Return the finished run of a key, if it is to be resumed and its file is not damaged."""
        if options.resume:
            with suppress(OSError, ValueError):
                (run,) = ResultFile.read(folder / f"{key}.npz").runs
                return replace(run, recorded=None) if run.key == key else None
        return None

    done = []
    found = runs(request.pairs, request.workers, options.step_limit, finished, request.plant)
    for run in shown(found, len(request.pairs)):
        if run.measures is not None:
            ResultFile((run,)).write(folder / f"{run.key}.npz")
        done.append(run)
    return done


def results_json(
    request: Request, results: Sequence[Result], pooled: Sequence[Entry], trained: Sequence[Trained] = ()
) -> str:
    """Return the text of results.json: strict JSON, with null for numbers that are not finite."""
    content: dict[str, Any] = {
        "suite": request.suite,
        "suite_hash": request.hash,
        "seed": request.options.seed,
        "plant": request.options.plant,
        "versions": versions(),
        "results": [
            {
                "policy": result.run.policy,
                "scenario": result.run.scenario.name,
                **record(result.entry),
                "seconds": result.run.seconds,
                "recorded": asdict(result.run.recorded) if result.run.recorded else None,
                "error": result.run.error,
                "warnings": list(result.run.warnings),
            }
            for result in results
        ],
        "pooled": [{"policy": entry.policy, "speed_range": entry.place, **record(entry)} for entry in pooled],
        "trainings": [asdict(one) for one in trained],
    }
    return json_text(content)


def reference_csv(scenario: Scenario) -> str:
    """Return the reference of a fixed path as a table: t [s] and the entries of `Model.Reference` in SI units."""
    table = scenario.planner.table(cast(Path, scenario.path)).tolist()
    rows = (",".join(f"{x:.9g}" for x in (k * scenario.control_dt, *row)) for k, row in enumerate(table))
    heading = ",".join(("t", *scenario.parts.model.Reference._fields))
    return "\n".join((heading, *rows, ""))


def results_csv(results: Sequence[Result]) -> str:
    """Return the text of results.csv: a line for each result of results.json, with empty cells for null."""
    lines = []
    for result in results:
        run, when = result.run, result.run.recorded
        before = {"policy": run.policy, "scenario": run.scenario.name}
        after = {"seconds": run.seconds, "recorded": when and when.date, "error": run.error}
        values = finite({**before, **line(result.entry), **after, "warnings": " | ".join(run.warnings)})
        lines.append({name: _escaped(value) for name, value in values.items()})
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(lines[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return text.getvalue()


def _escaped(value: Any) -> Any:
    """Return a cell that a spreadsheet does not interpret as a formula."""
    return f"'{value}" if isinstance(value, str) and value.startswith(("=", "+", "-", "@")) else value
