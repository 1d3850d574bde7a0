"""Predictions of runs that nothing is fitted to, with bands, beside two simpler predictions: `--holdout`."""

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
from baselines.identification.begin import is_current
from baselines.identification.fit import Identified
from baselines.identification.log import Log, unwrapped
from baselines.identification.model import LogModel
from baselines.identification.prediction import (
    Windows,
    constant_velocity,
    late_errors,
    nomoto,
    predicted,
)
from baselines.tools.figure_style import COLOURS, panels

FOLDS = 5
"""Parts of the logs, at most, that are left out in turn to see how far predictions may be off."""
COVERED = 0.95  # share of the errors that are inside the bands
_BINS = 12  # stretches of the horizon that a band is constant over
_FEWEST = 8  # predictions that a band needs
_EXECUTE = 0.8  # share of the largest command that counts as an order to one side
_ZIG_ZAG = 0.6  # share of the rows behind the first order that have one, in a zig-zag
PREDICTORS = ("model", "Nomoto", "constant velocity")
"""What is compared."""


@dataclass(frozen=True)
class Manoeuvre:
    """A figure of a run, as it was measured and as it is predicted from the begin of the run."""

    run: int
    name: str  # "first overshoot" [degrees], "second overshoot" [degrees], "turning diameter" [m]
    measured: float
    predicted: float


@dataclass(frozen=True)
class HeldOut:
    """How well runs are predicted that nothing was fitted to."""

    log: Log
    windows: Windows
    age: Array  # [s] since predictions have begun, shape (n,)
    run: Indices  # of each error, shape (n,)
    errors: Mapping[str, Array]  # by predictor: along, across [m], heading [rad], u, v [m/s], r [rad/s], shape (n, 6)
    bands: Array | None  # half widths along the horizon, shape (_BINS, 6); None where too little was seen
    manoeuvres: tuple[Manoeuvre, ...]
    seen: Array  # predicted from the begin of each run, shape (T, 6)

    @property
    def rms(self) -> dict[str, tuple[float, float, float]]:
        """Root mean squares by predictor: heading [rad], surge speed [m/s], place [m]."""
        return {name: rms(rows) for name, rows in self.errors.items()}

    @property
    def inside(self) -> Array:
        """Whether errors of the model are within the bands, shape (n, 6); nan without bands."""
        if self.bands is None:
            return np.full((len(self.age), 6), np.nan)
        return np.asarray(np.abs(self.errors["model"]) <= self.bands[_bin(self.age, self.windows)], dtype=np.float64)


