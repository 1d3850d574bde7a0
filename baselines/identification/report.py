"""The report of an identification: tables in Markdown, and figures of fit, residuals and held-out runs."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawing

from auv_gym.physics.namespaces import Array
from baselines.identification import Identified
from baselines.identification.columns import QUANTITIES
from baselines.identification.files import interval, meanings, number
from baselines.identification.fit import KNOWN, LEFT_OUT
from baselines.identification.log import CONTROLS, MEASURED_COLUMNS, Log, unwrapped
from baselines.identification.model import LIMIT_NAMES, is_current
from baselines.identification.prediction import Extrapolation, HeldOut
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


def rows(identified: Identified) -> list[tuple[str, ...]]:
    """Return the table of the parameters, headings first, with cells of equal width in each column."""
    lines = [_HEAD]
    for e in identified.estimates:
        if e.verdict == LEFT_OUT or (e.verdict == KNOWN and is_current(e.name)):
            continue
        unit, meaning = meanings()[e.name.split(maxsplit=1)[0]]
        lines.append((e.name, number(e.value), unit, interval(e), e.verdict, meaning))
    widths = [max(len(line[j]) for line in lines) for j in range(len(_HEAD))]
    return [tuple(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) for line in lines]


def _table(lines: Sequence[Sequence[str]]) -> str:
    head, *rest = ["| " + " | ".join(line) + " |" for line in lines]
    return "\n".join((head, "|" + "---|" * len(lines[0]), *rest))


def report_files(
    identified: Identified, name: str, note: str = "", held_out: HeldOut | None = None, held_out_name: str = ""
) -> dict[str, str | bytes]:
    """Return the contents of report.md and its figures by name.

    Args:
        identified: the result of the identification.
        name: name of the log.
        note: a sentence about the vehicle, "" for none.
        held_out: errors of predictions of held-out runs; None: there are no such runs.
        held_out_name: name of their log.
    """
    log, count = identified.model.log, len(identified.model.starts)
    products = np.concatenate([identified.errors[run][1:] * identified.errors[run][:-1] for run in log.runs])
    correlations = products.mean(axis=0) / np.mean(identified.errors**2, axis=0)
    noise = [("measurement", "noise (standard deviation)", "unit", "correlation with the previous row")]
    for m, s, c in zip(MEASURED_COLUMNS, identified.noise, correlations, strict=True):
        noise.append((m, number(s), QUANTITIES[m], f"{c:+.2f}"))
    parts = [
        *([f"**{MISFIT}**"] if identified.misfit else []),
        f"# The vehicle in {name}",
        (
            f"{len(log.t)} rows, {log.duration:.4g} s, predicted in {count} segments of {log.duration / count:.3g} s. "
            "Intervals are computed from the residuals, and are wider if these are correlated from row to row. The "
            f"p-value of the test that the residuals are white noise is {identified.whiteness:.2g}. "
            + (_UNEXPLAINED if identified.misfit else "")
        ),
        *([f"**{note[0].upper()}{note[1:]}.**"] if note else []),
        *(["Of the log: " + "; ".join(log.notes) + "."] if log.notes else []),
        "The current V_x, V_y is along the axes of x and y of the log: north and east where x is north.",
        _table(rows(identified)),
        "## Fit\n\n![Measured and predicted](fit.png)",
        "## Residuals\n\n![Residuals and their autocorrelation](residuals.png)\n\n"
        "Residuals of measurement noise have the same variance everywhere and no correlation from row to row: the "
        "dashed lines are their 95 % limits. Waves in the residuals show terms that the equations lack.\n\n"
        + _table(noise),
    ]
    with styled():
        pictures = {"fit.png": to_png(_fit(identified)), "residuals.png": to_png(_residuals(identified))}
        if held_out is not None:
            title = "## Held-out runs\n\n![Measured and predicted](held-out.png)\n\n"
            parts.append(title + held_out_text(held_out, held_out_name))
            pictures["held-out.png"] = to_png(_held_out(held_out))
    return {"report.md": "\n\n".join(parts) + "\n", **pictures}


def _broken(log: Log, rows: Array) -> Array:
    """Return rows with a row of nan between the runs of a log, so that curves are interrupted there."""
    return np.asarray(np.insert(rows, log.starts[1:], np.nan, axis=0))


def _clock(log: Log) -> Array:
    """Return the time [s] of each row if each run follows the previous one without a pause, shape (T,)."""
    return np.asarray(np.concatenate(([0.0], np.cumsum(log.steps)[:-1])) + log.t[0])


def _curves(ax: Axes, measured: Sequence[Array] | Array, predicted: Sequence[Array] | Array) -> None:
    """Draw two curves, the pairs of their coordinates."""
    ax.plot(*measured, color="0.6", linewidth=2.5, label="measured")
    ax.plot(*predicted, color=COLOURS[0], label="predicted")


def _fit(identified: Identified) -> Drawing:
    """Return the figure of the measurements and of the predictions from the initial states of the segments."""
    log = identified.model.log
    measured = unwrapped(log)
    t, measured, outputs = (_broken(log, x) for x in (_clock(log), measured, measured - identified.errors))
    figure, axes = panels(4, 2, (9.0, 9.0))
    track, *rest = [ax for row in axes for ax in row]
    _curves(track, measured[:, 1::-1].T, outputs[:, 1::-1].T)
    track.set(title="track", xlabel="y [m]", ylabel="x [m]", aspect="equal", adjustable="datalim")
    for ax, j in zip(rest, (2, 3, 4, 5), strict=False):
        _curves(ax, (t, measured[:, j]), (t, outputs[:, j]))
        for start in identified.model.starts:
            ax.axvline(_clock(log)[start], color="0.85", linewidth=0.8, zorder=0)
        name = MEASURED_COLUMNS[j]
        ax.set(title=name, xlabel="t [s]", ylabel=f"{name} [{QUANTITIES[name]}]")
    rest[0].legend()
    limits = {e.name: e.value for e in identified.estimates if e.name in LIMIT_NAMES and math.isfinite(e.value)}
    for ax, commands, name in zip(rest[4:6], log.commands.T, CONTROLS[log.kind], strict=True):
        ax.step(_clock(log), commands, where="post", color=COLOURS[1])
        for side in (-1, 1) if f"{name}_max" in limits else ():
            ax.axhline(side * limits[f"{name}_max"], color="0.45", linestyle="--")
        ax.set(title=f"command {name}", xlabel="t [s]", ylabel=f"{name} [{QUANTITIES[name]}]")
    rest[6].set_axis_off()
    legend = "Grey: measured. Blue: predicted from the commands\nand an initial state at each thin line.\n"
    rest[6].text(0, 0.5, legend + "Dashed: identified limits.", va="center")
    return figure


def _residuals(identified: Identified) -> Drawing:
    """Return the figure of residuals over time and of their autocorrelation."""
    log = identified.model.log
    figure, axes = panels(6, 2, (9.0, 10.0), width_ratios=(3, 1))
    bound = NORMAL_QUANTILE / math.sqrt(len(log.t))
    for j, (over_time, correlation) in enumerate(axes):
        errors, name = identified.errors[:, j], MEASURED_COLUMNS[j]
        over_time.plot(_clock(log), errors, ".", markersize=2, color=COLOURS[0])
        over_time.set(ylabel=f"{name} [{QUANTITIES[name]}]")
        most = min(_LAGS, len(errors) // 3)
        values = [float(errors[: len(errors) - k] @ errors[k:] / (errors @ errors)) for k in range(1, most)]
        correlation.bar(range(1, most), values, color=COLOURS[0])
        correlation.set(ylim=(-0.5, 1))
        for ax, limit in ((over_time, NORMAL_QUANTILE * identified.noise[j]), (correlation, bound)):
            for side in (-limit, limit):
                ax.axhline(side, color="0.45", linestyle="--", linewidth=1)
    axes[0][0].set_title("measured minus predicted; dashed: 95 % of the noise")
    axes[0][1].set_title("autocorrelation")
    axes[-1][0].set_xlabel("t [s]")
    axes[-1][1].set_xlabel("lag [rows]")
    return figure


def _held_out(result: HeldOut) -> Drawing:
    """Return the figure of the measurements and of the predictions from the first measurements of each run."""
    log, measured, outputs = result.log, unwrapped(result.log), result.outputs
    figure, axes = panels(len(log.runs), 3, (9.0, 2.4 * len(log.runs)))
    for (*over_time, track), run in zip(axes, log.runs, strict=True):
        t = log.t[run] - log.t[run.start]
        age = np.maximum(t - result.windows.settle, 0.0)
        shown = age <= result.windows.horizon
        columns = (2, 180 / math.pi, "heading [degrees]"), (3, 1.0, "u [m/s]")
        for ax, (j, scale, name) in zip(over_time, columns, strict=True):
            _curves(ax, (t, scale * measured[run, j]), (t, scale * outputs[run, j]))
            if result.bands is not None:
                half = result.bands[result.windows.bins(age), j]
                low, high = (scale * (outputs[run, j] + side * half) for side in (-1, 1))
                ax.fill_between(t[shown], low[shown], high[shown], color=COLOURS[0], alpha=0.2, linewidth=0)
            ax.axvline(result.windows.settle, color="0.85", linewidth=0.8)
            ax.set(xlabel="t [s]", ylabel=name)
        _curves(track, measured[run, 1::-1].T, outputs[run, 1::-1].T)
        track.set(xlabel="y [m]", ylabel="x [m]", aspect="equal", adjustable="datalim")
    return figure


def _extrapolation(beyond: Extrapolation) -> str:
    (low, high), (least, most) = beyond.reached, beyond.fitted
    return (
        f"Run {beyond.run + 1}: {beyond.name} is {low:.3g} to {high:.3g} {QUANTITIES[beyond.name.strip('|')]}, in the "
        f"fit {least:.3g} to {most:.3g}: this prediction is an extrapolation."
    )


def held_out_text(result: HeldOut, name: str) -> str:
    """Return the errors of predictions of held-out runs with a name, in Markdown."""
    w = result.windows
    errors = [("prediction", "heading [degrees]", "surge speed [m/s]", "position [m]")]
    for predictor, (psi, u, position) in result.rms.items():
        errors.append((predictor, f"{math.degrees(psi):.2f}", f"{u:.3f}", f"{position:.2f}"))
    parts = [
        (
            f"{name}: nothing was fitted to these runs. The initial state of each prediction is estimated from "
            f"{w.settle:.3g} s of measurements. The prediction then uses the logged commands alone, for "
            f"{w.horizon:.3g} s. A new one begins every {w.settle:.3g} s. Errors are root mean squares over that time. "
            "For comparison: a first-order Nomoto model of the yaw rate with constant speed, and constant velocities."
        ),
        *map(_extrapolation, result.extrapolations),
        _table(errors),
    ]
    if result.bands is None:
        parts.append("The logs are too short for error bands.")
    else:
        names = ("along", "across", "heading", "u", "v", "r")
        shares = ", ".join(f"{n} {100 * c:.0f} %" for n, c in zip(names, result.inside.mean(axis=0), strict=True))
        parts.append(
            "The error bands contain 95 % of the errors of a cross-validation: each part of the other logs is "
            "predicted by a model that is fitted without it. The bands are widened by Student's t for the number of "
            f"runs. Inside the bands: {shares} of the predictions above."
        )
    if result.manoeuvres:
        rows = [(str(m.run + 1), m.name, f"{m.measured:.2f}", f"{m.predicted:.2f}") for m in result.manoeuvres]
        parts.append(_table([("run", "characteristic", "measured", "predicted"), *rows]))
    return "\n\n".join(parts)
