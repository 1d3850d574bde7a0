"""The report in pictures: tail errors, errors over time, trajectories."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.metrics import Track
from baselines.evaluation.report.numbers import Result
from baselines.evaluation.score import regime_of
from baselines.tools.figure_style import COLOURS, look, panels

COLUMNS = 4  # most panels side by side
BAND: dict[str, Any] = {"color": "0.8", "linewidth": 4.0, "solid_capstyle": "round", "zorder": 1}
"""How the reference is drawn below trajectories that cover it."""
LEGEND: dict[str, Any] = {"loc": "outside upper center", "ncols": 4}  # of a figure with several panels


def handles(policies: Sequence[str], all_policies: Sequence[str], markers: bool = False) -> list[Line2D]:
    """Return the legend's entries of some of the policies."""
    looks = {policy: look(policy, all_policies) for policy in policies}
    return [Line2D([], [], label=policy, **(own.point if markers else own.line)) for policy, own in looks.items()]


def tail_error(results: Sequence[Result], policies: Sequence[str]) -> Figure:
    """Return mean tail errors with their intervals, policies side by side, a panel for each regime."""
    groups: dict[str, dict[str, list[Result]]] = {}
    for result in results:
        name = result.run.scenario.name
        groups.setdefault(regime_of(name) or "", {}).setdefault(name, []).append(result)
    widths = [len(scenarios) + 0.6 for scenarios in groups.values()]
    size = (max(5.0, 1.6 + 0.58 * sum(widths)), 4.2)
    figure, [row] = panels(1, len(groups), size, width_ratios=widths, sharey=True)
    for ax, (regime, scenarios) in zip(row, groups.items(), strict=True):
        for i, found in enumerate(scenarios.values()):
            _points(ax, i, found, policies)
        labels = [name.removeprefix(f"{regime}-") for name in scenarios]
        ax.set_xticks(range(len(labels)), labels, rotation=40, ha="right", rotation_mode="anchor")
        ax.set_xlim(-0.6, len(labels) - 0.4)
        ax.set_yscale("log", nonpositive="clip")
        ax.set_title(f"{regime} scenarios" if regime else "")
        ax.grid(visible=False, axis="x")
    row[0].set_ylim(_decades(results))
    row[0].set_ylabel("position error after the first third [m]\nmean of episodes' RMS, 95 % interval")
    figure.legend(handles=handles(policies, policies, markers=True), **LEGEND)
    return figure


def _decades(results: Sequence[Result]) -> tuple[float, float]:
    """Return the powers of ten around all intervals, at least one decade."""
    tails = [result.entry.summary.tail_rmse_m for result in results if result.entry.summary is not None]
    values = [value for tail in tails for value in (tail.mean, *tail.ci95) if value > 0] or [1.0]
    low, high = math.floor(math.log10(min(values))), math.ceil(math.log10(max(values)))
    return 10.0**low, 10.0 ** max(high, low + 1)


def _points(ax: Axes, i: int, found: Sequence[Result], policies: Sequence[str]) -> None:
    """Draw the policies' errors in scenario i around x = i."""
    for result in found:
        assert result.entry.summary is not None
        k, tail = policies.index(result.run.policy), result.entry.summary.tail_rmse_m
        low, high = (value if math.isfinite(value) else tail.mean for value in tail.ci95)
        x = i + 0.6 * ((k + 0.5) / len(policies) - 0.5)
        own = look(result.run.policy, policies)
        ax.plot([x, x], [low, high], color=own.colour, linewidth=1.6)
        ax.plot(x, tail.mean, **own.point)


def _by_scenario(results: Sequence[Result]) -> list[tuple[Scenario, list[Result]]]:
    groups: dict[str, list[Result]] = {}
    for result in results:
        groups.setdefault(result.run.scenario.name, []).append(result)
    return [(found[0].run.scenario, found) for found in groups.values()]