def held_out(found: Identified, log: Log, windows: Windows | None = None) -> HeldOut:
    """Return how well an identified vehicle predicts a log, with the logged commands alone.

    Args:
        found: the vehicle.
        log: that it was not fitted to, with commands of the same kind.
        windows: how predictions are cut; None: about a quarter of the shortest run for the first state, up to 15 s,
            and then up to 60 s.

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
    times, runs = [], []
    row_runs = np.repeat(np.arange(len(log.runs)), [run.stop - run.start for run in log.runs])
    for starts in windows.starts(log):
        model = LogModel(log, starts, found.model.substeps, found.model.over_ground)
        seen = (
            predicted(model, values, found.noise, windows.settle),
            nomoto(train, log, starts, windows.settle),
            constant_velocity(log, starts, windows.settle),
        )
        for name, rows in zip(PREDICTORS, seen, strict=True):
            late, age, off = late_errors(log, rows, starts, windows)
            errors[name].append(off)
        times.append(age)
        runs.append(row_runs[late])
    age, every = np.concatenate(times), {name: np.concatenate(rows) for name, rows in errors.items()}
    if not len(age):
        raise ValueError(f"no held-out run is {windows.settle + windows.horizon:g} s long")
    bands = error_bands(found, windows)
    whole = LogModel(log, np.array(log.starts), found.model.substeps, found.model.over_ground)
    seen_whole = predicted(whole, values, found.noise, windows.settle)
    return HeldOut(log, windows, age, np.concatenate(runs), every, bands, _manoeuvres(log, seen_whole), seen_whole)


def values_for(found: Identified, log: Log) -> Array:
    """Return the parameters of an identified vehicle for another log; its current is the mean of those that were found.

    The array is in the order of `LogModel.names`, shape (P,).
    """
    own = dict(zip(found.model.names, found.values.tolist(), strict=True))
    mean = {axis: float(np.mean([v for n, v in own.items() if is_current(n) and n.startswith(axis)]))
            for axis in ("V_x", "V_y")}  # fmt: skip
    names = LogModel(log, np.array(log.starts)).names
    return np.array([mean[name[:3]] if is_current(name) else own[name] for name in names])


def error_bands(found: Identified, windows: Windows) -> Array | None:
    """Return half widths that hold 95 % of the errors of predictions, shape (_BINS, 6); None where there are too few.

    Parts of the logs are left out in turn, a vehicle is fitted to the others, and predicts what was left out. The width
    is the quantile of the errors that an exchangeable further one is below with that probability, each prediction
    counted once (V. Vovk, A. Gammerman and G. Shafer, Algorithmic Learning in a Random World, 2005, chapter 2). Errors
    of one run are alike, so the width is multiplied by the ratio of the quantiles of Student's t for the number of
    runs, or of parts of one run, and of the normal distribution.
    """
    log = found.model.log
    times, errors, counts = [], [], 0
    for part in _parts(found):
        rows = np.zeros(len(log.t), dtype=bool)
        rows[part] = True
        values = _without_current(found, found.without(rows), rows)
        for starts in windows.starts(log):
            model = LogModel(log, starts, found.model.substeps, found.model.over_ground)
            inside = np.where(np.add.reduceat(~rows, starts) == 0, 1, 0)  # segments that lie in the part as a whole
            counts += int(inside.sum())
            seen = predicted(model, values, found.noise, windows.settle)
            seen[~np.repeat(inside.astype(bool), np.diff(np.append(starts, len(rows))))] = np.nan
            _, age, off = late_errors(log, seen, starts, windows)
            good = np.isfinite(off).all(axis=1)
            times.append(age[good])
            errors.append(off[good])
    age, every = np.concatenate(times), np.abs(np.concatenate(errors))
    if counts < _FEWEST or not len(age):
        return None
    level = min(1.0, COVERED * (1 + 1 / counts))
    bins = _bin(age, windows)
    if len(np.unique(bins)) < _BINS:
        return None
    alike = len(log.starts) if len(log.starts) > 1 else len(_parts(found))
    tail = 0.5 + 0.5 * COVERED
    wider = stats.t.ppf(tail, alike - 1) / stats.norm.ppf(tail)
    return np.array([wider * np.quantile(every[bins == k], level, axis=0) for k in range(_BINS)])


def _parts(found: Identified) -> list[Indices]:
    """Return the rows of each part that is left out in turn: runs, or stretches of one run."""
    log = found.model.log
    cuts = list(log.starts) if len(log.starts) > 1 else found.model.starts.tolist()
    ends = [*cuts[1:], len(log.t)]
    count = min(FOLDS, len(cuts))
    if len(log.starts) > 1:
        groups = [range(k, len(cuts), count) for k in range(count)]
    else:
        groups = [range(k * len(cuts) // count, (k + 1) * len(cuts) // count) for k in range(count)]
    return [np.concatenate([np.arange(cuts[i], ends[i]) for i in group]) for group in groups]


def _without_current(found: Identified, values: Array, rows: NDArray[np.bool_]) -> Array:
    """Return parameters in which runs that were left out have the mean current of the others."""
    log, names = found.model.log, found.model.names
    out = [bool(rows[run].all()) for run in log.runs]
    if not any(out) or all(out):
        return values
    values = values.copy()
    for axis in ("V_x", "V_y"):
        at = np.array([j for j, name in enumerate(names) if is_current(name) and name.startswith(axis)])
        values[at[out]] = values[at[np.logical_not(out)]].mean()
    return values


def _bin(age: Array, windows: Windows) -> Indices:
    return np.clip((age / windows.horizon * _BINS).astype(np.int64), 0, _BINS - 1)


def rms(errors: Array) -> tuple[float, float, float]:
    """Return the root mean squares of heading [rad], surge speed [m/s] and distance [m]."""
    x, y, psi, u, _, _ = np.sqrt(np.mean(errors**2, axis=0)).tolist()
    return psi, u, math.hypot(x, y)


def _manoeuvres(log: Log, seen: Array) -> tuple[Manoeuvre, ...]:
    """Return the overshoots of zig-zags and the diameters of turns."""
    found, measured = [], unwrapped(log)
    for k, run in enumerate(log.runs):
        order = log.commands[run, 1]
        sides = np.where(np.abs(order) > _EXECUTE * np.abs(order).max(), np.sign(order), 0.0)
        at = np.flatnonzero(sides)
        turned_over = np.flatnonzero(np.diff(sides[at])) if len(at) else at
        executes = list(pairwise([*at[:1].tolist(), *(at[turned_over] + 1).tolist(), len(order)]))
        psi, guess = measured[run, 2], seen[run, 2]
        zigzag = len(at) and len(at) > _ZIG_ZAG * (len(order) - at[0])
        for name, which in (("first overshoot", 1), ("second overshoot", 2)):
            if zigzag and len(executes) > which + 1:  # it has been turned back
                a, b = executes[which]
                side = -np.sign(order[a:b].sum())
                ends = [math.degrees(float((side * (rows[a:b] - psi[a])).max())) for rows in (psi, guess)]
                found.append(Manoeuvre(k, name, *ends))
        for execute, b in executes:
            turned = np.abs(psi[execute:b] - psi[execute])
            a = execute + int(np.searchsorted(turned, 0.5 * math.pi))  # the turn is steady from there
            if b - a > 2 and abs(psi[b - 1] - psi[a]) > 2 * math.pi:
                both = (_diameter(rows[run][a:b], log.steps[run][a:b]) for rows in (measured, seen))
                found.append(Manoeuvre(k, "turning diameter", *both))
    return tuple(found)


def _diameter(rows: Array, steps: Array) -> float:
    """Return the diameter [m] of a turn: twice the way over the angle."""
    way = float(np.hypot(rows[:-1, 3], rows[:-1, 4]) @ steps[:-1])
    return 2 * way / max(abs(float(rows[-1, 2] - rows[0, 2])), 1e-9)


def drawing(result: HeldOut) -> Drawing:
    """Return the figure of what was measured and what is predicted from the begin of each run."""
    log, measured = result.log, unwrapped(result.log)
    count = len(log.runs)
    figure, axes = panels(count, 3, (9.0, 2.4 * count))
    for k, run in enumerate(log.runs):
        t = log.t[run] - log.t[run.start]
        after = np.maximum(t - result.windows.settle, 0.0)
        half = None if result.bands is None else result.bands[_bin(after, result.windows)]
        shown = after <= result.windows.horizon
        for ax, j, scale, name in (
            (axes[k][0], 2, 180 / math.pi, "heading [degrees]"),
            (axes[k][1], 3, 1.0, "u [m/s]"),
        ):
            ax.plot(t, scale * measured[run, j], color="0.6", linewidth=2.5)
            ax.plot(t, scale * result.seen[run, j], color=COLOURS[0])
            if half is not None:
                low, high = (scale * (result.seen[run, j] + side * half[:, j]) for side in (-1, 1))
                ax.fill_between(t[shown], low[shown], high[shown], color=COLOURS[0], alpha=0.2, linewidth=0)
            ax.axvline(result.windows.settle, color="0.85", linewidth=0.8)
            ax.set(xlabel="t [s]", ylabel=name)
        axes[k][2].plot(measured[run, 1], measured[run, 0], color="0.6", linewidth=2.5)
        axes[k][2].plot(result.seen[run, 1], result.seen[run, 0], color=COLOURS[0])
        axes[k][2].set(xlabel="y [m]", ylabel="x [m]", aspect="equal", adjustable="datalim")
    return figure


def section(result: HeldOut, name: str) -> str:
    """Return what the report says of the predictions, in Markdown."""
    w = result.windows
    lines = ["| prediction | heading [degrees] | surge speed [m/s] | place [m] |", "|---|--:|--:|--:|"]
    for predictor, (psi, u, place) in result.rms.items():
        lines.append(f"| {predictor} | {math.degrees(psi):.2f} | {u:.3f} | {place:.2f} |")
    parts = [
        "## Held-out runs\n\n![Measured and predicted](held-out.png)",
        (
            f"{name}: nothing was fitted to these runs. Each prediction begins at a state that {w.settle:.3g} s of "
            f"measurements show, and goes on for {w.horizon:.3g} s from the logged commands alone; a new one begins "
            f"every {w.stride:.3g} s. Errors are root mean squares over that time. Beside the model: a first-order "
            "Nomoto model of the yaw rate with the speed held, and constant velocities."
        ),
        "\n".join(lines),
    ]
    if result.bands is None:
        parts.append("The logs are too short for bands.")
    else:
        names = ("along", "across", "heading", "u", "v", "r")
        shares = ", ".join(f"{n} {100 * c:.0f} %" for n, c in zip(names, result.inside.mean(axis=0), strict=True))
        parts.append(
            "Bands are as wide as 95 % of the errors of predictions of parts of the other logs, each by a vehicle that "
            "was fitted without that part, times a factor of Student's t for the number of runs. "
            f"Inside of them: {shares} of these predictions."
        )
    if result.manoeuvres:
        rows = ["| run | figure | measured | predicted |", "|--:|---|--:|--:|"]
        rows += [f"| {m.run + 1} | {m.name} | {m.measured:.2f} | {m.predicted:.2f} |" for m in result.manoeuvres]
        parts.append("\n".join(rows))
    return "\n\n".join(parts)
