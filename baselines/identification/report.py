"""The report of an identification: tables in Markdown, and the fit and what it leaves as figures."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure as Drawing

from baselines.identification import Identified
from baselines.identification.figures import approach, figures
from baselines.identification.files import interval, meanings, number
from baselines.identification.fit import UNKNOWN
from baselines.identification.log import LOG_COLUMNS, MEASURED_COLUMNS, unwrapped
from baselines.identification.uncertainty import NORMAL_QUANTILE
from baselines.tools.figure_style import COLOURS, panels, styled, to_png

_LAGS = 40  # rows that the autocorrelation is drawn over
_HEAD = ("parameter", "value", "unit", "95 % interval", "what the log says", "what it is")  # of the main table


def rows(found: Identified) -> list[tuple[str, ...]]:
    """Return a line for each parameter, headings first, padded to columns."""
    lines = [_HEAD]
    for e in found.estimates:
        unit, meaning = meanings()[e.name]
        lines.append((e.name, number(e.value), unit, interval(e), e.verdict, meaning))
    widths = [max(len(line[j]) for line in lines) for j in range(len(_HEAD))]
    return [tuple(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in lines]


def _table(lines: Sequence[Sequence[str]]) -> str:
    head, *rest = ["| " + " | ".join(line) + " |" for line in lines]
    return "\n".join((head, "|" + "---|" * len(lines[0]), *rest))


def report_files(found: Identified, name: str, says: str = "") -> dict[str, str | bytes]:
    """Return the files of the report by name: report.md, fit.png, residuals.png.

    Args:
        found: the fit.
        name: of the log.
        says: a sentence about the vehicle, "" for none.
    """
    log, cuts = found.model.log, len(found.model.starts)
    coloured = found.errors[1:] * found.errors[:-1]
    related = coloured.mean(axis=0) / np.mean(found.errors**2, axis=0)
    noise = [("measurement", "noise (standard deviation)", "unit", "related to the row before")]
    noise += [
        (m, number(s), LOG_COLUMNS[m], f"{c:+.2f}")
        for m, s, c in zip(MEASURED_COLUMNS, found.noise, related, strict=True)
    ]
    parts = [
        f"# The vehicle in {name}",
        (
            f"{len(log.t)} rows, {log.duration:.4g} s, predicted in {cuts} segments of {log.duration / cuts:.3g} s. "
            "Intervals are those of the noise that the fit has left, wider where residuals are related from row to "
            "row; they do not know of anything that the equations leave out."
        ),
        *([f"**{says[0].upper()}{says[1:]}.**"] if says else []),
        _table(rows(found)),
        "## Fit\n\n![Measured and predicted](fit.png)",
        "## Residuals\n\n![What the prediction leaves](residuals.png)\n\n"
        "Residuals that are noise alone look alike everywhere and are unrelated from row to row, the dashed lines. "
        "Waves beneath them are what the equations do not have.\n\n" + _table(noise),
        _manoeuvres(found),
    ]
    with styled():
        pictures = {"fit.png": to_png(_fit(found)), "residuals.png": to_png(_left(found))}
    return {"report.md": "\n\n".join(parts) + "\n", **pictures}


def _manoeuvres(found: Identified) -> str:
    """Return the section on turning circle and zig-zag."""
    begin = approach(found)
    known = figures(found, begin)
    if not known:
        return f"## Manoeuvres\n\nNone: the log does not show {', '.join(found.unknown)}."
    lines = [("figure", "value", "unit", "95 % interval")]
    for f in known:
        if math.isnan(f.value):
            lines.append((f.name, "not reached", f.unit, "-"))
        else:
            lines.append((f.name, number(f.value), f.unit, f"{number(f.low)} ... {number(f.high)}"))
    return (
        "## Manoeuvres\n\n"
        f"What the identified vehicle does in the simulator, in still water, from {begin.speed:.3g} m/s straight ahead "
        f"with a yaw moment of {begin.moment:.3g} N m and the thrust that held the speed; defined as in IMO "
        "MSC.137(76). The speed is the log's mean, the moment the median of its orders.\n\n" + _table(lines)
    )


def _fit(found: Identified) -> Drawing:
    """Return the figure of what was measured and what is predicted from the segments' first states."""
    log = found.model.log
    measured = unwrapped(log)
    figure, axes = panels(4, 2, (9.0, 9.0))
    track, *rest = [ax for row in axes for ax in row]
    for data, style in ((measured, {"color": "0.6", "linewidth": 2.5}), (found.predicted, {"color": COLOURS[0]})):
        track.plot(data[:, 1], data[:, 0], **style)
    track.set(title="track", xlabel="y [m]", ylabel="x [m]", aspect="equal", adjustable="datalim")
    for ax, j in zip(rest, (2, 3, 4, 5), strict=False):
        ax.plot(log.t, measured[:, j], color="0.6", linewidth=2.5, label="measured")
        ax.plot(log.t, found.predicted[:, j], color=COLOURS[0], label="predicted")
        for start in found.model.starts:
            ax.axvline(log.t[start], color="0.85", linewidth=0.8, zorder=0)
        ax.set(
            title=MEASURED_COLUMNS[j],
            xlabel="t [s]",
            ylabel=f"{MEASURED_COLUMNS[j]} [{LOG_COLUMNS[MEASURED_COLUMNS[j]]}]",
        )
    rest[0].legend()
    for ax, j, name, unit in ((rest[4], 0, "F_u", "N"), (rest[5], 1, "F_r", "N m")):
        ax.step(log.t, log.commands[:, j], where="post", color=COLOURS[1])
        if math.isfinite(limit := found[f"{name}_max"].value) and found[f"{name}_max"].verdict != UNKNOWN:
            for side in (-limit, limit):
                ax.axhline(side, color="0.45", linestyle="--")
        ax.set(title=f"command {name}, and its limit", xlabel="t [s]", ylabel=f"{name} [{unit}]")
    rest[6].set_axis_off()
    rest[6].text(
        0,
        0.5,
        "Grey: measured. Blue: predicted from the\ncommands and one state at each thin line.\n"
        "Dashed: the limits that were found.",
        va="center",
    )
    return figure


def _left(found: Identified) -> Drawing:
    """Return the figure of residuals over time and of their autocorrelation."""
    log = found.model.log
    figure, axes = panels(6, 2, (9.0, 10.0), width_ratios=(3, 1))
    bound = NORMAL_QUANTILE / math.sqrt(len(log.t))
    for (over_time, related), name, errors, s in zip(axes, MEASURED_COLUMNS, found.errors.T, found.noise, strict=True):
        over_time.plot(log.t, errors, ".", markersize=2, color=COLOURS[0])
        for side in (-NORMAL_QUANTILE * s, NORMAL_QUANTILE * s):
            over_time.axhline(side, color="0.45", linestyle="--", linewidth=1)
        over_time.set(ylabel=f"{name} [{LOG_COLUMNS[name]}]")
        most = min(_LAGS, len(errors) // 3)
        values = [float(errors[: len(errors) - k] @ errors[k:] / (errors @ errors)) for k in range(1, most)]
        related.bar(range(1, most), values, color=COLOURS[0])
        for side in (-bound, bound):
            related.axhline(side, color="0.45", linestyle="--", linewidth=1)
        related.set(ylim=(-0.5, 1))
    axes[0][0].set_title("measured less predicted; dashed: 95 % of the noise")
    axes[0][1].set_title("autocorrelation")
    axes[-1][0].set_xlabel("t [s]")
    axes[-1][1].set_xlabel("rows apart")
    return figure
