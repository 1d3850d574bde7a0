"""The pages docs/results/SUITE.md of the frozen suites: all policies in each speed range."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from auv_gym.scenarios.presets import SPEED_RANGES
from baselines.evaluation.metrics import bootstrap_interval
from baselines.evaluation.report.columns import COLUMNS, Column, ranked
from baselines.evaluation.report.numbers import Entry
from baselines.evaluation.score import EXPERT, OPTIMUM_POLICY, ORACLE, interval_text, score_text
from baselines.tools.figure_style import COLOURS, MARKERS, panels, styled, to_png
from research.pages import table
from research.results.collection import ROUNDING, Results, results_of

_COLUMNS = {
    "steady_rmse_m.mean": ("error [mm]", 1e3),
    "steady_rmse_m.cvar95": ("worst 5 % [mm]", 1e3),
    "score.mean": ("score", 1.0),
    "failed": ("failures", 1.0),
    "effort_ratio": ("effort", 1.0),
    "smoothness_ratio": ("command rate", 1.0),
    "decision_ms": ("time [us]", 1e3),
}
"""Columns of the report on the page, with their headings and factors."""
_DESCRIPTIONS = {
    "benchmark-v2": "The disturbances of the training, drawn from other seeds.",
    "sealed-v2": "Conditions on which most agents were not trained. The episodes were secret until all policies were "
    "frozen. `helm-any` was trained on large initial errors and on outages as long as these.",
}


def context(page: str) -> dict[str, Any]:
    """Return the values of the template of a suite's page."""
    results = results_of(page.rpartition("/")[2])
    dates = sorted({run.recorded.date for run in results.runs if run.recorded is not None})
    return {
        "template": "suite",
        "what": _DESCRIPTIONS[results.suite.name],
        "suite": results.suite,
        "episodes": sum(len(cell.episodes) for cell in results.suite.cells),
        "dates": f"on {dates[0]}" if len(dates) == 1 else f"from {dates[0]} to {dates[-1]}",
        "speed_ranges": [_speed_range(results, speed_range) for speed_range in SPEED_RANGES],
        "zero": EXPERT,
        "one": OPTIMUM_POLICY,
        "oracle": ORACLE,
        **_optimum(results),
    }


def figures(page: str) -> dict[str, bytes]:
    """Return the figure of a suite's page as PNG, by name."""
    results = results_of(page.rpartition("/")[2])
    names = dict.fromkeys(p.replace("-slow", "-*").replace("-cruise", "-*") for p in results.policies)
    with styled():
        return {f"results-{results.suite.name}.png": to_png(error_figure(results, list(names)))}


def _speed_range(results: Results, speed_range: str) -> tuple[str, int, str]:
    """Return the name of a speed range, its number of episodes, and the table of all policies in it."""
    entries = ranked([entry for entry in results.pooled if entry.place == speed_range])
    columns = {"policy": [f"`{entry.policy}`" for entry in entries]}
    for column in COLUMNS:
        if column.key in _COLUMNS:
            heading, factor = _COLUMNS[column.key]
            columns[heading] = [_cell(column, factor, entry) for entry in entries]
    cells = results.suite.cells_in((speed_range,))
    return (
        speed_range,
        sum(len(cell.episodes) for cell in cells),
        table(list(columns), zip(*columns.values(), strict=True)),
    )


def _cell(column: Column, factor: float, entry: Entry) -> str:
    """Return a cell of the table: a score with its interval, a value times a factor, or the text of the report."""
    if column.key == "score.mean":
        digits = 3 if abs(column.of(entry) or 0.0) < 2 else 1
        return f"{score_text(entry.score, digits)} ({interval_text(entry.score, digits)})"
    if factor == 1.0 or entry.summary is None:
        return column.text(entry)
    value = factor * column.of(entry)
    return f"{value:.0f}" if value >= 999.5 else f"{value:.3g}"


def _optimum(results: Results) -> dict[str, Any]:
    """Return the smallest and largest error of the optimum, the policies better than it, and where the oracle leads."""
    errors = [1e3 * case[OPTIMUM_POLICY].steady_rmse.mean() for case in results.cases.values()]
    return {
        "least": f"{min(errors):.3f}",
        "most": f"{max(errors):.3f}",
        "rounding": f"{1e3 * ROUNDING:g}",
        "better": [(c, p) for c, p, gain in results.better_than(OPTIMUM_POLICY) if gain > ROUNDING],
        "oracle_first": len(results.cases) - len({case for case, *_ in results.better_than(ORACLE)}),
    }


def error_figure(results: Results, policies: Sequence[str]) -> Figure:
    """Return the figure of the mean errors of policies with 95 % intervals, the smallest error first.

    Args:
        results: recorded results of a suite.
        policies: names; * stands for the speed range.
    """
    errors = {}
    for name in policies:
        by_speed_range = {r: results.steady_rmses(name.replace("*", r), r) for r in SPEED_RANGES}
        errors[name] = {r: 1e3 * np.concatenate([*cases.values()]) for r, cases in by_speed_range.items() if cases}
    order = sorted(errors, key=lambda name: np.mean([np.log(values.mean()) for values in errors[name].values()]))
    figure, [[ax]] = panels(1, 1, (7.2, 0.8 + 0.17 * len(order)))
    for speed_range, colour, marker in zip(SPEED_RANGES, COLOURS, MARKERS, strict=False):
        rows = [(i, errors[name][speed_range]) for i, name in enumerate(order) if speed_range in errors[name]]
        for i, values in rows:
            ax.plot(bootstrap_interval(values), [i, i], color=colour, linewidth=1.6)
        means = [values.mean() for _, values in rows]
        ax.plot(means, [i for i, _ in rows], color=colour, marker=marker, markersize=4, linestyle="", label=speed_range)
    ax.set_xscale("log")
    ax.set_yticks(range(len(order)), order, fontsize=7)
    ax.set_ylim(len(order) - 0.4, -0.6)
    ax.set_xlabel("mean steady-state error [mm] with 95 % interval")
    ax.legend(loc="upper right")
    return figure
