"""report.html: the evaluation as one page, with tables that need no script and charts that one can play with."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from baselines.evaluation.report.columns import Column, definitions, failures_text, ranked, used
from baselines.evaluation.report.numbers import Entry, Result, recordings
from baselines.evaluation.report.page import mixed, render_report
from baselines.evaluation.report.page_data import at_first, by_scenario, look_of, page_data
from baselines.evaluation.request import Request
from baselines.evaluation.score import EXPERT, FORESIGHTED, Score, fixed, fixed_ends, score_text, speed_range_of
from baselines.tools.figure_style import look
from baselines.tools.files import versions

_FIRST = ("score", "failed", "steady_rmse", "effort", "smoothness", "decision_ms", "settling", "saturation", "capped")
"""The columns in the order in which a page has them, by the beginning of their keys; the others come behind."""
_LEAST = -0.2
"""Score at the left end of the intervals that are drawn in the leaderboard."""


@dataclass(frozen=True)
class TableCell:
    """A cell of a table: its text, and what it is sorted by."""

    text: str
    key: float | str


@dataclass(frozen=True)
class _Line:
    """A line of a table of policies."""

    policy: str
    mark: str  # behind the name: a star where the row was recorded
    look: int | None  # which of the page's looks; None where it failed
    colour: str
    shown: bool  # whether the charts show it at first
    cells: list[TableCell]
    interval: dict[str, float] | None  # of the score, see `_place`
    failed: bool


@dataclass(frozen=True)
class _Board:
    """The policies of a regime or in a scenario, the best first."""

    place: str
    lead: str  # a sentence about the best
    columns: list[Column]
    lines: list[_Line]
    zero_one: tuple[float, float] | None  # where the scores 0 and 1 are in the intervals


def report_html(request: Request, results: Sequence[Result], pooled: Sequence[Entry]) -> str:
    """Return the text of report.html."""
    episodes = sum(len(cell.episodes) for cell in request.cells)
    counted = f"{episodes} episodes of each policy"
    policies = list(dict.fromkeys(r.run.policy for r in results if r.entry.summary is not None))
    shown = at_first([r for r in results if r.entry.summary is not None], pooled)
    scored = any(entry.score for entry in pooled)
    lone = [
        r.entry
        for r in results
        if not scored or speed_range_of(r.run.scenario.name) not in {entry.place for entry in pooled}
    ]
    return render_report(
        "report.html",
        page_data(results, pooled),
        ("report.js", "player.js"),
        title=request.suite or _listed([cell.scenario.name for cell in request.cells]),
        looks=[look_of(policy, policies) for policy in policies],
        count=len({r.run.policy for r in results}),
        command=request.command,
        setting=f"{_plural(len(request.cells), 'scenario')}, {counted}, seed {request.options.seed}",
        hash=request.hash,
        versions=", ".join(f"{name} {version}" for name, version in versions().items()),
        boards=_boards([*(pooled if scored else ()), *lone], policies, shown),
        maps=_maps(results, policies) if scored else [],
        scenarios=[
            {"name": scenario.name, "board": _board(scenario.name, [r.entry for r in own], policies, shown)}
            for scenario, own in by_scenario(results)
        ],
        recorded=recordings(results),
        failed=[f"{r.run.policy} in {r.run.scenario.name}: {r.run.error}" for r in results if r.run.error],
        notes=list(dict.fromkeys((*request.notes, *(f"{r.run.policy}: {t}" for r in results for t in r.run.warnings)))),
        definitions=definitions(),
    )


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= 3 else f"{names[0]}, {names[1]} and {len(names) - 2} more scenarios"


def _plural(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _boards(entries: Sequence[Entry], policies: Sequence[str], shown: set[str]) -> list[_Board]:
    places = dict.fromkeys(entry.place for entry in entries)
    return [_board(place, [e for e in entries if e.place == place], policies, shown) for place in places]


def _board(place: str, entries: Sequence[Entry], policies: Sequence[str], shown: set[str]) -> _Board:
    columns, order = sorted(used(entries), key=_weight), ranked(entries)
    lines = [_line(entry, columns, policies, shown) for entry in order]
    scale = (_place(0.0), _place(1.0)) if any(line.interval for line in lines) else None
    return _Board(place, _lead(order), columns, lines, scale)


def _weight(column: Column) -> int:
    """Return where a column stands: the score and what is lost first, since a screen may not hold all."""
    return next((i for i, name in enumerate(_FIRST) if column.key.startswith(name)), len(_FIRST))


def _line(entry: Entry, columns: Sequence[Column], policies: Sequence[str], shown: set[str]) -> _Line:
    failed = entry.summary is None
    cells = [TableCell("failed" if failed else column.text(entry), _key(column.of(entry))) for column in columns]
    index = None if failed else policies.index(entry.policy)
    colour = "" if failed else look(entry.policy, policies).colour
    mark = "*" if entry.recorded else ""
    return _Line(entry.policy, mark, index, colour, entry.policy in shown, cells, _interval(entry.score), failed)


def _key(value: Any) -> float | str:
    """Return what a cell is sorted by; "" where there is nothing, which comes last."""
    first = value[0] if isinstance(value, list) else value
    return float(f"{first:.6g}") if isinstance(first, (int, float)) and math.isfinite(first) else ""


def _interval(score: Score | None) -> dict[str, float] | None:
    if score is None or not math.isfinite(score.mean):
        return None
    low, high = score.ci95 if math.isfinite(score.ci95[0]) else (score.mean, score.mean)
    return {"low": _place(low), "high": _place(high), "mean": _place(score.mean), "below": float(score.mean < _LEAST)}


def _place(score: float) -> float:
    """Return the place of a score in the picture of an interval, which is 120 wide."""
    return round(4 + 108 * (min(max(score, _LEAST), 1.06) - _LEAST) / (1.0 - _LEAST), 1)


def _lead(order: Sequence[Entry]) -> str:
    """Return a sentence about the best policy of those that foresee nothing; "" if there is nothing to compare."""
    best = next((e for e in order if e.policy not in FORESIGHTED and e.summary is not None), None)
    if best is None or best.summary is None or len(order) < 2:
        return ""
    failed = f"{failures_text(best.failed, best.summary.episodes)} episodes lost"
    if best.score is None or not math.isfinite(best.score.mean):
        return f"{best.policy} is the nearest: a mean tail error of {best.summary.steady_rmse_m.mean:.3g} m, {failed}."
    ends = f" ({fixed_ends(best.score.ci95)})" if math.isfinite(best.score.ci95[0]) else ""
    if best.policy == EXPERT:
        return f"Nobody is better than the expert, {EXPERT}: {failed}."
    return f"{best.policy} leads with a score of {fixed(best.score.mean)}{ends}, {failed}."


def _maps(results: Sequence[Result], policies: Sequence[str]) -> list[dict[str, Any]]:
    """Return for each regime the scores case by case: a line for each policy, a colour for each score."""
    found: dict[str, dict[str, dict[str, Score | None]]] = {}
    for result in results:
        if (speed_range := speed_range_of(result.run.scenario.name)) is not None:
            own = found.setdefault(speed_range, {}).setdefault(result.run.policy, {})
            own[result.run.scenario.name] = result.entry.score
    maps = []
    for speed_range, by_policy in found.items():
        names = list(dict.fromkeys(name for own in by_policy.values() for name in own))
        order = sorted(by_policy, key=lambda policy: -_mean(by_policy[policy].values()))
        lines = [
            {
                "policy": policy,
                "look": policies.index(policy) if policy in policies else None,
                "cells": [_coloured(by_policy[policy].get(name)) for name in names],
            }
            for policy in order
        ]
        cases = [{"name": name, "case": name.removeprefix(f"{speed_range}-")} for name in names]
        maps.append({"speed_range": speed_range, "cases": cases, "lines": lines})
    return maps


def _mean(scores: Any) -> float:
    """Return the mean of the scores that there are, each at least -1."""
    known = [max(score.mean, -1.0) for score in scores if score and math.isfinite(score.mean)]
    return sum(known) / len(known) if known else -math.inf


def _coloured(score: Score | None) -> dict[str, Any]:
    text = score_text(score, 2)
    if score is None or not math.isfinite(score.mean):
        return {"text": text, "colour": "transparent", "key": ""}
    return {"text": text, "colour": mixed(score.mean), "key": float(f"{score.mean:.6g}")}
