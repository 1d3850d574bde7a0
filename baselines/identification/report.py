"""The report of an identification: tables in Markdown, and figures of the fit and its residuals."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure as Drawing

from auv_gym.physics.namespaces import Array
from baselines.identification import Identified
from baselines.identification.files import interval, meanings, number
from baselines.identification.fit import KNOWN, LEFT_OUT, UNKNOWN
from baselines.identification.log import CONTROLS, LOG_COLUMNS, MEASURED_COLUMNS, Log, unwrapped
from baselines.identification.manoeuvres import approach, characteristics
from baselines.identification.model import LIMIT_NAMES, is_current
from baselines.identification.uncertainty import NORMAL_QUANTILE
from baselines.tools.figure_style import COLOURS, panels, styled, to_png

MISFIT = "model misfit: intervals not valid"
"""First line of the report if the model does not explain the log."""
_UNEXPLAINED = (
    "The model does not explain the log. Intervals are therefore at least as wide as the scatter of the segments, but "
    "do not include the effect of terms that the equations lack."
)
_LAGS = 40  # lags [rows] in the figure of the autocorrelation
_HEAD = ("parameter", "value", "unit", "95 % interval", "result", "meaning")  # of the main table


def rows(found: Identified) -> list[tuple[str, ...]]:
    """Return the table of the parameters, headings first, with cells of equal width in each column."""
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


def report_files(found: Identified, name: str, note: str = "") -> dict[str, str | bytes]:
    """Return the contents of report.md, fit.png and residuals.png by name.

    Args:
        found: the result of the identification.
        name: name of the log.
        note: a sentence about the vehicle, "" for none.
    """
    log, count = found.model.log, len(found.model.starts)
    products = np.concatenate([found.errors[run][1:] * found.errors[run][:-1] for run in log.runs])
    correlations = products.mean(axis=0) / np.mean(found.errors**2, axis=0)
    noise = [("measurement", "noise (standard deviation)", "unit", "correlation with the previous row")]
    for m, s, c in zip(MEASURED_COLUMNS, found.noise, correlations, strict=True):
        noise.append((m, number(s), LOG_COLUMNS[m], f"{c:+.2f}"))
    parts = [
        *([f"**{MISFIT}**"] if found.misfit else []),
        f"# The vehicle in {name}",
        (
            f"{len(log.t)} rows, {log.duration:.4g} s, predicted in {count} segments of {log.duration / count:.3g} s. "
            "Intervals are computed from the residuals, and are wider if these are correlated from row to row. The "
            f"p-value of the test that the residuals are white noise is {found.whiteness:.2g}. "
            + (_UNEXPLAINED if found.misfit else "")
        ),
        *([f"**{note[0].upper()}{note[1:]}.**"] if note else []),
        _table(rows(found)),
        "## Fit\n\n![Measured and predicted](fit.png)",
        "## Residuals\n\n![Residuals and their autocorrelation](residuals.png)\n\n"
        "Residuals of measurement noise have the same variance everywhere and no correlation from row to row: the "
        "dashed lines are their 95 % limits. Waves in the residuals show terms that the equations lack.\n\n"
        + _table(noise),
        _manoeuvres(found),
    ]
    with styled():
        pictures = {"fit.png": to_png(_fit(found)), "residuals.png": to_png(_residuals(found))}
    return {"report.md": "\n\n".join(parts) + "\n", **pictures}


def _manoeuvres(found: Identified) -> str:
    """Return the section on turning circle and zig-zag."""
    initial = approach(found)
    values = characteristics(found, initial)
    if not values:
        return f"## Manoeuvres\n\nNone: the log does not show {', '.join(found.unknown)}."
    order = f"{math.degrees(initial.order):.3g} degrees of rudder"
    if found.model.log.kind == "force":
        order = f"a yaw moment of {initial.order:.3g} N m"
    lines = [("characteristic", "value", "unit", "95 % interval")]
    for c in values:
        value = "not reached" if math.isnan(c.value) else number(c.value)
        ends = "-" if math.isnan(c.value) else f"{number(c.low)} ... {number(c.high)}"
        lines.append((c.name, value, c.unit, ends))
    return (
        "## Manoeuvres\n\n"
        f"Simulation of the identified vehicle in still water, from {initial.speed:.3g} m/s straight ahead, with "
        f"{order} and the command that keeps this speed on a straight course. The definitions are those of IMO "
        "MSC.137(76). The speed is the mean of the log, the order the median of its orders.\n\n" + _table(lines)
    )


def broken(log: Log, rows: Array) -> Array:
    """Return rows with a row of nan between the runs of a log, so that curves are interrupted there."""
    return np.asarray(np.insert(rows, log.starts[1:], np.nan, axis=0))


def clock(log: Log) -> Array:
    """Return the time [s] of each row if each run follows the previous one without a pause, shape (T,)."""
    return np.asarray(np.concatenate(([0.0], np.cumsum(log.steps)[:-1])) + log.t[0])


def _fit(found: Identified) -> Drawing:
    """Return the figure of the measurements and of the predictions from the initial states of the segments."""
    log = found.model.log
    t, measured, outputs = (broken(log, x) for x in (clock(log), unwrapped(log), found.predicted))
    figure, axes = panels(4, 2, (9.0, 9.0))
    track, *rest = [ax for row in axes for ax in row]
    for data, style in ((measured, {"color": "0.6", "linewidth": 2.5}), (outputs, {"color": COLOURS[0]})):
        track.plot(data[:, 1], data[:, 0], **style)
    track.set(title="track", xlabel="y [m]", ylabel="x [m]", aspect="equal", adjustable="datalim")
    for ax, j in zip(rest, (2, 3, 4, 5), strict=False):
        ax.plot(t, measured[:, j], color="0.6", linewidth=2.5, label="measured")
        ax.plot(t, outputs[:, j], color=COLOURS[0], label="predicted")
        for start in found.model.starts:
            ax.axvline(clock(log)[start], color="0.85", linewidth=0.8, zorder=0)
        name = MEASURED_COLUMNS[j]
        ax.set(title=name, xlabel="t [s]", ylabel=f"{name} [{LOG_COLUMNS[name]}]")
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
    legend = "Grey: measured. Blue: predicted from the commands\nand an initial state at each thin line.\n"
    rest[6].text(0, 0.5, legend + "Dashed: identified limits.", va="center")
    return figure


def _residuals(found: Identified) -> Drawing:
    """Return the figure of residuals over time and of their autocorrelation."""
    log = found.model.log
    figure, axes = panels(6, 2, (9.0, 10.0), width_ratios=(3, 1))
    bound = NORMAL_QUANTILE / math.sqrt(len(log.t))
    for (over_time, correlation), name, errors, s in zip(
        axes, MEASURED_COLUMNS, found.errors.T, found.noise, strict=True
    ):
        over_time.plot(clock(log), errors, ".", markersize=2, color=COLOURS[0])
        for side in (-NORMAL_QUANTILE * s, NORMAL_QUANTILE * s):
            over_time.axhline(side, color="0.45", linestyle="--", linewidth=1)
        over_time.set(ylabel=f"{name} [{LOG_COLUMNS[name]}]")
        most = min(_LAGS, len(errors) // 3)
        values = [float(errors[: len(errors) - k] @ errors[k:] / (errors @ errors)) for k in range(1, most)]
        correlation.bar(range(1, most), values, color=COLOURS[0])
        for side in (-bound, bound):
            correlation.axhline(side, color="0.45", linestyle="--", linewidth=1)
        correlation.set(ylim=(-0.5, 1))
    axes[0][0].set_title("measured minus predicted; dashed: 95 % of the noise")
    axes[0][1].set_title("autocorrelation")
    axes[-1][0].set_xlabel("t [s]")
    axes[-1][1].set_xlabel("lag [rows]")
    return figure
