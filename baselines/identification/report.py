"""The report of an identification: tables in Markdown, and the fit and what it leaves as figures."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure as Drawing

from auv_gym.physics.namespaces import Array
from baselines.identification import Identified
from baselines.identification.begin import is_current
from baselines.identification.figures import approach, figures
from baselines.identification.files import interval, meanings, number
from baselines.identification.fit import KNOWN, LEFT_OUT, UNKNOWN
from baselines.identification.log import CONTROLS, LOG_COLUMNS, MEASURED_COLUMNS, Log, unwrapped
from baselines.identification.model import LIMIT_NAMES
from baselines.identification.uncertainty import NORMAL_QUANTILE
from baselines.tools.figure_style import COLOURS, panels, styled, to_png

MISFIT = "model misfit: intervals not valid"
"""What is said first of a log that the model does not explain."""
_UNEXPLAINED = (
    "The model does not explain the log: intervals are as wide as the scatter of the segments makes them, and still do "
    "not know of what the equations leave out."
)
_LAGS = 40  # rows that the autocorrelation is drawn over
_HEAD = ("parameter", "value", "unit", "95 % interval", "what the log says", "what it is")  # of the main table


def rows(found: Identified) -> list[tuple[str, ...]]:
    """Return a line for each parameter, headings first, padded to columns."""
    lines = [_HEAD]
    for e in found.estimates:
        if e.verdict == LEFT_OUT or (e.verdict == KNOWN and is_current(e.name)):
            continue
        unit, meaning = meanings()[e.name.split(maxsplit=1)[0]]
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
    coloured = np.concatenate([found.errors[run][1:] * found.errors[run][:-1] for run in log.runs])
    related = coloured.mean(axis=0) / np.mean(found.errors**2, axis=0)
    noise = [("measurement", "noise (standard deviation)", "unit", "related to the row before")]
    noise += [
        (m, number(s), LOG_COLUMNS[m], f"{c:+.2f}")
        for m, s, c in zip(MEASURED_COLUMNS, found.noise, related, strict=True)
    ]
    parts = [
        *([f"**{MISFIT}**"] if found.misfit else []),
        f"# The vehicle in {name}",
        (
            f"{len(log.t)} rows, {log.duration:.4g} s, predicted in {cuts} segments of {log.duration / cuts:.3g} s. "
            "Intervals are those of the noise that the fit has left, wider where residuals are related from row to "
            "row. "
            f"White noise would leave residuals like these with a probability of {found.whiteness:.2g}. "
            + (_UNEXPLAINED if found.misfit else "")
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
    force = found.model.log.kind == "force"
    order = f"a yaw moment of {begin.order:.3g} N m" if force else f"{math.degrees(begin.order):.3g} degrees of rudder"
    lines = [("figure", "value", "unit", "95 % interval")]
    for f in known:
        if math.isnan(f.value):
            lines.append((f.name, "not reached", f.unit, "-"))
        else:
            lines.append((f.name, number(f.value), f.unit, f"{number(f.low)} ... {number(f.high)}"))
    return (
        "## Manoeuvres\n\n"
        f"What the identified vehicle does in the simulator, in still water, from {begin.speed:.3g} m/s straight ahead "
        f"with {order} and what held the speed ahead; defined as in IMO MSC.137(76). The speed is the log's mean, the "
        "order the median of its orders.\n\n" + _table(lines)
    )


def broken(log: Log, rows: Array) -> Array:
    """Return rows with one of nan between the runs of a log, so that no line joins them."""
    return np.asarray(np.insert(rows, log.starts[1:], np.nan, axis=0))


def clock(log: Log) -> Array:
    """Return the time [s] of each row with the runs one behind the other, shape (T,)."""
    return np.asarray(np.concatenate(([0.0], np.cumsum(log.steps)[:-1])) + log.t[0])


def _fit(found: Identified) -> Drawing:
    """Return the figure of what was measured and what is predicted from the segments' first states."""
    log = found.model.log
    t, measured, seen = (broken(log, x) for x in (clock(log), unwrapped(log), found.predicted))
    figure, axes = panels(4, 2, (9.0, 9.0))
    track, *rest = [ax for row in axes for ax in row]
    for data, style in ((measured, {"color": "0.6", "linewidth": 2.5}), (seen, {"color": COLOURS[0]})):
        track.plot(data[:, 1], data[:, 0], **style)
    track.set(title="track", xlabel="y [m]", ylabel="x [m]", aspect="equal", adjustable="datalim")
    for ax, j in zip(rest, (2, 3, 4, 5), strict=False):
        ax.plot(t, measured[:, j], color="0.6", linewidth=2.5, label="measured")
        ax.plot(t, seen[:, j], color=COLOURS[0], label="predicted")
        for start in found.model.starts:
            ax.axvline(clock(log)[start], color="0.85", linewidth=0.8, zorder=0)
        ax.set(
            title=MEASURED_COLUMNS[j],
            xlabel="t [s]",
            ylabel=f"{MEASURED_COLUMNS[j]} [{LOG_COLUMNS[MEASURED_COLUMNS[j]]}]",
        )
    rest[0].legend()
    limits = {e.name: e for e in found.estimates if e.name in LIMIT_NAMES and e.verdict != UNKNOWN}
    for ax, commands, (name, unit) in zip(rest[4:6], log.commands.T, CONTROLS[log.kind].items(), strict=True):
        ax.step(clock(log), commands, where="post", color=COLOURS[1])
        limit = limits.get(f"{name}_max")
        if limit is not None and math.isfinite(limit.value):
            for side in (-limit.value, limit.value):
                ax.axhline(side, color="0.45", linestyle="--")
        ax.set(title=f"command {name}", xlabel="t [s]", ylabel=f"{name} [{unit}]")
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
        over_time.plot(clock(log), errors, ".", markersize=2, color=COLOURS[0])
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
