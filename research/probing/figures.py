"""The figures about what policies know."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from baselines.tools.figure_style import look, panels, styled, to_png
from research.probing import training_range
from research.probing.adaptation import LARGEST
from research.probing.changes import CHANGES, SEAS
from research.probing.extrapolation import parameters_of

_ORDER = ("helm", "nmpc", "integral-normalised", "backstepping")
"""Policies in the order of their looks; others come behind."""
_LABELS = {
    "instant": "one instant", "untrained": "untrained network", "inputs": "network's inputs", "ekf": "Kalman filter",
    "memory": "network's memory",
}  # fmt: skip
"""The sources of a probe, in short."""
_SHORT = {
    "m11": "mass m11", "m22": "mass m22", "m33": "inertia m33", "d11": "drag d11", "d22": "drag d22", "d33": "drag d33",
    "drag": "surge drag at its speed", "quadratic": "quadratic drag", "lag": "actuators' lag", "V_u": "current along",
    "V_v": "current across", "X": "wave force X", "Y": "wave force Y", "N": "wave moment N",
}  # fmt: skip
"""What a probe is asked, in short."""
IN_TIME = ("lag", "m33", "drag", "m11", "V_v", "Y")
"""Targets whose course over time is drawn."""
PAIRS = (("mass", "munk"), ("surge", "thrust"), ("sway", "yaw"), ("torque", "lag"))
"""Ratios that are drawn against each other."""


def probe_figure(record: Mapping[str, Any]) -> bytes:
    """Return the figure about an agent's memory, a column for each regime: at the end of a storm, and on the way."""
    size = (2.0 + 4.0 * len(record), 9.4)
    figure, axes = panels(2, len(record), size, sharex="row", sharey="row", gridspec_kw={"height_ratios": (5, 3)})
    with styled():
        for column, (regime, cases) in enumerate(record.items()):
            _sources(axes[0][column], regime, cases["storm"])
            _courses(axes[1][column], cases["storm"])
        axes[0][0].invert_yaxis()
        axes[1][0].set_ylabel("R^2 from the network's memory")
        figure.legend(*axes[0][0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
        _below(figure, axes[1][0], 3)
    return to_png(figure)


def _sources(axes: Axes, regime: str, of: Mapping[str, Any]) -> None:
    targets = of["targets"]
    for i, (source, label) in enumerate(_LABELS.items()):
        rows = np.array(of["linear"][source][-1], dtype=float)
        y, point = np.arange(len(targets)) + 0.13 * (i - 2), look(source, list(_LABELS)).point
        axes.hlines(y, np.clip(rows[:, 1], -0.1, 1), np.clip(rows[:, 2], -0.1, 1), color=point["color"], lw=1)
        axes.plot(np.clip(rows[:, 0], -0.1, 1), y, **point | {"markersize": 4}, label=label)
    axes.set_yticks(range(len(targets)), [_SHORT[t] for t in targets])
    axes.set_xlim(-0.12, 1.02)
    axes.set_xlabel("R^2 of a linear probe, 1: known exactly")
    axes.set_title(f"{regime}-storm, after {of['instants'][-1] * of['dt']:g} s")


def _courses(axes: Axes, of: Mapping[str, Any]) -> None:
    time = np.array(of["instants"]) * of["dt"]
    for target in IN_TIME:
        i = of["targets"].index(target)
        rows = np.array([row[i] for row in of["linear"]["memory"]], dtype=float)
        style = look(target, IN_TIME)
        axes.plot(time, rows[:, 0], **style.line, marker=style.point["marker"], ms=4, label=_SHORT[target])
        axes.fill_between(time, rows[:, 1], rows[:, 2], color=style.colour, alpha=0.15, lw=0)
    axes.set_xscale("log")
    axes.set_xticks(time, [f"{t:g}" for t in time], minor=False)
    axes.set_xticks([], minor=True)
    axes.set_ylim(-0.1, 1.0)
    axes.set_xlabel("time since the start [s]")


def adaptation_figure(own: Mapping[str, Any], regime: str) -> bytes:
    """Return the figure of a regime about changes in mid-run: a row for each sea, a column for each change."""
    figure, axes = panels(len(SEAS), len(CHANGES), (12.5, 6.2), sharex=True, sharey="row")
    names = _ordered(own)
    with styled():
        for line, sea in zip(axes, SEAS, strict=True):
            for ax, change in zip(line, CHANGES, strict=True):
                for name in names:
                    if regime in own[name]:
                        _course(ax, name, names, own[name][regime][sea]["changes"][change])
                ax.set_yscale("log")
                ax.set_title(f"{sea}: {CHANGES[change].says.partition(', from')[0]}")
            line[0].set_ylabel("position error [mm]")
        for ax in axes[-1]:
            ax.set_xlabel("lengths L since the change")
        _below(figure, axes[0][0])
    return to_png(figure)


def _course(axes: Axes, name: str, names: list[str], course: Mapping[str, Any]) -> None:
    mean, low, high = 1e3 * np.array(course["error_m"])
    style, x = look(name, names), np.arange(len(mean)) + 1.0
    axes.plot(x, mean, **style.line, label=name)
    axes.fill_between(x, low, high, color=style.colour, alpha=0.15, lw=0)
    axes.plot(len(mean) + 1.5, 1e3 * course["level_m"][0], **style.point)
    place = course["back"][0][0]
    if place is not None and max(course["factor"][0]) > LARGEST:
        axes.plot(place + 1, mean[int(place)], marker="|", ms=14, mew=2, color=style.colour)


def range_figure(record: Mapping[str, Any]) -> bytes:
    """Return the figure about an agent's training with the published vehicles in it."""
    names, seen = list(training_range.RATIOS), np.array(record["points"])
    figure, axes = panels(2, 2, (9.5, 8.6))
    with styled():
        for ax, pair in zip([ax for row in axes for ax in row], PAIRS, strict=True):
            i, j = (names.index(ratio) for ratio in pair)
            ax.plot(seen[:, i], seen[:, j], ".", color="0.6", ms=3, label="drawn in training")
            for vehicle, rows in record["vehicles"].items():
                style, both = look(vehicle, list(record["vehicles"])), np.array(rows)
                ax.plot(both[:, i], both[:, j], **style.line, lw=1)
                ax.plot(both[1, i], both[1, j], **style.point, label=vehicle)
            for axis, ratio in ((ax.xaxis, pair[0]), (ax.yaxis, pair[1])):
                axis.set_label_text(training_range.RATIOS[ratio].partition(", ")[0])
            if pair[0] != "mass":
                ax.set_xscale("log")
                ax.set_yscale("log")
        _below(figure, axes[0][0])
    return to_png(figure)


def extrapolation_figure(own: Mapping[str, Any], regime: str) -> bytes:
    """Return the figure of a regime about errors outside of the training: a panel for each parameter."""
    parameters, names = parameters_of(regime), _ordered(own)
    figure, axes = panels(2, (len(parameters) + 1) // 2, (13.5, 6.2), sharey=True)
    with styled():
        for ax, (key, parameter) in zip([ax for row in axes for ax in row], parameters.items(), strict=False):
            ax.axvspan(*parameter.trained, color="0.92", zorder=0, lw=0)
            for name in names:
                if regime in own[name]:
                    _errors(ax, name, names, own[name][regime]["parameters"][key])
            ax.set_yscale("log")
            ax.set_xlabel(parameter.says)
        for row in axes:
            row[0].set_ylabel("tail error [mm]")
        _below(figure, axes[0][0])
    return to_png(figure)


def _errors(axes: Axes, name: str, names: list[str], of: Mapping[str, Any]) -> None:
    logs, style = np.log(1e3 * np.array(of["tails_m"])), look(name, names)
    mean, half = logs.mean(axis=1), 1.96 * logs.std(axis=1, ddof=1) / np.sqrt(logs.shape[1])
    axes.plot(of["values"], np.exp(mean), **style.line, label=name)
    axes.fill_between(of["values"], np.exp(mean - half), np.exp(mean + half), color=style.colour, alpha=0.15, lw=0)
    lost = np.array(of["lost"]) > 0
    axes.plot(np.array(of["values"])[lost], np.exp(mean)[lost], "x", color=style.colour, ms=6, mew=1.6)


def _ordered(own: Mapping[str, Any]) -> list[str]:
    """Return the policies in the order in which they are drawn: the usual ones first, so that each keeps its look."""
    return [name for name in _ORDER if name in own] + [name for name in own if name not in _ORDER]


def _below(figure: Figure, axes: Axes, columns: int = 6) -> None:
    """Put the legend of axes below the figure, in so many columns at most."""
    lines, labels = axes.get_legend_handles_labels()
    figure.legend(lines, labels, loc="outside lower center", ncols=min(columns, len(labels)))
