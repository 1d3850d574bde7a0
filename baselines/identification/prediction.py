"""What an identified vehicle predicts of runs that it was not fitted to, and what two simpler predictions make of them.

A prediction begins at a state that is estimated from a short stretch of measurements, and goes on from the logged
commands alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from auv_gym.physics.errors import to_body, to_world
from auv_gym.physics.namespaces import Array, Indices
from baselines.identification.log import Log, unwrapped
from baselines.identification.model import LOG_STATES, LogModel

_STEPS = 6  # to the state at which a prediction begins


@dataclass(frozen=True)
class Windows:
    """How predictions are cut from a run: all of them as long, one behind the other, begun again at several offsets."""

    settle: float = 15.0  # [s] of measurements that the first state is estimated from
    horizon: float = 60.0  # [s] that are predicted behind them
    stride: float = 15.0  # [s] from the begin of a prediction to the next one

    def starts(self, log: Log) -> list[Indices]:
        """Return the rows at which predictions begin, those of one offset together; runs' starts are among them."""
        length, found = self.settle + self.horizon, []
        for offset in np.arange(0.0, length, self.stride):
            rows = []
            for run in log.runs:
                t = log.t[run]
                begins = np.arange(t[0] + offset, t[-1] - length + 0.5 * log.dt, length)
                rows += [run.start, *(run.start + np.searchsorted(t, begins - 0.5 * log.dt)).tolist()]
            found.append(np.unique(rows))
        return found


def ages(log: Log, starts: Indices) -> Array:
    """Return the time [s] since the segment of each row has begun, shape (T,)."""
    lengths = np.diff(np.append(starts, len(log.t)))
    return np.asarray(log.t - np.repeat(log.t[starts], lengths))


def predicted(model: LogModel, values: Array, noise: Array, settle: float) -> Array:
    """Return what the model predicts from states that the begin of each segment shows, shape (T, 6).

    Args:
        model: the simulator on a log.
        values: of `model.names`, shape (P,).
        noise: standard deviations of the measurements, shape (6,).
        settle: length [s] of that begin; 0: the states are the measurements there.
    """
    measured, nothing = unwrapped(model.log), np.zeros(0, dtype=np.int64)
    early = ages(model.log, model.starts) <= settle
    states = measured[model.starts].copy()
    ends = np.append(model.starts, len(measured))
    for _ in range(_STEPS if settle > 0 else 0):
        prediction = model.predict(values, states, nothing)
        errors, slopes = (measured - prediction.seen) / noise, prediction.by_start / noise[:, None]
        for i, (a, b) in enumerate(pairwise(ends.tolist())):
            rows = slice(a, a + int(early[a:b].sum()))
            states[i] += np.linalg.lstsq(slopes[rows].reshape(-1, LOG_STATES), errors[rows].ravel(), rcond=None)[0]
    return model.predict(values, states, nothing).seen


def constant_velocity(log: Log, starts: Indices, settle: float) -> Array:
    """Return what goes on with the mean surge, sway and yaw velocity of the begin of each segment, shape (T, 6)."""
    measured, found = unwrapped(log), unwrapped(log)
    for a, b in zip(starts, np.append(starts[1:], len(log.t)), strict=True):
        age = log.t[a:b] - log.t[a]
        at = a + int(np.searchsorted(age, settle))
        ahead = log.t[at:b] - log.t[at]
        u, v, r = measured[max(a, at - 4) : at + 1, 3:].mean(axis=0)
        psi = measured[at, 2] + r * ahead
        steps = np.append(0.0, np.diff(ahead))
        x_dot, y_dot = to_world(u, v, np.cos(psi), np.sin(psi))
        rows = (measured[at, 0] + np.cumsum(steps * x_dot), measured[at, 1] + np.cumsum(steps * y_dot), psi)
        found[at:b] = np.column_stack((*rows, *(np.full(b - at, x) for x in (u, v, r))))
    return found


def nomoto(train: Log, log: Log, starts: Indices, settle: float) -> Array:
    """Return what a first-order Nomoto model of the yaw rate predicts, with the speeds held, shape (T, 6).

    T r' + r = K (command - neutral) (K. Nomoto, T. Taguchi, K. Honda and S. Hirano, "On the steering qualities of
    ships", Int. Shipbuild. Prog. 4:354-370, 1957), from row to row by least squares on another log.
    """
    rows = np.concatenate([np.arange(run.start, run.stop - 1) for run in train.runs])
    r, one = train.measured[:, 5], np.ones(len(rows))
    share = train.steps[rows] / train.dt
    known = np.column_stack((r[rows], train.commands[rows, 1], one)) * share[:, None]
    slope = np.linalg.lstsq(known, r[rows + 1] - r[rows], rcond=None)[0]
    found, steps = constant_velocity(log, starts, settle), log.steps
    for a, b in zip(starts, np.append(starts[1:], len(log.t)), strict=True):
        first = a + int(np.searchsorted(log.t[a:b] - log.t[a], settle))
        for k in range(first, b - 1):
            x, y, psi, u, v, r_k = found[k]
            r_k = r_k + steps[k] / train.dt * (slope @ (r_k, log.commands[k, 1], 1.0))
            psi = psi + steps[k] * 0.5 * (found[k, 5] + r_k)
            x_dot, y_dot = to_world(u, v, np.cos(psi), np.sin(psi))
            found[k + 1] = x + steps[k] * x_dot, y + steps[k] * y_dot, psi, u, v, r_k
    return found


def late_errors(log: Log, seen: Array, starts: Indices, windows: Windows) -> tuple[Indices, Array, Array]:
    """Return rows of whole windows, the time since their prediction has begun [s], and its errors, shape (n, 6).

    Errors of the place are along and across the measured heading.
    """
    length = windows.settle + windows.horizon
    age, measured = ages(log, starts), unwrapped(log)
    long = np.zeros(len(log.t), dtype=bool)
    for a, b in zip(starts, np.append(starts[1:], len(log.t)), strict=True):
        long[a:b] = log.t[b - 1] - log.t[a] > length - 1.5 * log.dt
    rows = np.flatnonzero(long & (age >= windows.settle) & (age <= length))
    errors = measured - seen
    c, s = np.cos(measured[:, 2]), np.sin(measured[:, 2])
    errors[:, 0], errors[:, 1] = to_body(errors[:, 0].copy(), errors[:, 1].copy(), c, s)
    return rows, age[rows] - windows.settle, errors[rows]
