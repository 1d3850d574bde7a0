"""Writes report.html: the evaluation as one file, with tables that need no script and interactive charts.

Vega-Lite draws the charts. The page has compressed copies of its code and of the data, which the browser decompresses.
Names come from users, so Jinja2 escapes text, and data are JSON.
"""

from __future__ import annotations

import base64
import gzip
import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean
from typing import Any

import jinja2

from baselines.evaluation.report.columns import NONE, Column, digits, failures_text, ranked, used
from baselines.evaluation.report.numbers import Entry, Result, recordings
from baselines.evaluation.report.page_data import page_data
from baselines.evaluation.request import Request
from baselines.evaluation.score import (
    ERROR_CAPS,
    EXPERT,
    FULL_INFORMATION,
    VEHICLE_MARK,
    Score,
    fixed,
    fixed_ends,
    speed_range_of,
)
from baselines.tools.figure_style import look
from baselines.tools.files import finite, versions
from baselines.tools.programs import COMMAND

WEB = Path(__file__).parent / "web"
"""The templates, the style, the scripts, and the code of Vega-Lite."""
_FIRST = (
    "steady_rmse_m.mean", "to_best_m.mean", "failed", "score.mean", "steady_rmse_m.median", "effort_ratio",
    "smoothness_ratio", "decision_ms",
)  # fmt: skip
"""The first columns of the page, by their keys."""
_LEFT_OUT = (
    "episodes", "steady_rmse_m.ci95", "steady_rmse_m.p95", "steady_rmse_m.cvar95", "score.ci95", "capped.mean",
    "error_ratio", "settling_s", "saturation",
)  # fmt: skip
"""Columns that the page does not have, since its tables would be wider than a screen; results.csv has all columns."""
_LEAST = -0.2
"""Score at the left end of the intervals in the leaderboard."""
_WORST, _MIDDLE, _BEST = (217, 128, 50), (250, 250, 248), (60, 130, 190)  # colours of -1, 0 and 1


def report_html(request: Request, results: Sequence[Result], pooled: Sequence[Entry]) -> str:
    """Return the text of report.html, in which policies of files have short names."""
    short = short_names([result.run.policy for result in results])
    results = [
        Result(replace(r.run, policy=short[r.run.policy]), replace(r.entry, policy=short[r.entry.policy]))
        for r in results
    ]
    pooled = [replace(entry, policy=short[entry.policy]) for entry in pooled]
    notes = [*(f"{name} is {whole}" for whole, name in short.items() if name != whole), *request.notes]
    notes += [f"{r.run.policy}: {text}" for r in results for text in r.run.warnings]
    done = [result for result in results if result.entry.summary is not None]
    policies = list(dict.fromkeys(result.run.policy for result in done))
    data, maps = page_data(done, pooled), _maps(done, policies)
    shown = {policy["name"] for policy in data["policies"] if policy["on"]}
    ranges = {table["speed_range"] for table in maps}
    joint = [entry for entry in pooled if entry.place.partition(VEHICLE_MARK)[0] in ranges]
    scenarios = _boards([result.entry for result in results], policies, shown)
    boards = _boards(joint, policies, shown) if joint else scenarios
    names, episodes = [cell.scenario.name for cell in request.cells], sum(len(c.episodes) for c in request.cells)
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(WEB), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    text = json.dumps(finite(data), separators=(",", ":"), allow_nan=False)
    return environment.get_template("report.html").render(
        style=(WEB / "page.css").read_text(encoding="utf-8"),
        script="\n".join((WEB / f"{name}.js").read_text(encoding="utf-8") for name in ("page", "report", "player")),
        library=_encoded((WEB / "vega.js.gz").read_bytes()),
        data=_encoded(gzip.compress(text.encode(errors="backslashreplace"), mtime=0)),
        looks=data["policies"],
        title=request.suite or (", ".join(names) if len(names) <= 3 else f"{len(names)} scenarios"),
        count=len({result.run.policy for result in results}),
        command=request.command,
        setting=f"scenarios: {len(names)}, episodes of each policy: {episodes}, seed {request.options.seed}",
        hash=request.hash,
        versions=", ".join(map(" ".join, versions().items())),
        boards=boards,
        maps=maps,
        scenarios=scenarios,
        joint=bool(joint),
        recorded=recordings(results),
        failed=[f"{r.run.policy} in {r.run.scenario.name}: {r.run.error}" for r in results if r.run.error],
        notes=list(dict.fromkeys(notes)),
        definitions={c.heading: c.definition for b in (*boards, *scenarios) for c in sorted(b["columns"], key=_order)},
        in_space=any(cell.scenario.vertical for cell in request.cells),
    )


def short_names(policies: Sequence[str]) -> dict[str, str]:
    """Return names without the folders that they need not have to differ, by name."""
    parts = {name: [name] if name.startswith(COMMAND) else name.split("/") for name in policies}
    found = {}
    for name, own in parts.items():
        others = [other for other in parts.values() if other != own]
        k = next((k for k in range(1, len(own)) if all(other[-k:] != own[-k:] for other in others)), len(own))
        found[name] = f"{own[-k]}/.../{own[-1]}" if k > 2 else "/".join(own[-k:])
    return found


def _encoded(content: bytes) -> str:
    return base64.b64encode(content).decode("ascii")


