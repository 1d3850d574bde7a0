"""Predictions of held-out runs by an identified vehicle and by two simpler models, and their errors: `--holdout`.

The initial state of a prediction is estimated from a short interval of measurements. After it the prediction uses the
logged commands alone.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from auv_gym.physics.errors import to_body, to_world
from auv_gym.physics.namespaces import Array, Indices
from baselines.identification.fit import Identified
from baselines.identification.log import CONTROLS, MEASURED_COLUMNS, Log, slices, unwrapped
from baselines.identification.model import LOG_STATES, PREDICTION_TIME, LogModel

PREDICTORS = ("model", "Nomoto", "constant velocity")
"""Names of the compared models."""
FOLDS = 5
"""Largest number of folds of the cross-validation for error bands."""
COVERED = 0.95  # nominal share of the errors inside the bands
_STEPS = 6  # Gauss-Newton steps to an initial state
_BINS = 12  # intervals of the horizon in which a band is constant
_FEWEST = 8  # least number of predictions for a band
_EXECUTE = 0.8  # share of the largest command from which a command counts as an execute to one side
_MARGIN, _NOISE = 0.05, 3.0  # share of the largest value, and of the noise, that are allowed beyond the range of a fit
_ZIG_ZAG = 0.6  # least share of the rows after the first execute with an execute, in a zig-zag


@dataclass(frozen=True)
class Windows:
    """Time windows of the predictions of a run: one begins every `settle` seconds."""

    settle: float  # [s] of measurements from which the initial state is estimated
    horizon: float  # [s] of the prediction after them

    @classmethod
    def of(cls, log: Log) -> Windows:
        """Return the windows for a log: 15 s and 60 s, less if the shortest run is too short."""
        shortest = min(float(log.t[run][-1] - log.t[run][0]) for run in log.runs)
        return cls(min(15.0, 0.2 * shortest), min(PREDICTION_TIME, 0.75 * shortest))

    def starts(self, log: Log) -> list[Indices]:
        """Return the first rows of windows that do not overlap, for each offset; they include those of the runs."""
        length, result = self.settle + self.horizon, []
        for offset in np.arange(0.0, length, self.settle):
            rows = []
            for run in log.runs:
                t = log.t[run]
                times = np.arange(t[0] + offset, t[-1] - length + 0.5 * log.dt, length)
                rows += [run.start, *(run.start + np.searchsorted(t, times - 0.5 * log.dt)).tolist()]
            result.append(np.unique(rows))
        return result

    def bins(self, age: Array) -> Indices:
        """Return the part of the horizon, 0 ... _BINS - 1, for times [s] since the start of the prediction."""
        return np.clip((age / self.horizon * _BINS).astype(np.int64), 0, _BINS - 1)


@dataclass(frozen=True)
class Manoeuvre:
    """A measured characteristic of a manoeuvre and its prediction from the first measurements of the run."""

    run: int
    name: str  # "first overshoot" [degrees], "second overshoot" [degrees], "turning diameter" [m]
    measured: float
    predicted: float


@dataclass(frozen=True)
class Extrapolation:
    """A quantity that leaves the range of the fit in a held-out run."""

    run: int
    name: str  # of a column; "|r|" for the magnitude of r
    reached: tuple[float, float]  # least and largest value in the run
    fitted: tuple[float, float]  # the same in the logs of the fit


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
    extrapolations: tuple[Extrapolation, ...]

    @property
    def rms(self) -> dict[str, tuple[float, float, float]]:
        """Root mean square errors by model: heading [rad], surge speed [m/s], position [m]."""
        return {name: rms(rows) for name, rows in self.errors.items()}

    @property
    def inside(self) -> Array:
        """Whether errors of the identified model are within the bands, shape (n, 6); nan without bands."""
        if self.bands is None:
            return np.full((len(self.age), 6), np.nan)
        return np.asarray(np.abs(self.errors["model"]) <= self.bands[self.windows.bins(self.age)], dtype=np.float64)


def rms(errors: Array) -> tuple[float, float, float]:
    """Return the root mean squares of heading [rad], surge speed [m/s] and distance [m] of errors of shape (n, 6)."""
    x, y, psi, u, _, _ = np.sqrt(np.mean(errors**2, axis=0)).tolist()
    return psi, u, math.hypot(x, y)


def held_out(identified: Identified, log: Log) -> HeldOut:
    """Return the prediction errors of an identified vehicle on held-out runs, from the logged commands alone.

    Args:
        identified: the identified vehicle.
        log: the held-out runs, with commands of the same kind.

    Raises:
        ValueError: the commands are of another kind, or no run is long enough.
    """
    train = identified.model.log
    if (log.kind, log.wind is None) != (train.kind, train.wind is None):
        raise ValueError(f"the held-out log has commands of {log.kind}, the others of {train.kind}, or one lacks wind")
    windows = Windows.of(log)
    settle = windows.settle
    parameters, currents, lag = np.split(identified.values, (-1 - 2 * len(train.runs), -1))
    values = np.concatenate((parameters, np.tile(currents.reshape(-1, 2).mean(axis=0), len(log.runs)), lag))
    predictors: tuple[Callable[[Indices], Array], ...] = (
        lambda starts: _predicted(identified, log, starts, values, settle),
        lambda starts: nomoto(train, log, starts, settle),
        lambda starts: constant_velocity(log, starts, settle),
    )
    errors = {}
    for name, predict in zip(PREDICTORS, predictors, strict=True):
        rows, age, errors[name] = _errors(log, windows, predict)
    if not len(rows):
        raise ValueError(f"no held-out run is {settle + windows.horizon:g} s long")
    runs = np.searchsorted(log.starts, rows, side="right") - 1
    outputs = predictors[0](np.array(log.starts))
    bands, manoeuvres = _error_bands(identified, windows), _manoeuvres(log, outputs)
    beyond = extrapolations(train, log, identified.noise)
    return HeldOut(log, windows, age, runs, errors, bands, manoeuvres, outputs, beyond)


def extrapolations(train: Log, log: Log, noise: Array) -> tuple[Extrapolation, ...]:
    """Return the speeds, yaw rates and commands of held-out runs that are beyond those of the fit.

    Sway, yaw and rudder count by magnitude, since the equations are the same to both sides.

    Args:
        train: the logs of the fit.
        log: the held-out runs, with commands of the same kind.
        noise: standard deviations of x, y, psi, u, v, r, shape (6,).
    """
    fitted, result = _ranges(train, slice(None)), []
    for k, run in enumerate(log.runs):
        for (name, reached), sigma in zip(_ranges(log, run).items(), (*noise[3:], 0.0, 0.0), strict=True):
            low, high = fitted[name]
            margin = _MARGIN * max(abs(low), abs(high)) + _NOISE * float(sigma)
            if not low - margin <= reached[0] <= reached[1] <= high + margin:
                result.append(Extrapolation(k, name, reached, (low, high)))
    return tuple(result)


def _ranges(log: Log, rows: slice) -> dict[str, tuple[float, float]]:
    """Return the least and the largest speeds, yaw rate and commands in some rows, by name."""
    names, values = (*MEASURED_COLUMNS[3:], *CONTROLS[log.kind]), (*log.measured[rows, 3:].T, *log.commands[rows].T)
    ahead = "u", CONTROLS[log.kind][0]
    columns = {
        name if name in ahead else f"|{name}|": x if name in ahead else np.abs(x)
        for name, x in zip(names, values, strict=True)
    }
    return {name: (float(x.min()), float(x.max())) for name, x in columns.items()}


def _ages(log: Log, starts: Indices) -> Array:
    """Return the time [s] since the start of the window of each row, shape (T,)."""
    return np.concatenate([log.t[rows] - log.t[rows.start] for rows in slices(starts, len(log.t))])


def _predicted(identified: Identified, log: Log, starts: Indices, values: Array, settle: float) -> Array:
    """Return predictions of a log, shape (T, 6), from initial states that fit the first `settle` [s] of measurements.

    `starts` are the first rows of the predictions, `values` the parameters of the vehicle for this log.
    """
    model = LogModel(log, starts, identified.model.substeps, identified.model.over_ground)
    measured, noise, nothing = unwrapped(log), identified.noise, np.zeros(0, dtype=np.int64)
    early = _ages(log, starts) <= settle
    states = measured[starts].copy()
    for _ in range(_STEPS):
        prediction = model.predict(values, states, nothing)
        errors, slopes = (measured - prediction.outputs) / noise, prediction.by_state / noise[:, None]
        if log.seen is not None:
            errors, slopes = errors * log.seen, slopes * log.seen[:, :, None]
        for i, segment in enumerate(slices(starts, len(measured))):
            rows = slice(segment.start, segment.start + int(early[segment].sum()))
            states[i] += np.linalg.lstsq(slopes[rows].reshape(-1, LOG_STATES), errors[rows].ravel(), rcond=None)[0]
    return model.predict(values, states, nothing).outputs


def constant_velocity(log: Log, starts: Indices, settle: float) -> Array:
    """Return predictions with constant surge, sway and yaw velocity, the means of the last five rows, shape (T, 6).

    They begin `settle` [s] after the first rows of the windows, `starts`.
    """
    measured, result = unwrapped(log), unwrapped(log)
    for rows in slices(starts, len(log.t)):
        t = log.t[rows]
        first = rows.start + int(np.searchsorted(t - t[0], settle))
        ahead = log.t[first : rows.stop] - log.t[first]
        u, v, r = measured[max(rows.start, first - 4) : first + 1, 3:].mean(axis=0)
        psi = measured[first, 2] + r * ahead
        steps = np.append(0.0, np.diff(ahead))
        x_dot, y_dot = to_world(u, v, np.cos(psi), np.sin(psi))
        pose = (measured[first, 0] + np.cumsum(steps * x_dot), measured[first, 1] + np.cumsum(steps * y_dot), psi)
        result[first : rows.stop] = np.column_stack((*pose, *(np.full(len(ahead), x) for x in (u, v, r))))
    return result


def nomoto(train: Log, log: Log, starts: Indices, settle: float) -> Array:
    """Return predictions of a first-order Nomoto model of the yaw rate with constant speeds, shape (T, 6).

    They begin `settle` [s] after the first rows of the windows, `starts`. The model T r' + r = K (command - neutral) is
    fitted to the changes from row to row of the log `train` by least squares (K. Nomoto, T. Taguchi, K. Honda and S.
    Hirano, "On the steering qualities of ships", Int. Shipbuild. Prog. 4:354-370, 1957).
    """
    rows = np.concatenate([np.arange(run.start, run.stop - 1) for run in train.runs])
    r, one = train.measured[:, 5], np.ones(len(rows))
    share = train.steps[rows] / train.dt
    regressors = np.column_stack((r[rows], train.commands[rows, 1], one)) * share[:, None]
    slope = np.linalg.lstsq(regressors, r[rows + 1] - r[rows], rcond=None)[0]
    result, steps = constant_velocity(log, starts, settle), log.steps
    for window in slices(starts, len(log.t)):
        first = window.start + int(np.searchsorted(log.t[window] - log.t[window.start], settle))
        for k in range(first, window.stop - 1):
            x, y, psi, u, v, r_k = result[k]
            r_k = r_k + steps[k] / train.dt * (slope @ (r_k, log.commands[k, 1], 1.0))
            psi = psi + steps[k] * 0.5 * (result[k, 5] + r_k)
            x_dot, y_dot = to_world(u, v, np.cos(psi), np.sin(psi))
            result[k + 1] = x + steps[k] * x_dot, y + steps[k] * y_dot, psi, u, v, r_k
    return result


def _errors(log: Log, windows: Windows, predict: Callable[[Indices], Array]) -> tuple[Indices, Array, Array]:
    """Return rows of complete windows, the time [s] since the start of their prediction, and errors, shape (n, 6).

    `predict` returns predictions, shape (T, 6), in windows with given first rows. Position errors are along and across
    the measured heading.
    """
    measured, length = unwrapped(log), windows.settle + windows.horizon
    c, s = np.cos(measured[:, 2]), np.sin(measured[:, 2])
    parts = []
    for starts in windows.starts(log):
        age, complete, errors = _ages(log, starts), np.zeros(len(log.t), dtype=bool), measured - predict(starts)
        for part in slices(starts, len(log.t)):
            complete[part] = log.t[part.stop - 1] - log.t[part.start] > length - 1.5 * log.dt
        chosen = np.flatnonzero(complete & (age >= windows.settle) & (age <= length))
        errors[:, 0], errors[:, 1] = to_body(errors[:, 0].copy(), errors[:, 1].copy(), c, s)
        parts.append((chosen, age[chosen] - windows.settle, errors[chosen]))
    rows, ages, every = zip(*parts, strict=True)
    return np.concatenate(rows), np.concatenate(ages), np.concatenate(every)


def _error_bands(identified: Identified, windows: Windows) -> Array | None:
    """Return half widths of bands with 95 % of the prediction errors, shape (_BINS, 6), None for too few predictions.

    They come from a cross-validation on the logs of the fit. The width is a conformal quantile for exchangeable
    predictions (V. Vovk, A. Gammerman and G. Shafer, Algorithmic Learning in a Random World, 2005, chapter 2). Errors
    of one run are correlated. Therefore the width is multiplied by the ratio of the quantiles of Student's t, for the
    number of runs or of parts of one run, and of the normal distribution.
    """
    log, several = identified.model.log, len(identified.model.log.starts) > 1
    parts = log.runs if several else slices(identified.model.starts, len(log.t))
    n, folds = len(parts), min(FOLDS, len(parts))
    count, ages, sizes = 0, [], []
    for k in range(folds):
        excluded = np.zeros(len(log.t), dtype=bool)
        for part in parts[k::folds] if several else parts[k * n // folds : (k + 1) * n // folds]:
            excluded[part] = True
        values = identified.refitted_without(excluded)
        currents, out = values[-1 - 2 * len(log.runs) : -1].reshape(-1, 2), [excluded[run].all() for run in log.runs]
        if any(out) and not all(out):  # excluded runs have the mean current of the others
            currents[out] = currents[np.invert(out)].mean(axis=0)

        def predict(starts: Indices, values: Array = values, excluded: NDArray[np.bool_] = excluded) -> Array:
            outputs = _predicted(identified, log, starts, values, windows.settle)
            for window in slices(starts, len(log.t)):
                if not excluded[window].all():
                    outputs[window] = np.nan
            return outputs

        count += sum(bool(excluded[w].all()) for starts in windows.starts(log) for w in slices(starts, len(log.t)))
        _, age, errors = _errors(log, windows, predict)
        finite = np.isfinite(errors).all(axis=1)
        ages.append(age[finite])
        sizes.append(np.abs(errors[finite]))
    bins, size = windows.bins(np.concatenate(ages)), np.concatenate(sizes)
    if count < _FEWEST or len(np.unique(bins)) < _BINS:
        return None
    level, probability = min(1.0, COVERED * (1 + 1 / count)), 0.5 + 0.5 * COVERED
    factor = stats.t.ppf(probability, (len(log.runs) if several else folds) - 1) / stats.norm.ppf(probability)
    return np.array([factor * np.quantile(size[bins == k], level, axis=0) for k in range(_BINS)])


def _manoeuvres(log: Log, outputs: Array) -> tuple[Manoeuvre, ...]:
    """Return the overshoots of zig-zags and the diameters of turns."""
    manoeuvres, measured = [], unwrapped(log)
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
                manoeuvres.append(Manoeuvre(k, name, *overshoots))
        for execute, b in executes:
            turned = np.abs(psi[execute:b] - psi[execute])
            a = execute + int(np.searchsorted(turned, 0.5 * math.pi))  # the turn is steady from there on
            if b - a > 2 and abs(psi[b - 1] - psi[a]) > 2 * math.pi:
                turns = (rows[run][a:b] for rows in (measured, outputs))
                distances = [(turn, float(np.hypot(*turn[:-1, 3:5].T) @ log.steps[run][a : b - 1])) for turn in turns]
                diameters = (2 * d / max(abs(float(turn[-1, 2] - turn[0, 2])), 1e-9) for turn, d in distances)
                manoeuvres.append(Manoeuvre(k, "turning diameter", *diameters))
    return tuple(manoeuvres)
