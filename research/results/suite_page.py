"""A page for each frozen suite, docs/results/SUITE.md: all policies, regime by regime."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from baselines.evaluation.report.columns import Column, ranked, used
from baselines.evaluation.score import OPTIMUM_POLICY, ORACLE
from research.lower_bounds import bound
from research.pages import table
from research.results.collection import ROUNDING, Results, better_than, results_of
from research.results.figures import results_figures
from research.results.left import what_is_left
from research.results.navigation import navigation

_LEFT_OUT = ("tail_rmse_m.p95", "capped.mean", "error_ratio", "settling_s", "saturation")
"""Columns of the report that the page does not show; results.csv of an evaluation has them."""
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
    return {f"results-{name}-{kind}.png": png for kind, png in results_figures(results).items()} if results else {}


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
        "left": "\n\n".join(what_is_left(results)),
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
