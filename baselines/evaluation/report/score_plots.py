"""The report in pictures, continued: scores case by case, distributions of the error."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from baselines.evaluation.report.numbers import Result
from baselines.evaluation.report.plots import LEGEND, grid, handles
from baselines.evaluation.score import EXPERT, FORESIGHTED, LARGEST_TAIL, SCALE, regime_of, waters_of
from baselines.tools.figure_style import look, panels


def score_by_case(results: Sequence[Result], policies: Sequence[str]) -> Figure | None:
    """Return the scores in each scenario with their intervals, a panel for each regime; None if there are none."""
    shown = [r for r in results if r.entry.score is not None and r.run.policy not in (EXPERT, *FORESIGHTED)]
    shown = [r for r in shown if r.entry.score is not None and math.isfinite(r.entry.score.mean)]
    if not shown:
        return None
    regimes = list(dict.fromkeys(regime_of(r.run.scenario.name) or "" for r in shown))
    figure, axes = panels(1, len(regimes), (max(5.0, 4.6 * len(regimes)), 4.4))
    for ax, regime in zip(axes[0], regimes, strict=True):
        _scores(ax, regime, [r for r in shown if (regime_of(r.run.scenario.name) or "") == regime], policies)
    named = [policy for policy in policies if any(r.run.policy == policy for r in shown)]
    figure.supxlabel(f"score ({SCALE}), 95 % interval; below -1 not shown", fontsize=9)
    figure.legend(handles=handles(named, policies, markers=True), **LEGEND)
    return figure


def _scores(ax: Axes, regime: str, shown: Sequence[Result], policies: Sequence[str]) -> None:
    names = list(dict.fromkeys(r.run.scenario.name for r in shown))
    order = list(dict.fromkeys(r.run.policy for r in shown))
    for result in shown:
        assert result.entry.score is not None
        k, i = order.index(result.run.policy), names.index(result.run.scenario.name)
        y = i + 0.7 * ((k + 0.5) / len(order) - 0.5)
        own = look(result.run.policy, policies)
        low, high = (end if math.isfinite(end) else result.entry.score.mean for end in result.entry.score.ci95)
        ax.plot([low, high], [y, y], color=own.colour, linewidth=1.6)
        ax.plot(result.entry.score.mean, y, **own.point)
    for value in (0.0, 1.0):
        ax.axvline(value, color="0.5", linewidth=0.8)
    ax.set_yticks(range(len(names)), [name.removeprefix(f"{regime}-") for name in names])
    ax.set_ylim(len(names) - 0.5, -0.5)
    lowest = min(r.entry.score.mean for r in shown if r.entry.score is not None)
    ax.set_xlim(max(-1.05, min(-0.1, lowest - 0.05)), 1.1)
    ax.set_title(f"{regime} scenarios" if regime else "")
    ax.grid(visible=False, axis="y")


def error_distribution(results: Sequence[Result], policies: Sequence[str]) -> Figure:
    """Return the share of episodes whose tail error is at most x, in each scenario."""
    names = list(dict.fromkeys(r.run.scenario.name for r in results))
    figure, axes = grid(len(names), 1.9, sharey=True)
    for ax, name in zip(axes, names, strict=True):
        for result in results:
            if result.run.scenario.name != name or result.run.measures is None:
                continue
            tail = np.sort(np.maximum(result.run.measures.tail, 1e-9))
            ax.step(
                tail, np.arange(1, len(tail) + 1) / len(tail), where="post", **look(result.run.policy, policies).line
            )
        cap = LARGEST_TAIL.get(waters_of(name) or "")
        if cap is not None:
            ax.axvline(cap, color="0.6", linewidth=0.8, linestyle=":")
        ax.set_xscale("log")
        ax.set_ylim(0, 1.02)
        ax.set_title(name)
    figure.supxlabel("RMS position error after the first third [m]     (dotted: counts as lost)", fontsize=9)
    figure.supylabel("share of the episodes", fontsize=9)
    figure.legend(handles=handles(policies, policies), **LEGEND)
    return figure