def grid(count: int, height: float, **options: Any) -> tuple[Figure, list[Axes]]:
    """Return a figure with that many axes of a height [inch], the rest of the last row empty."""
    columns = min(COLUMNS, count)
    rows = math.ceil(count / columns)
    figure, axes = panels(rows, columns, (max(5.0, 2.9 * columns), 0.6 + height * rows), **options)
    flat = [ax for row in axes for ax in row]
    for ax in flat[count:]:
        ax.remove()
    return figure, flat[:count]


def error_over_time(results: Sequence[Result], policies: Sequence[str]) -> Figure:
    """Return the position error over time in each scenario: median and 10-90 % band over episodes."""
    groups = _by_scenario(results)
    figure, axes = grid(len(groups), 1.9)
    for ax, (scenario, found) in zip(axes, groups, strict=True):
        t = scenario.control_dt * np.arange(1, scenario.steps + 1)
        for result in found:
            if result.run.bands is None:
                continue
            low, median, high = result.run.bands
            line = look(result.run.policy, policies).line
            ax.fill_between(t, low, high, color=line["color"], alpha=0.18, linewidth=0)
            ax.plot(t, median, **line)
        ax.axvline(scenario.duration / 3, color="0.6", linewidth=0.8, linestyle=":")
        ax.set_yscale("log", nonpositive="clip")
        ax.set_xlim(0, scenario.duration)
        ax.set_title(scenario.name)
    figure.supxlabel("time [s]     (dotted: the tail begins)", fontsize=9)
    figure.supylabel("position error [m], median and 10-90 % of the episodes", fontsize=9)
    seen = {result.run.policy for result in results if result.run.bands is not None}
    figure.legend(handles=handles([p for p in policies if p in seen], policies), **LEGEND)
    return figure


def trajectories(results: Sequence[Result], policies: Sequence[str]) -> Figure:
    """Return the way of each scenario's first episode through the plane, beside its reference."""
    groups = _by_scenario(results)
    figure, axes = grid(len(groups), 2.6)
    for ax, (scenario, found) in zip(axes, groups, strict=True):
        tracks = {r.run.policy: r.run.tracks[0] for r in found if r.run.tracks}
        for policy, track in tracks.items():
            ax.plot(*track.position.T, **look(policy, policies).line)
            ax.plot(*track.position[0], color="0.2", marker="o", markersize=3.5)
        longest = max(tracks.values(), key=lambda track: len(track.reference))
        ax.plot(*longest.reference.T, **BAND)
        _current_arrow(ax, list(tracks.values()))
        ax.set_aspect("equal", adjustable="datalim")
        ax.set_title(scenario.name)
    figure.supxlabel("x [m]     (dot: start; arrow: mean current)", fontsize=9)
    figure.supylabel("y [m]", fontsize=9)
    seen = {result.run.policy for result in results if result.run.tracks}
    lines = handles([p for p in policies if p in seen], policies)
    figure.legend(handles=[Line2D([], [], label="reference", **BAND), *lines], **LEGEND)
    return figure


def _current_arrow(ax: Axes, tracks: Sequence[Track]) -> None:
    """Draw the direction of the mean current into the emptiest corner, its speed beside it; nothing in still water."""
    mean = tracks[0].current.mean(axis=0)
    speed = float(np.hypot(*mean))
    if speed < 1e-6:
        return
    points = np.concatenate([way for track in tracks for way in (track.position, track.reference)])
    low, high = points.min(axis=0), points.max(axis=0)
    within = 0.5 + (points - (low + high) / 2) / (1.1 * (high - low).max())  # in the square that the axes show, about
    corners = np.array([(x, y) for y in (0.12, 0.88) for x in (0.14, 0.86)])
    x, y = max(corners.tolist(), key=lambda corner: float(np.hypot(*(within - corner).T).min()))
    ax.quiver(
        x, y, *(mean / speed), transform=ax.transAxes, angles="uv", pivot="mid", color=COLOURS[4],
        scale=6, width=0.018, zorder=4,
    )  # fmt: skip
    inwards = 0.24 if y < 0.5 else -0.24
    ax.text(x, y + 0.5 * inwards, f"{speed:.2g} m/s", transform=ax.transAxes, ha="center", va="center", fontsize=8)
