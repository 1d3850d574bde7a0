"""Comparison of predictions with held-out runs, with error bands and two simpler models: `--holdout`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from matplotlib.figure import Figure as Drawing
from numpy.typing import NDArray
from scipy import stats

from auv_gym.physics.namespaces import Array, Indices
from baselines.identification.fit import Identified
from baselines.identification.log import Log, slices, unwrapped
from baselines.identification.model import CURRENT_NAMES, LogModel, is_current, names_of
from baselines.identification.prediction import Windows, constant_velocity, nomoto, predicted, prediction_errors
from baselines.tools.figure_style import COLOURS, panels

FOLDS = 5
"""Largest number of folds of the cross-validation for error bands."""
COVERED = 0.95  # nominal share of the errors inside the bands
_BINS = 12  # intervals of the horizon in which a band is constant
_FEWEST = 8  # least number of predictions for a band
_EXECUTE = 0.8  # share of the largest command from which a command counts as an execute to one side
_ZIG_ZAG = 0.6  # least share of the rows after the first execute with an execute, in a zig-zag
PREDICTORS = ("model", "Nomoto", "constant velocity")
"""Names of the compared models."""


@dataclass(frozen=True)
class Manoeuvre:
    """A measured characteristic of a manoeuvre and its prediction from the first measurements of the run."""

    run: int
    name: str  # "first overshoot" [degrees], "second overshoot" [degrees], "turning diameter" [m]
    measured: float
    predicted: float


@dataclass(frozen=True)
class HeldOut:
    """Errors of predictions of held-out runs."""

    log: Log
    windows: Windows
    age: Array  # [s] since the start of the prediction, shape (n,)
    run: Indices  # index of the run of each error, shape (n,)
    errors: Mapping[str, Array]  # by model: along, across [m], heading [rad], u, v [m/s], r [rad/s], shape (n, 6)
    bands: Array | None  # half widths along the horizon, shape (_BINS, 6); None if there are too few predictions
    manoeuvres: tuple[Manoeuvre, ...]
    outputs: Array  # predictions from the first measurements of each run, shape (T, 6)

    @property
    def rms(self) -> dict[str, tuple[float, float, float]]:
        """Root mean square errors by model: heading [rad], surge speed [m/s], position [m]."""
        return {name: rms(rows) for name, rows in self.errors.items()}

    @property
    def inside(self) -> Array:
        """Whether errors of the identified model are within the bands, shape (n, 6); nan without bands."""
        if self.bands is None:
            return np.full((len(self.age), 6), np.nan)
        return np.asarray(np.abs(self.errors["model"]) <= self.bands[_bin(self.age, self.windows)], dtype=np.float64)


def held_out(found: Identified, log: Log, windows: Windows | None = None) -> HeldOut:
    """Return the prediction errors of an identified vehicle on held-out runs, from the logged commands alone.

    Args:
        found: the identified vehicle.
        log: the held-out runs, with commands of the same kind.
        windows: time windows of the predictions; None: 15 s for the initial state and a horizon of 60 s, less if the
            shortest run is too short.

    Raises:
        ValueError: the commands are of another kind, or no run is long enough.
    """
    train = found.model.log
    if (log.kind, log.wind is None) != (train.kind, train.wind is None):
        raise ValueError(f"the held-out log has commands of {log.kind}, the others of {train.kind}, or one lacks wind")
    shortest = min(float(log.t[run][-1] - log.t[run][0]) for run in log.runs)
    windows = windows or Windows(min(15.0, 0.2 * shortest), min(60.0, 0.75 * shortest), min(15.0, 0.2 * shortest))
    values = values_for(found, log)
    errors: dict[str, list[Array]] = {name: [] for name in PREDICTORS}
    ages, runs = [], []
    row_runs = np.repeat(np.arange(len(log.runs)), [run.stop - run.start for run in log.runs])
    for starts in windows.starts(log):
        predictions = (
            predicted(_model(found, log, starts), values, found.noise, windows.settle),
            nomoto(train, log, starts, windows.settle),
            constant_velocity(log, starts, windows.settle),
        )
        for name, outputs in zip(PREDICTORS, predictions, strict=True):
            rows, age, error = prediction_errors(log, outputs, starts, windows)
            errors[name].append(error)
        ages.append(age)
        runs.append(row_runs[rows])
    if not any(len(age) for age in ages):
        raise ValueError(f"no held-out run is {windows.settle + windows.horizon:g} s long")
    age, run, bands = np.concatenate(ages), np.concatenate(runs), error_bands(found, windows)
    every = {name: np.concatenate(rows) for name, rows in errors.items()}
    outputs = predicted(_model(found, log, np.array(log.starts)), values, found.noise, windows.settle)
    return HeldOut(log, windows, age, run, every, bands, _manoeuvres(log, outputs), outputs)


def _model(found: Identified, log: Log, starts: Indices) -> LogModel:
    return LogModel(log, starts, found.model.substeps, found.model.over_ground)


def values_for(found: Identified, log: Log) -> Array:
    """Return the parameters of an identified vehicle for another log, in the order of `LogModel.names`, shape (P,).

    The current of each run is the mean of the identified currents.
    """
    values = dict(zip(found.model.names, found.values.tolist(), strict=True))
    means = {axis: float(np.mean([v for n, v in values.items() if is_current(n) and n.startswith(axis)]))
             for axis in CURRENT_NAMES}  # fmt: skip
    return np.array([means[name[:3]] if is_current(name) else values[name] for name in names_of(log)])


def error_bands(found: Identified, windows: Windows) -> Array | None:
    """Return half widths of bands with 95 % of the prediction errors, shape (_BINS, 6), None for too few predictions.

    They come from a cross-validation on the logs of the fit. The width is a conformal quantile for exchangeable
    predictions (V. Vovk, A. Gammerman and G. Shafer, Algorithmic Learning in a Random World, 2005, chapter 2). Errors
    of one run are correlated. Therefore the width is multiplied by the ratio of the quantiles of Student's t, for the
    number of runs or of parts of one run, and of the normal distribution.
    """
    log = found.model.log
    ages, errors, count = [], [], 0
    folds = _folds(found)
    for fold in folds:
        excluded = np.zeros(len(log.t), dtype=bool)
        excluded[fold] = True
        values = _with_mean_current(found, found.refitted_without(excluded), excluded)
        for starts in windows.starts(log):
            outputs = predicted(_model(found, log, starts), values, found.noise, windows.settle)
            for window in slices(starts, len(log.t)):
                if excluded[window].all():
                    count += 1
                else:
                    outputs[window] = np.nan
            _, age, error = prediction_errors(log, outputs, starts, windows)
            finite = np.isfinite(error).all(axis=1)
            ages.append(age[finite])
            errors.append(error[finite])
    bins, sizes = _bin(np.concatenate(ages), windows), np.abs(np.concatenate(errors))
    if count < _FEWEST or len(np.unique(bins)) < _BINS:
        return None
    level = min(1.0, COVERED * (1 + 1 / count))
    independent = len(log.starts) if len(log.starts) > 1 else len(folds)
    probability = 0.5 + 0.5 * COVERED
    factor = stats.t.ppf(probability, independent - 1) / stats.norm.ppf(probability)
    return np.array([factor * np.quantile(sizes[bins == k], level, axis=0) for k in range(_BINS)])


def _folds(found: Identified) -> list[Indices]:
    """Return the rows of each fold: several runs, or several segments of one run."""
    log, several = found.model.log, len(found.model.log.starts) > 1
    rows = np.arange(len(log.t))
    parts = [rows[part] for part in (log.runs if several else slices(found.model.starts, len(rows)))]
    n, count = len(parts), min(FOLDS, len(parts))
    groups = [parts[k::count] if several else parts[k * n // count : (k + 1) * n // count] for k in range(count)]
    return [np.concatenate(group) for group in groups]


def _with_mean_current(found: Identified, values: Array, excluded: NDArray[np.bool_]) -> Array:
    """Return parameters in which excluded runs have the mean current of the other runs."""
    log, names = found.model.log, found.model.names
    out = np.array([excluded[run].all() for run in log.runs])
    if not out.any() or out.all():
        return values
    values = values.copy()
    for axis in CURRENT_NAMES:
        at = np.array([j for j, name in enumerate(names) if is_current(name) and name.startswith(axis)])
        values[at[out]] = values[at[~out]].mean()
    return values


def _bin(age: Array, windows: Windows) -> Indices:
    return np.clip((age / windows.horizon * _BINS).astype(np.int64), 0, _BINS - 1)


def rms(errors: Array) -> tuple[float, float, float]:
    """Return the root mean squares of heading [rad], surge speed [m/s] and distance [m] of errors of shape (n, 6)."""
    x, y, psi, u, _, _ = np.sqrt(np.mean(errors**2, axis=0)).tolist()
    return psi, u, math.hypot(x, y)


def _manoeuvres(log: Log, outputs: Array) -> tuple[Manoeuvre, ...]:
    """Return the overshoots of zig-zags and the diameters of turns."""
    found, measured = [], unwrapped(log)
    for k, run in enumerate(log.runs):
        order = log.commands[run, 1]
        sides = np.where(np.abs(order) > _EXECUTE * np.abs(order).max(), np.sign(order), 0.0)
        at = np.flatnonzero(sides)
        reversals = np.flatnonzero(np.diff(sides[at])) if len(at) else at
        executes = list(pairwise([*at[:1].tolist(), *(at[reversals] + 1).tolist(), len(order)]))
        headings = measured[run, 2], outputs[run, 2]
        psi = headings[0]
        zigzag = len(at) and len(at) > _ZIG_ZAG * (len(order) - at[0])
        for name, which in (("first overshoot", 1), ("second overshoot", 2)):
            if zigzag and len(executes) > which + 1:  # the heading has turned back
                a, b = executes[which]
                side = -np.sign(order[a:b].sum())
                overshoots = [math.degrees(float((side * (rows[a:b] - psi[a])).max())) for rows in headings]
                found.append(Manoeuvre(k, name, *overshoots))
        for execute, b in executes:
            turned = np.abs(psi[execute:b] - psi[execute])
            a = execute + int(np.searchsorted(turned, 0.5 * math.pi))  # the turn is steady from there on
            if b - a > 2 and abs(psi[b - 1] - psi[a]) > 2 * math.pi:
                both = (_diameter(rows[run][a:b], log.steps[run][a:b]) for rows in (measured, outputs))
                found.append(Manoeuvre(k, "turning diameter", *both))
    return tuple(found)


def _diameter(rows: Array, steps: Array) -> float:
    """Return the diameter [m] of a turn: twice the distance over the angle."""
    distance = float(np.hypot(rows[:-1, 3], rows[:-1, 4]) @ steps[:-1])
    return 2 * distance / max(abs(float(rows[-1, 2] - rows[0, 2])), 1e-9)


def drawing(result: HeldOut) -> Drawing:
    """Return the figure of the measurements and of the predictions from the first measurements of each run."""
    log, measured, outputs = result.log, unwrapped(result.log), result.outputs
    figure, axes = panels(len(log.runs), 3, (9.0, 2.4 * len(log.runs)))
    for (*over_time, track), run in zip(axes, log.runs, strict=True):
        t = log.t[run] - log.t[run.start]
        age = np.maximum(t - result.windows.settle, 0.0)
        shown = age <= result.windows.horizon
        columns = (2, 180 / math.pi, "heading [degrees]"), (3, 1.0, "u [m/s]")
        for ax, (j, scale, name) in zip(over_time, columns, strict=True):
            ax.plot(t, scale * measured[run, j], color="0.6", linewidth=2.5)
            ax.plot(t, scale * outputs[run, j], color=COLOURS[0])
            if result.bands is not None:
                half = result.bands[_bin(age, result.windows), j]
                low, high = (scale * (outputs[run, j] + side * half) for side in (-1, 1))
                ax.fill_between(t[shown], low[shown], high[shown], color=COLOURS[0], alpha=0.2, linewidth=0)
            ax.axvline(result.windows.settle, color="0.85", linewidth=0.8)
            ax.set(xlabel="t [s]", ylabel=name)
        track.plot(measured[run, 1], measured[run, 0], color="0.6", linewidth=2.5)
        track.plot(outputs[run, 1], outputs[run, 0], color=COLOURS[0])
        track.set(xlabel="y [m]", ylabel="x [m]", aspect="equal", adjustable="datalim")
    return figure


def section(result: HeldOut, name: str) -> str:
    """Return the section of the report on held-out logs with a name, in Markdown."""
    w = result.windows
    lines = ["| prediction | heading [degrees] | surge speed [m/s] | position [m] |", "|---|--:|--:|--:|"]
    for predictor, (psi, u, position) in result.rms.items():
        lines.append(f"| {predictor} | {math.degrees(psi):.2f} | {u:.3f} | {position:.2f} |")
    parts = [
        "## Held-out runs\n\n![Measured and predicted](held-out.png)",
        (
            f"{name}: nothing was fitted to these runs. The initial state of each prediction is estimated from "
            f"{w.settle:.3g} s of measurements. The prediction then uses the logged commands alone, for "
            f"{w.horizon:.3g} s. A new one begins every {w.stride:.3g} s. Errors are root mean squares over that time. "
            "For comparison: a first-order Nomoto model of the yaw rate with constant speed, and constant velocities."
        ),
        "\n".join(lines),
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
        rows = ["| run | characteristic | measured | predicted |", "|--:|---|--:|--:|"]
        rows += [f"| {m.run + 1} | {m.name} | {m.measured:.2f} | {m.predicted:.2f} |" for m in result.manoeuvres]
        parts.append("\n".join(rows))
    return "\n\n".join(parts)
