"""The pages docs/results/SUITE.md: the main agent beside the best controller by cell, all policies, training seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from baselines.evaluation.report.columns import failures_text
from baselines.evaluation.report.numbers import Entry
from baselines.evaluation.score import EXPERT, OPTIMUM_POLICY, ORACLE, capped, count_failures, error_cap
from baselines.tools.figure_style import COLOURS, MARKERS, panels, styled, to_png
from research.pages import table, with_interval
from research.results import error_only
from research.results.collection import ROUNDING, Results, results_of
from research.trainings.seed_runs import SEED_RUNS, SeedRuns, trained
from research.trainings.trainings import ABLATIONS

DESCRIPTIONS = {
    "benchmark-v3": "The disturbances of the training from other seeds, and two fixed levels of position noise, of "
    "which that of an ultra-short baseline (`usbl`) is beyond the training.",
    "hard-v1": "Storms with one difficulty each: velocities that fail, correlated noise, dead reckoning, outages, "
    "sharp turns, slow actuators, faults, far starts, other vehicles, other speeds, long missions.",
    "space-v1": "Motion in space: the disturbances of the training from other seeds, and two fixed levels of position "
    "noise, of which that of an ultra-short baseline (`usbl`) is beyond the training.",
    "sealed-v3": "Conditions that were secret until all policies were frozen.",
}
"""What each suite with such a page tests."""
_POLICY_HEADS = ("policy", "error / best", "failures", "effort", "command rate", "time [us]")
_SEED_HEADS = ("training", "seeds", "error / best", "failures", "command rate")


def context(page: str) -> dict[str, Any]:
    """Return the values of the template of a suite's page."""
    results = results_of(page.rpartition("/")[2])
    dates = sorted({run.recorded.date for run in results.runs if run.recorded is not None})
    name = results.suite.name
    agents = trained(name) if (SEED_RUNS / f"{name}.npz").exists() else {}
    others = {key: runs for key, runs in agents.items() if key not in (error_only.NAME, *ABLATIONS)}
    short = {change: agents[key] for key, (change, _) in ABLATIONS.items() if key in agents}
    ablations = [[change, *row[2:]] for change, row in zip(short, seed_rows(results, short), strict=True)]
    return {
        "template": "suite",
        "what": DESCRIPTIONS[name],
        "suite": results.suite,
        "episodes": sum(len(cell.episodes) for cell in results.suite.cells),
        "dates": f"on {dates[0]}" if len(dates) == 1 else f"from {dates[0]} to {dates[-1]}",
        "agent": results.agent,
        "controllers": ", ".join(map("`{}`".format, results.controllers)),
        "headline": headline(results),
        "cells": table(cell_heads(results.agent), cell_rows(results)),
        "speed_ranges": [(r, table(_POLICY_HEADS, policy_rows(results, r))) for r in results.speed_ranges],
        "seeds": table(_SEED_HEADS, seed_rows(results, others)) if others else "",
        "ablations": table(("change", *_SEED_HEADS[2:]), ablations) if ablations else "",
        "zero": EXPERT,
        **(_optimum(results) if OPTIMUM_POLICY in results.policies else {"one": ""}),
    }


def figures(page: str) -> dict[str, bytes]:
    """Return the figure of a suite's page as PNG, by name."""
    results = results_of(page.rpartition("/")[2])
    names = dict.fromkeys(p.replace("-slow", "-*").replace("-cruise", "-*") for p in results.policies)
    with styled():
        return {f"results-{results.suite.name}.png": to_png(error_figure(results, list(names)))}


def headline(results: Results) -> dict[str, str]:
    """Return the ratio of the agent to the best controllers over all cells, the worst cell, and the failures."""
    errors = results.errors(results.agent)
    cells = {cell: results.to_best({cell: own}) for cell, own in errors.items()}
    worst = max(cells, key=lambda cell: cells[cell].mean)
    own, best = (
        sum(_failed(results, p or best, cell) for cell, best in results.best.items()) for p in (results.agent, "")
    )
    return {
        "agent": results.agent,
        "ratio": with_interval(results.to_best(errors)),
        "worst": f"{with_interval(cells[worst])} in `{worst}`",
        "failed": f"{own} (best controllers: {best}) of {sum(map(len, errors.values()))}",
        "behind": ", ".join(f"`{cell}`" for cell, ratio in cells.items() if ratio.ci95[0] > 1) or "none",
    }


def _failed(results: Results, policy: str, cell: str) -> int:
    return count_failures(results.cases[cell][policy], error_cap(cell))


def cell_heads(agent: str) -> tuple[str, ...]:
    """Return the heads of the columns of `cell_rows`."""
    mine = f"`{agent}`"
    own = f"{mine} [mm]", f"{mine} / best", f"failures: best, {mine}"
    return "cell", "best controller", "its error [mm]", *own, "command rate / best"


