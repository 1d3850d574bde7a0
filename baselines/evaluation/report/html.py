"""Writes report.html: the evaluation as one page, with tables that need no script and interactive charts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from baselines.evaluation.report.columns import NONE, Column, definitions, digits, failures_text, ranked, used
from baselines.evaluation.report.numbers import Entry, Result, recordings
from baselines.evaluation.report.page import mixed, render_report
from baselines.evaluation.report.page_data import at_first, by_scenario, look_of, page_data
from baselines.evaluation.request import Request
from baselines.evaluation.score import EXPERT, FULL_INFORMATION, VEHICLE_MARK, Score, fixed, fixed_ends, speed_range_of
from baselines.tools.figure_style import look
from baselines.tools.files import versions

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


@dataclass(frozen=True)
class TableCell:
    """A cell of a table: its text and its sort key."""

    text: str
    key: float | str


@dataclass(frozen=True)
class _Line:
    """A line of a table of policies."""

    policy: str
    mark: str  # text after the name: a star for a recorded row
    look: int | None  # index of its look on the page; None if it failed
    colour: str
    shown: bool  # whether the charts show it initially
    cells: list[TableCell]
    interval: dict[str, float] | None  # of the score, see `_x_of`
    failed: bool


@dataclass(frozen=True)
class _Leaderboard:
    """The policies in a speed range or scenario, the best first."""

    place: str
    lead: str  # a sentence about the best policy
    columns: list[Column]
    lines: list[_Line]
    zero_one: tuple[float, float] | None  # x of the scores 0 and 1 in the drawings of intervals


def report_html(request: Request, results: Sequence[Result], pooled: Sequence[Entry]) -> str:
    """Return the text of report.html."""
    episodes = sum(len(cell.episodes) for cell in request.cells)
    counted = f"{episodes} episodes of each policy"
    policies = list(dict.fromkeys(r.run.policy for r in results if r.entry.summary is not None))
    shown = at_first([r for r in results if r.entry.summary is not None], pooled)
    maps = _maps(results, policies)
    joint = [entry for entry in pooled if entry.place.partition(VEHICLE_MARK)[0] in {m["speed_range"] for m in maps}]
    return render_report(
        page_data(results, pooled),
        title=request.suite or _listed([cell.scenario.name for cell in request.cells]),
        looks=[look_of(policy, policies) for policy in policies],
        count=len({r.run.policy for r in results}),
        command=request.command,
        setting=f"{_plural(len(request.cells), 'scenario')}, {counted}, seed {request.options.seed}",
        hash=request.hash,
        versions=", ".join(f"{name} {version}" for name, version in versions().items()),
        boards=_boards(joint or [result.entry for result in results], policies, shown),
        maps=maps,
        scenarios=[
            {"name": scenario.name, "board": joint and _board(scenario.name, [r.entry for r in own], policies, shown)}
            for scenario, own in by_scenario(results)
        ],
        recorded=recordings(results),
        failed=[f"{r.run.policy} in {r.run.scenario.name}: {r.run.error}" for r in results if r.run.error],
        notes=list(dict.fromkeys((*request.notes, *(f"{r.run.policy}: {t}" for r in results for t in r.run.warnings)))),
        definitions=definitions(_LEFT_OUT),
    )


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= 3 else f"{names[0]}, {names[1]} and {len(names) - 2} more scenarios"


def _plural(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _boards(entries: Sequence[Entry], policies: Sequence[str], shown: set[str]) -> list[_Leaderboard]:
    places = dict.fromkeys(entry.place for entry in entries)
    return [_board(place, [e for e in entries if e.place == place], policies, shown) for place in places]


def _board(place: str, entries: Sequence[Entry], policies: Sequence[str], shown: set[str]) -> _Leaderboard:
    columns = sorted((c for c in used(entries) if c.key not in _LEFT_OUT), key=_order)
    order = ranked(entries)
    lines = [_line(entry, columns, policies, shown) for entry in order]
    scale = (_x_of(0.0), _x_of(1.0)) if any(line.interval for line in lines) else None
    return _Leaderboard(place, _lead(order), columns, lines, scale)


def _order(column: Column) -> int:
    """Return the sort key of a column: those of `_FIRST` before the others."""
    return _FIRST.index(column.key) if column.key in _FIRST else len(_FIRST)


def _line(entry: Entry, columns: Sequence[Column], policies: Sequence[str], shown: set[str]) -> _Line:
    failed = entry.summary is None
    cells = [TableCell("failed" if failed else column.text(entry), _key(column.of(entry))) for column in columns]
    index = None if failed else policies.index(entry.policy)
    colour = "" if failed else look(entry.policy, policies).colour
    mark = "*" if entry.recorded else ""
    return _Line(entry.policy, mark, index, colour, entry.policy in shown, cells, _interval(entry.score), failed)


def _key(value: Any) -> float | str:
    """Return the sort key of a cell; a missing value has "", which is sorted to the end."""
    first = value[0] if isinstance(value, list) else value
    return float(f"{first:.6g}") if isinstance(first, (int, float)) and math.isfinite(first) else ""


def _interval(score: Score | None) -> dict[str, float] | None:
    if score is None or not math.isfinite(score.mean):
        return None
    low, high = score.ci95 if math.isfinite(score.ci95[0]) else (score.mean, score.mean)
    return {"low": _x_of(low), "high": _x_of(high), "mean": _x_of(score.mean), "below": float(score.mean < _LEAST)}


def _x_of(score: float) -> float:
    """Return the x coordinate of a score in the drawing of an interval, whose width is 120."""
    return round(4 + 108 * (min(max(score, _LEAST), 1.06) - _LEAST) / (1.0 - _LEAST), 1)


def _lead(order: Sequence[Entry]) -> str:
    """Return a sentence about the best policy that is not in `FULL_INFORMATION`; "" with fewer than two policies."""
    best = next((e for e in order if e.policy not in FULL_INFORMATION and e.summary is not None), None)
    if best is None or best.summary is None or len(order) < 2:
        return ""
    failures = f"failures: {failures_text(best.failed, best.summary.episodes)}"
    if best.score is None or not math.isfinite(best.score.mean):
        error = f"{best.summary.steady_rmse_m.mean:.3g} m"
        return f"{best.policy} has the smallest mean steady-state error: {error}; {failures}."
    ends = f" ({fixed_ends(best.score.ci95)})" if math.isfinite(best.score.ci95[0]) else ""
    if best.policy == EXPERT:
        return f"No policy is better than the expert, {EXPERT}; {failures}."
    return f"{best.policy} has the best score: {fixed(best.score.mean)}{ends}; {failures}."


def _maps(results: Sequence[Result], policies: Sequence[str]) -> list[dict[str, Any]]:
    """Return the table of errors by policy and case of each speed range with several cases, with cell colours."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for result in results:
        if (speed_range := speed_range_of(result.run.scenario.name)) is not None and result.entry.summary is not None:
            error = result.entry.summary.steady_rmse_m.mean
            found.setdefault(speed_range, {}).setdefault(result.run.scenario.name, {})[result.run.policy] = error
    maps = []
    for speed_range, by_case in found.items():
        if len(by_case) < 2:
            continue
        least = {
            name: min((e for p, e in own.items() if p not in FULL_INFORMATION), default=0)
            for name, own in by_case.items()
        }
        logs = {
            policy: [_log_ratio(own[policy], least[name]) for name, own in by_case.items() if policy in own]
            for policy in policies
        }
        order = sorted(
            (policy for policy in policies if logs[policy]), key=lambda policy: sum(logs[policy]) / len(logs[policy])
        )
        lines = [
            {
                "policy": policy,
                "look": policies.index(policy),
                "cells": [_coloured(own.get(policy), least[name]) for name, own in by_case.items()],
            }
            for policy in order
        ]
        cases = [{"name": name, "case": name.removeprefix(f"{speed_range}-")} for name in by_case]
        maps.append({"speed_range": speed_range, "cases": cases, "lines": lines})
    return maps


def _log_ratio(error: float, least: float) -> float:
    """Return the logarithm, to base 2, of an error over the least error in the same scenario."""
    return math.log2(error / least) if error > 0 and least > 0 else 0.0


def _coloured(error: float | None, least: float) -> dict[str, Any]:
    """Return a cell with an error [m]: blue for the least error, white for twice as much, orange from four times on."""
    if error is None or not math.isfinite(error):
        return {"text": NONE, "colour": "transparent", "key": ""}
    return {"text": digits(3)(error), "colour": mixed(1.0 - _log_ratio(error, least)), "key": float(f"{error:.6g}")}
