"""Figures of the results page: scores of every policy, pooled and case by case."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from baselines.evaluation.report.numbers import Entry
from baselines.evaluation.score import EXPERT, FORESIGHTED, score_text
from baselines.tools.figure_style import COLOURS, MARKERS, panels, styled, to_png
from research.results.collection import Results

LOWEST = -1.0
"""Score below which a point is drawn at the edge, its value beside it."""


def results_figures(results: Results) -> dict[str, bytes]:
    """Return the figures of a suite as PNG, by name."""
    figures = {}
    for name, draw in (("scores", score_figure), ("cases", case_figure)):
        with styled():
            figures[name] = to_png(draw(results))
    return figures


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


def case_figure(results: Results) -> Figure:
    """Return a map of the scores, a row for each policy and a column for each case; below -1 all are alike."""
    policies = [policy for policy in results.policies if policy not in (EXPERT, *FORESIGHTED)]
    cases = [cell.scenario.name for cell in results.suite.cells]
    scores = [[results.scores[policy].get(case) for case in cases] for policy in policies]
    values = np.array([[math.nan if s is None else s.mean for s in row] for row in scores])
    figure, [[ax]] = panels(1, 1, (1.9 + 0.52 * len(cases), 1.3 + 0.27 * len(policies)))
    image = ax.imshow(np.clip(values, LOWEST, 1.0), aspect="auto", cmap="RdBu", vmin=-1.0, vmax=1.0)
    for (i, j), value in np.ndenumerate(values):
        colour = "white" if abs(value) > 0.7 else "black"
        ax.text(j, i, score_text(scores[i][j], 2), ha="center", va="center", fontsize=7, color=colour)
    ax.set_xticks(range(len(cases)), cases, rotation=40, ha="right", rotation_mode="anchor")
    ax.set_yticks(range(len(policies)), policies)
    ax.grid(visible=False)
    figure.colorbar(image, ax=ax, label="score", shrink=0.9)
    return figure
