"""The figure of what a residual is for: error and lost episodes over authority, and the first minutes of training."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from auv_gym.scenarios.presets import REGIMES
from baselines.tools.figure_style import COLOURS, DASHES, LOOKS, REFERENCE_STYLE, panels, styled, to_png
from research.results.residual import FIGURE, SHOWN, law, lost_share, mean_error, of, what_it_is_for
from research.results.residual_file import RESIDUAL_FILE, RESIDUAL_KIND, SCRATCH, STUCK, ResidualGroup, load_groups
from research.robustness.failures import FAILURES, SATURATED
from research.robustness.situations import AS_TRAINED

_REGIME = "cruise"
"""The regime of the figure: the one in which every authority is trained."""
TICKS = (0.05, 0.1, 0.25, 0.5, 1.0, 2.0)
"""Authorities that are marked on an axis."""
_KINDS = {RESIDUAL_KIND: LOOKS[0], SCRATCH: LOOKS[1]}  # how each kind of agent is drawn


def context(_: str) -> dict[str, Any]:
    """Return the body of the page about residuals."""
    return {"body": what_it_is_for(load_groups(RESIDUAL_FILE))}


def figures(_: str) -> dict[str, bytes]:
    """Return the figure of the page as PNG by name."""
    return {FIGURE: to_png(residual_figure(load_groups(RESIDUAL_FILE)))}


def residual_figure(groups: Sequence[ResidualGroup]) -> Figure:
    """Return the figure; a group without its neighbours is drawn alone."""
    figure, [[errors, first], below] = panels(2, 2, (7.6, 6.2))
    with styled():
        _errors(errors, groups)
        _minutes(first, groups)
        for kind in _KINDS:
            _failures(below[0], of(groups, _REGIME, kind), kind)
        _bounds(below[1], groups)
    return figure


def _errors(ax: Axes, groups: Sequence[ResidualGroup]) -> None:
    """Draw the errors as trained over authority: mean with interval, and every seed."""
    for kind, look in _KINDS.items():
        own = of(groups, _REGIME, kind)
        x = np.array([group.authority for group in own], dtype=np.float64)
        scores = [mean_error(group, AS_TRAINED) for group in own]
        ends = 100 * np.array([score.ci95 for score in scores]).reshape(-1, 2)
        ax.fill_between(x, ends[:, 0], ends[:, 1], color=look.colour, alpha=0.15, linewidth=0)
        ax.plot(x, [100 * score.mean for score in scores], **look.line, label=kind)
        for group in own:
            seeds = 100 * group.tails[AS_TRAINED].mean(axis=1)
            ax.plot(np.full(len(seeds), group.authority), seeds, **{**look.point, "markersize": 3})
    _law(ax, groups)
    _centimetres(ax, "mean tail error [cm]")
    ax.set_title("As trained")
    _authorities(ax)
    ax.legend(fontsize=8)


def _law(ax: Axes, groups: Sequence[ResidualGroup]) -> None:
    if (alone := law(groups, _REGIME)) is not None:
        ax.axhline(100 * mean_error(alone, AS_TRAINED).mean, **REFERENCE_STYLE, label="the law alone")


def _centimetres(ax: Axes, label: str) -> None:
    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_locator(NullLocator())
    ax.set_ylabel(label)


def _authorities(ax: Axes) -> None:
    ax.set_xscale("log")
    ax.set_xlim(0.045, 2.2)
    ax.set_xticks(TICKS, [f"{tick:g}" for tick in TICKS])
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set_xlabel("authority [share of the limits]")


def _failures(ax: Axes, own: Sequence[ResidualGroup], kind: str) -> None:
    """Draw the share of the episodes that each failure loses at the authority that is shown, with its interval."""
    shown = [group for group in own if group.authority == SHOWN[kind]]
    for group in shown:
        shares = [lost_share(group, failure) for failure in FAILURES]
        x = np.arange(len(FAILURES)) + (0.12 if kind == SCRATCH else -0.12)
        label = f"{kind}, authority {group.authority:g}"
        ax.plot(x, [100 * share.mean for share in shares], **_KINDS[kind].point, label=label)
        for position, share in zip(x, shares, strict=True):
            ax.plot([position] * 2, [100 * end for end in share.ci95], color=_KINDS[kind].colour, linewidth=1.4)
    ax.set_xticks(range(len(FAILURES)), [name.replace(" at ", "\nat ") for name in FAILURES])
    ax.set_ylim(-4, 104)
    ax.set_ylabel("episodes lost [%]")
    ax.set_title("The network fails")
    if shown:
        ax.legend(fontsize=8, loc="center left", bbox_to_anchor=(0.0, 0.7))


def _bounds(ax: Axes, groups: Sequence[ResidualGroup]) -> None:
    """Draw the share of the episodes that a stuck correction loses over authority, with its interval."""
    for i, regime in enumerate(REGIMES):
        own = of(groups, regime, STUCK)
        for dash, limit in zip(DASHES, SATURATED, strict=False):
            shares = [lost_share(group, limit) for group in own]
            x = np.array([group.authority for group in own], dtype=np.float64)
            ends = 100 * np.array([share.ci95 for share in shares]).reshape(-1, 2)
            means = [100 * share.mean for share in shares]
            ax.plot(x, means, color=COLOURS[i + 2], linestyle=dash[0], label=f"{regime}, {limit}")
            ax.fill_between(x, ends[:, 0], ends[:, 1], color=COLOURS[i + 2], alpha=0.15, linewidth=0)
    _authorities(ax)
    ax.set_ylim(-4, 104)
    ax.set_title("What an authority bounds")
    ax.legend(fontsize=7, loc="upper left")


def _minutes(ax: Axes, groups: Sequence[ResidualGroup]) -> None:
    """Draw the learning curves: mean over seeds, and their range."""
    for kind, look in _KINDS.items():
        for group in of(groups, _REGIME, kind):
            if group.authority == SHOWN[kind] and group.curves:
                errors = 100 * np.array([curve[:, 1] for curve in group.curves])
                steps = group.curves[0][:, 0] / 1e6
                ax.plot(steps, errors.mean(axis=0), **look.line, label=f"{kind}, authority {group.authority:g}")
                ax.fill_between(steps, errors.min(axis=0), errors.max(axis=0), color=look.colour, alpha=0.15, lw=0)
    _centimetres(ax, "mean error, validation [cm]")
    ax.set_xlabel("control steps of training [million]")
    ax.set_title("The first minutes")
    ax.legend(fontsize=8)
