"""The figures of docs/sensitivity.md."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from baselines.tools.figure_style import look, panels, styled, to_png
from research.sensitivity.adaptation import AS_GOOD
from research.sensitivity.changes import CHANGES, SEAS
from research.sensitivity.extrapolation import parameters_of

_ORDER = ("helm", "nmpc", "integral-normalised", "backstepping")
"""Policies in the order of their looks; others come behind."""


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
    if place is not None and max(course["factor"][0]) > AS_GOOD:
        axes.plot(place + 1, mean[int(place)], marker="|", ms=14, mew=2, color=style.colour)


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
