"""Predictions of held-out runs by an identified vehicle and by two simpler models.

The initial state of a prediction is estimated from a short interval of measurements. After it the prediction uses the
logged commands alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from auv_gym.physics.errors import to_body, to_world
from auv_gym.physics.namespaces import Array, Indices
from baselines.identification.log import Log, slices, unwrapped
from baselines.identification.model import LOG_STATES, LogModel

_STEPS = 6  # Gauss-Newton steps to an initial state


@dataclass(frozen=True)
class Windows:
    """Time windows of the predictions of a run; windows of the same offset do not overlap."""

    settle: float = 15.0  # [s] of measurements from which the initial state is estimated
    horizon: float = 60.0  # [s] of the prediction after them
    stride: float = 15.0  # [s] between the offsets

    def starts(self, log: Log) -> list[Indices]:
        """Return the first rows of the windows for each offset; they include the first rows of the runs."""
        length, result = self.settle + self.horizon, []
        for offset in np.arange(0.0, length, self.stride):
            rows = []
            for run in log.runs:
                t = log.t[run]
                times = np.arange(t[0] + offset, t[-1] - length + 0.5 * log.dt, length)
                rows += [run.start, *(run.start + np.searchsorted(t, times - 0.5 * log.dt)).tolist()]
            result.append(np.unique(rows))
        return result


def ages(log: Log, starts: Indices) -> Array:
    """Return the time [s] since the start of the window of each row, shape (T,)."""
    return np.concatenate([log.t[rows] - log.t[rows.start] for rows in slices(starts, len(log.t))])


def predicted(model: LogModel, values: Array, noise: Array, settle: float) -> Array:
    """Return predictions whose initial states are estimated from the first measurements of each segment, shape (T, 6).

    Args:
        model: the simulator with the commands of a log.
        values: values of `model.names`, shape (P,).
        noise: standard deviations of the measurements, shape (6,).
        settle: time [s] of these measurements; 0: the initial states are the first measurements.
    """
    measured, nothing = unwrapped(model.log), np.zeros(0, dtype=np.int64)
    early = ages(model.log, model.starts) <= settle
    states = measured[model.starts].copy()
    for _ in range(_STEPS if settle > 0 else 0):
        prediction = model.predict(values, states, nothing)
        errors, slopes = (measured - prediction.outputs) / noise, prediction.by_state / noise[:, None]
        for i, segment in enumerate(slices(model.starts, len(measured))):
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


def prediction_errors(log: Log, outputs: Array, starts: Indices, windows: Windows) -> tuple[Indices, Array, Array]:
    """Return rows of complete windows, the time [s] since the start of their prediction, and errors, shape (n, 6).

    The predictions `outputs` have shape (T, 6). Position errors are along and across the measured heading.
    """
    length = windows.settle + windows.horizon
    age, measured = ages(log, starts), unwrapped(log)
    complete = np.zeros(len(log.t), dtype=bool)
    for rows in slices(starts, len(log.t)):
        complete[rows] = log.t[rows.stop - 1] - log.t[rows.start] > length - 1.5 * log.dt
    chosen = np.flatnonzero(complete & (age >= windows.settle) & (age <= length))
    errors = measured - outputs
    c, s = np.cos(measured[:, 2]), np.sin(measured[:, 2])
    errors[:, 0], errors[:, 1] = to_body(errors[:, 0].copy(), errors[:, 1].copy(), c, s)
    return chosen, age[chosen] - windows.settle, errors[chosen]
