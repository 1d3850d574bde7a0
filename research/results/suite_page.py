"""The pages docs/results/SUITE.md of the frozen suites: all policies in each speed range."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from baselines.evaluation.report.columns import COLUMNS, NONE, Column, ranked
from baselines.evaluation.report.numbers import Entry
from baselines.evaluation.score import OPTIMUM_POLICY, ORACLE, interval_text, score_text, speed_range_of
from baselines.tools.figure_style import COLOURS, MARKERS, panels, styled, to_png
from research.pages import table
from research.results.collection import ROUNDING, Results, better_than, results_of
from research.results.navigation import ADDITIONAL, additional_errors, navigation_alone, navigation_part

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
    "ood-v1": "Stronger or different disturbances and other paths than in the benchmark. Some agents were trained in "
    "sheared currents ([Suites](../suites.md#ood-v1)).",
    "unmodelled-v1": "Sensor and actuator faults that most policies do not model.",
    "deep-v1": "Position fixes are rare. Between fixes the position is estimated by dead reckoning.",
    "sealed-v2": "Conditions on which most agents were not trained. The episodes were secret until all policies were "
    "frozen. `helm-any` was trained on large initial errors and on outages as long as these.",
}


def context(page: str) -> dict[str, Any]:
    """Return the values of the template of a suite's page."""
    name = page.rpartition("/")[2]
    return {"template": "suite", "name": name, **_context(results_of(name))}


def figures(page: str) -> dict[str, bytes]:
    """Return the figure of a suite's page as PNG, by name."""
    name = page.rpartition("/")[2]
    with styled():
        return {f"results-{name}.png": to_png(error_figure(results_of(name)))}


def _context(results: Results) -> dict[str, Any]:
    suite = results.suite
    speed_ranges = list(dict.fromkeys(entry.place for entry in results.pooled))
    errors = {speed_range: navigation_alone(results, speed_range) for speed_range in speed_ranges}
    dates = sorted({run.recorded.date for run in results.runs if run.recorded is not None})
    return {
        "what": _DESCRIPTIONS[suite.name],
        "suite": suite,
        "episodes": sum(len(cell.episodes) for cell in suite.cells),
        "dates": f"on {dates[0]}" if len(dates) == 1 else f"from {dates[0]} to {dates[-1]}",
        "speed_ranges": [
            _speed_range(results, speed_range, additional_errors(results, own)) for speed_range, own in errors.items()
        ],
        "bound": _bound(results),
        "navigation": navigation_part(errors),
    }


def _speed_range(results: Results, speed_range: str, additional: Mapping[str, str]) -> tuple[str, int, str]:
    """Return the name of a speed range, its number of episodes, and the table of all policies in it."""
    entries = ranked([entry for entry in results.pooled if entry.place == speed_range])
    columns = {"policy": [f"`{entry.policy}`" for entry in entries]}
    for column in COLUMNS:
        if column.key in _COLUMNS:
            heading, factor = _COLUMNS[column.key]
            columns[heading] = [_cell(column, factor, entry, interval=not additional) for entry in entries]
    if additional:
        columns[ADDITIONAL] = [additional.get(entry.policy, NONE) for entry in entries]
    episodes = sum(
        len(cell.episodes) for cell in results.suite.cells if speed_range_of(cell.scenario.name) == speed_range
    )
    return speed_range, episodes, table(list(columns), zip(*columns.values(), strict=True))


def _cell(column: Column, factor: float, entry: Entry, *, interval: bool) -> str:
    """Return a cell of the table: a score with its interval, a value times a factor, or the text of the report."""
    if column.key == "score.mean" and interval:
        digits = 3 if abs(column.of(entry) or 0.0) < 2 else 1
        return f"{score_text(entry.score, digits)} ({interval_text(entry.score, digits)})"
    if factor == 1.0 or entry.summary is None:
        return column.text(entry)
    value = factor * column.of(entry)
    return f"{value:.0f}" if value >= 999.5 else f"{value:.3g}"


def _bound(results: Results) -> str:
    """Return the paragraph about the full-information optimum and the policies that are better than it."""
    least, most = (1e3 * end(results.steady_rmses[OPTIMUM_POLICY].values()) for end in (min, max))
    beaten = [(c, p) for c, p, gain in better_than(OPTIMUM_POLICY, results) if gain > ROUNDING]
    names = ", ".join(f"`{policy}` in `{case}`" for case, policy in beaten) or "none"
    first = len(results.suite.cells) - len({case for case, _, _ in better_than(ORACLE, results)})
    return (
        f"`{OPTIMUM_POLICY}`, the full-information optimum, knows all disturbances in advance and optimises the\n"
        f"commands of the whole episode. Its mean error is {least:.3f} to {most:.3f} mm, depending on the cell.\n"
        f"Policies with an error smaller by more than {1e3 * ROUNDING:g} mm: {names}.\n"
        f"Of all other policies `{ORACLE}` has the smallest mean error in {first} of {len(results.suite.cells)} cells."
    )


def error_figure(results: Results) -> Figure:
    """Return the figure of the mean errors of all policies with intervals, the smallest error first."""
    by_policy: dict[str, list[Entry]] = {}
    for entry in results.pooled:
        if entry.summary is not None:
            by_policy.setdefault(entry.policy.replace(f"-{entry.place}", "-*"), []).append(entry)
    order = sorted(by_policy, key=lambda policy: np.mean([np.log(_error(entry)) for entry in by_policy[policy]]))
    speed_ranges = list(dict.fromkeys(entry.place for entry in results.pooled))
    figure, [[ax]] = panels(1, 1, (7.2, 0.8 + 0.17 * len(order)))
    for i, policy in enumerate(order):
        for entry in by_policy[policy]:
            k = speed_ranges.index(entry.place)
            ends = 1e3 * np.array(entry.summary.steady_rmse_m.ci95 if entry.summary else ())
            ax.plot(ends, [i, i], color=COLOURS[k], linewidth=1.6)
            ax.plot(_error(entry), i, color=COLOURS[k], marker=MARKERS[k], markersize=4, linestyle="")
    ax.set_xscale("log")
    ax.set_yticks(range(len(order)), order, fontsize=7)
    ax.set_ylim(len(order) - 0.4, -0.6)
    ax.set_xlabel("mean steady-state error [mm] with 95 % interval")
    looks = [
        Line2D([], [], label=r, color=COLOURS[k], marker=MARKERS[k], linestyle="") for k, r in enumerate(speed_ranges)
    ]
    ax.legend(handles=looks, loc="upper right")
    return figure


def _error(entry: Entry) -> float:
    """Return the mean error [mm]."""
    return 1e3 * entry.summary.steady_rmse_m.mean if entry.summary else math.inf
