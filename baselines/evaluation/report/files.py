"""Writes the texts of results.json and results.csv."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from baselines.evaluation.report.columns import line, record
from baselines.evaluation.report.numbers import Entry, Result
from baselines.evaluation.request import Request
from baselines.tools.files import finite, json_text, versions

FORMULA = ("=", "+", "-", "@")
"""Characters that begin a formula in a spreadsheet."""


def results_json(request: Request, results: Sequence[Result], scores: Sequence[Entry]) -> str:
    """Return the text of results.json: strict JSON, with null for numbers that are not finite."""
    content: dict[str, Any] = {
        "suite": request.suite,
        "suite_hash": request.hash,
        "anchors": request.anchors._asdict(),
        "seed": request.options.seed,
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
        "pooled": [{"policy": entry.policy, "speed_range": entry.place, **record(entry)} for entry in scores],
    }
    return json_text(content)


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
    return f"'{value}" if isinstance(value, str) and value.startswith(FORMULA) else value