def _boards(entries: Sequence[Entry], policies: Sequence[str], shown: set[str]) -> list[dict[str, Any]]:
    """Return the table of the policies of each speed range or scenario, the best first."""
    boards = []
    for place in dict.fromkeys(entry.place for entry in entries):
        order = ranked([entry for entry in entries if entry.place == place])
        columns = sorted((column for column in used(order) if column.key not in _LEFT_OUT), key=_order)
        lines = [
            {
                "policy": entry.policy,
                "mark": "*" if entry.recorded else "",
                "look": None if entry.summary is None else policies.index(entry.policy),
                "colour": look(entry.policy, policies).colour if entry.policy in policies else "",
                "shown": entry.policy in shown,
                "cells": [_cell(column, entry) for column in columns],
                "interval": _interval(entry.score),
                "failed": entry.summary is None,
            }
            for entry in order
        ]
        ends = (_x_of(0.0), _x_of(1.0)) if any(line["interval"] for line in lines) else None
        boards.append({"place": place, "lead": _lead(order), "columns": columns, "lines": lines, "zero_one": ends})
    return boards


def _order(column: Column) -> int:
    """Return the sort key of a column: those of `_FIRST` before the others."""
    return _FIRST.index(column.key) if column.key in _FIRST else len(_FIRST)


def _cell(column: Column, entry: Entry) -> dict[str, Any]:
    """Return the text of a cell and its sort key; a missing value has "", which is sorted to the end."""
    value = column.of(entry)
    first = value[0] if isinstance(value, list) else value
    key = float(f"{first:.6g}") if isinstance(first, (int, float)) and math.isfinite(first) else ""
    return {"text": "failed" if entry.summary is None else column.text(entry), "key": key}


def _interval(score: Score | None) -> dict[str, float] | None:
    """Return the drawing of a score with its interval, None if there is none."""
    if score is None or not math.isfinite(score.mean):
        return None
    low, high = score.ci95 if math.isfinite(score.ci95[0]) else (score.mean, score.mean)
    return {"low": _x_of(low), "high": _x_of(high), "mean": _x_of(score.mean), "below": float(score.mean < _LEAST)}


def _x_of(score: float) -> float:
    """Return the x coordinate of a score in the drawing of an interval, whose width is 120."""
    return round(4 + 108 * (min(max(score, _LEAST), 1.06) - _LEAST) / (1.0 - _LEAST), 1)


def _lead(order: Sequence[Entry]) -> str:
    """Return a sentence about the best policy that is not in `FULL_INFORMATION`; "" with fewer than two policies."""
    best = next((entry for entry in order if entry.policy not in FULL_INFORMATION), None)
    if best is None or best.summary is None or len(order) < 2:
        return ""
    failures = f"failures: {failures_text(best.failed, best.summary.episodes)}"
    if best.score is None or not math.isfinite(best.score.mean):
        error = f"{best.summary.steady_rmse_m.mean:.3g} m"
        return f"{best.policy} has the smallest mean steady-state error: {error}; {failures}."
    if best.policy == EXPERT:
        return f"No policy is better than the expert, {EXPERT}; {failures}."
    ends = f" ({fixed_ends(best.score.ci95)})" if math.isfinite(best.score.ci95[0]) else ""
    return f"{best.policy} has the best score: {fixed(best.score.mean)}{ends}; {failures}."


def _maps(results: Sequence[Result], policies: Sequence[str]) -> list[dict[str, Any]]:
    """Return the table of errors by policy and case of each speed range with several cases, with cell colours."""
    errors = {
        (r.run.policy, r.run.scenario.name): r.entry.summary.steady_rmse_m.mean for r in results if r.entry.summary
    }
    maps = []
    for speed_range in ERROR_CAPS:
        cases = [name for name in dict.fromkeys(name for _, name in errors) if speed_range_of(name) == speed_range]
        if len(cases) < 2:
            continue
        least = [
            min((e for (p, name), e in errors.items() if name == case and p not in FULL_INFORMATION), default=0.0)
            for case in cases
        ]
        lines, means = [], {}
        for i, policy in enumerate(policies):
            row = [(errors.get((policy, case), math.nan), best) for case, best in zip(cases, least, strict=True)]
            if ratios := [_log_ratio(error, best) for error, best in row if not math.isnan(error)]:
                means[policy] = fmean(ratios)
                lines.append({"policy": policy, "look": i, "cells": [_coloured(*cell) for cell in row]})
        lines.sort(key=lambda line: means[str(line["policy"])])
        heads = [{"name": name, "case": name.removeprefix(f"{speed_range}-")} for name in cases]
        maps.append({"speed_range": speed_range, "cases": heads, "lines": lines})
    return maps


def _log_ratio(error: float, least: float) -> float:
    """Return the logarithm, to base 2, of an error over the least error in the same scenario."""
    return math.log2(error / least) if error > 0 and least > 0 else 0.0


def _coloured(error: float, least: float) -> dict[str, Any]:
    """Return a cell with an error [m]: blue for the least error, white for twice as much, orange from four times on."""
    if not math.isfinite(error):
        return {"text": NONE, "colour": "transparent", "key": ""}
    share = min(max(1.0 - _log_ratio(error, least), -1.0), 1.0)
    end = _BEST if share > 0 else _WORST
    colour = (round(a + (b - a) * abs(share)) for a, b in zip(_MIDDLE, end, strict=True))
    return {"text": digits(3)(error), "colour": "#{:02x}{:02x}{:02x}".format(*colour), "key": float(f"{error:.6g}")}