def cell_rows(results: Results) -> list[list[str]]:
    """Return a row for each cell: the best controller and the agent."""
    rows = []
    for cell, best in results.best.items():
        case, both = results.cases[cell], (best, results.agent)
        theirs, mine = (capped(case[policy], error_cap(cell)) for policy in both)
        errors = [f"{1e3 * own.mean():.3g}" for own in (theirs, mine)]
        ratio = with_interval(results.to_best({cell: mine}))
        failed = ", ".join(str(_failed(results, policy, cell)) for policy in both)
        rates = [case[policy].smoothness.mean() for policy in both]
        rows.append([f"`{cell}`", f"`{best}`", *errors, ratio, failed, f"{rates[1] / rates[0]:.2f}"])
    return rows


def entry_of(results: Results, policy: str, speed_range: str) -> Entry:
    """Return the pooled results of a policy in a speed range; * in its name stands for the speed range."""
    wanted = policy.replace("*", speed_range), speed_range
    return next(entry for entry in results.pooled if (entry.policy, entry.place) == wanted)


def policy_rows(results: Results, speed_range: str) -> list[list[str]]:
    """Return a row for each policy that ran in all cells of a speed range, the smallest error first."""
    ratios = {
        e.policy: results.to_best(results.errors(e.policy, speed_range))
        for e in results.pooled
        if e.place == speed_range
    }
    rows = []
    for policy in sorted(ratios, key=lambda name: ratios[name].mean):
        entry = entry_of(results, policy, speed_range)
        failed = failures_text(entry.failed, entry.summary.episodes if entry.summary else 0)
        rates = f"{entry.effort_ratio:.2f}", f"{entry.smoothness_ratio:.2f}"
        rows.append(
            [f"`{policy}`", with_interval(ratios[policy]), failed, *rates, f"{1e6 * entry.decision_seconds:.2g}"]
        )
    return rows


def seed_rows(results: Results, agents: Mapping[str, SeedRuns]) -> list[list[str]]:
    """Return a row for each training, with the interval over training seeds and episodes."""
    rows = []
    for name, seeds in agents.items():
        base = sum(results.cases[cell][EXPERT].smoothness.mean() for cell in seeds.measures) / len(seeds.measures)
        rows.append([
            f"`{name}`",
            str(seeds.seeds),
            with_interval(results.to_best(seeds.capped)),
            failures_text(seeds.failed, seeds.episodes),
            f"{seeds.smoothness / base:.2f}",
        ])  # fmt: skip
    return rows


def _optimum(results: Results) -> dict[str, Any]:
    """Return the smallest and largest error of the optimum, the policies better than it, and where the oracle leads."""
    errors = [1e3 * case[OPTIMUM_POLICY].steady_rmse.mean() for case in results.cases.values()]
    return {
        "one": OPTIMUM_POLICY,
        "oracle": ORACLE if ORACLE in results.policies else "",
        "least": f"{min(errors):.3f}",
        "most": f"{max(errors):.3f}",
        "rounding": f"{1e3 * ROUNDING:g}",
        "better": [(c, p) for c, p, gain in results.better_than(OPTIMUM_POLICY) if gain > ROUNDING],
        "oracle_first": len(results.cases) - len({case for case, *_ in results.better_than(ORACLE)}),
    }


def error_figure(results: Results, policies: Sequence[str]) -> Figure:
    """Return the figure of errors over those of the best controllers with 95 % intervals, the smallest first.

    Args:
        results: recorded results of a suite.
        policies: names; * stands for the speed range.
    """
    ratios = {
        name: {r: results.to_best(errors) for r in results.speed_ranges if (errors := results.errors(name, r))}
        for name in policies
    }
    order = sorted(ratios, key=lambda name: sum(ratio.mean for ratio in ratios[name].values()) / len(ratios[name]))
    figure, [[ax]] = panels(1, 1, (7.2, 0.8 + 0.17 * len(order)))
    for speed_range, colour, marker in zip(results.speed_ranges, COLOURS, MARKERS, strict=False):
        rows = [(i, ratios[name][speed_range]) for i, name in enumerate(order) if speed_range in ratios[name]]
        for i, ratio in rows:
            ax.plot(ratio.ci95, [i, i], color=colour, linewidth=1.6)
        means, places = [ratio.mean for _, ratio in rows], [i for i, _ in rows]
        ax.plot(means, places, color=colour, marker=marker, markersize=4, linestyle="", label=speed_range)
    ax.set_xscale("log")
    ax.set_yticks(range(len(order)), order, fontsize=7)
    ax.set_ylim(len(order) - 0.4, -0.6)
    ax.set_xlabel("error over that of the best controller in each cell, with 95 % interval")
    ax.legend(loc="upper right")
    return figure
