"""A page for each frozen suite, docs/results/SUITE.md: all policies, regime by regime."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from baselines.evaluation.report.columns import Column, ranked, used
from baselines.evaluation.report.numbers import Entry
from baselines.evaluation.score import OPTIMUM_POLICY, ORACLE
from baselines.tools.figure_style import COLOURS, MARKERS, panels, styled, to_png
from research.lower_bounds import bound
from research.pages import table
from research.results.collection import ROUNDING, Results, better_than, results_of
from research.results.navigation import navigation

_LEFT_OUT = ("tail_rmse_m.median", "tail_rmse_m.p95", "capped.mean", "error_ratio", "settling_s", "saturation")
"""Columns of the report that the page does not show; results.csv of an evaluation has them."""
LOWEST = -1.0
"""Score below which a point is drawn at the edge, its value beside it."""
WHAT = {
    "benchmark-v2": "The disturbances that agents are trained on, drawn from other seeds.",
    "ood-v1": "Disturbances outside of the ranges that agents are trained in.",
    "unmodelled-v1": "Sensor and actuator faults that no controller models.",
    "deep-v1": "Position fixes are rare; in between the position is estimated by dead reckoning.",
    "sealed-v1": "Worlds that were drawn from a secret and opened once all policies were frozen.",
}


def context(page: str) -> dict[str, Any]:
    """Return the values of the template of a suite's page."""
    name = page.rpartition("/")[2]
    results = results_of(name)
    return {"template": "suite", "name": name, **(_context(results) if results else {"regimes": []})}


def figures(page: str) -> dict[str, bytes]:
    """Return the figures of a suite's page as PNG by name."""
    name = page.rpartition("/")[2]
    results = results_of(name)
    if results is None:
        return {}
    with styled():
        return {f"results-{name}-scores.png": to_png(score_figure(results))}


def _context(results: Results) -> dict[str, Any]:
    suite = results.suite
    regimes = list(dict.fromkeys(entry.place for entry in results.pooled))
    dates = sorted({run.recorded.date for run in results.runs if run.recorded is not None})
    return {
        "what": WHAT[suite.name],
        "suite": suite,
        "episodes": sum(len(cell.episodes) for cell in suite.cells),
        "dates": " and ".join(dates),
        "regimes": [(regime, _regime(results, regime)) for regime in regimes],
        "bound": _bound(results),
        "navigation": "\n\n".join(navigation(results, regimes)).replace("### ", "## "),
    }


def _regime(results: Results, regime: str) -> str:
    entries = ranked([entry for entry in results.pooled if entry.place == regime])
    columns: Sequence[Column] = [column for column in used(entries) if column.key not in _LEFT_OUT]
    rows = [[f"`{entry.policy}`", *(column.text(entry) for column in columns)] for entry in entries]
    return table(["policy", *(column.heading for column in columns)], rows)


def _bound(results: Results) -> str:
    """Return what the full-information optimum leaves to gain, and which policy is better than it."""
    if OPTIMUM_POLICY not in results.tails:
        return f"`{OPTIMUM_POLICY}` is not recorded yet."
    least, most = (1e3 * end(results.tails[OPTIMUM_POLICY].values()) for end in (min, max))
    beaten = [(c, p) for c, p, gain in better_than(OPTIMUM_POLICY, results) if gain > ROUNDING]
    names = ", ".join(f"`{policy}` in `{case}`" for case, policy in beaten) or "none"
    first = len(results.suite.cells) - len({case for case, _, _ in better_than(ORACLE, results)})
    counts = bound.optimum_counts()
    tried = {cell.scenario.name for cell in results.suite.cells} <= set(counts)
    held_out = f" On held-out episodes of these cases: {bound.in_words(counts)}." if tried else ""
    return (
        f"`{OPTIMUM_POLICY}`, the full-information optimum, knows everything in advance and optimises its commands "
        f"over the whole episode. Its mean error is {least:.3f} to {most:.3f} mm, case by case. Policies that "
        f"are better by more than the {1e3 * ROUNDING:g} mm to which it is solved: {names}. Of all other policies "
        f"`{ORACLE}` has the smallest mean error in {first} of {len(results.suite.cells)} cases.{held_out}"
    )


def score_figure(results: Results) -> Figure:
    """Return the pooled scores with their intervals, best policy first, one colour for each regime."""
    by_policy: dict[str, list[Entry]] = {}
    for entry in results.pooled:
        by_policy.setdefault(entry.policy, []).append(entry)
    order = sorted(by_policy, key=lambda policy: -np.mean([_mean(entry) for entry in by_policy[policy]]))
    regimes = list(dict.fromkeys(entry.place for entry in results.pooled))
    figure, [[ax]] = panels(1, 1, (7.2, 0.9 + 0.3 * len(order)))
    for value in (0.0, 1.0):
        ax.axvline(value, color="0.5", linewidth=0.8)
    for i, policy in enumerate(order):
        for entry in by_policy[policy]:
            k = regimes.index(entry.place)
            _point(ax, i + 0.28 * (k - 0.5 * (len(regimes) - 1)), entry, k)
    ax.set_yticks(range(len(order)), order)
    ax.set_ylim(len(order) - 0.4, -0.6)
    ax.set_xlim(LOWEST - 0.25, 1.1)
    ax.set_xlabel(f"score: 0 the expert, 1 {results.suite.anchors.one}; errors pooled over cases, 95 % intervals")
    ax.grid(visible=False, axis="y")
    looks = [Line2D([], [], label=r, color=COLOURS[k], marker=MARKERS[k], linestyle="") for k, r in enumerate(regimes)]
    ax.legend(handles=looks, loc="upper left", ncols=len(regimes), bbox_to_anchor=(0.0, 1.1), borderaxespad=0.0)
    return figure


def _mean(entry: Entry) -> float:
    return entry.score.mean if entry.score and math.isfinite(entry.score.mean) else -math.inf


def _point(ax: Axes, y: float, entry: Entry, k: int) -> None:
    mean = _mean(entry)
    if mean < LOWEST:
        text = "" if math.isinf(mean) else f"{mean:.1f}"
        ax.plot(LOWEST, y, color=COLOURS[k], marker="<", markersize=4, linestyle="")
        ax.text(LOWEST - 0.03, y, text, ha="right", va="center", fontsize=6.5, color=COLOURS[k])
        return
    if entry.score is not None and math.isfinite(entry.score.ci95[0]):
        ax.plot(np.maximum(entry.score.ci95, LOWEST), [y, y], color=COLOURS[k], linewidth=1.6)
    ax.plot(mean, y, color=COLOURS[k], marker=MARKERS[k], markersize=4.5, linestyle="")
