"""Prediction errors as small as they can be: the first states are eliminated, the rest is `scipy.optimize`.

For given parameters the best first state of each segment is found by Gauss and Newton; what is left is projected onto
what no first state can explain (L. Kaufman, "A variable projection method for solving separable nonlinear least squares
problems", BIT 15:49-57, 1975). The problem then has as many unknowns as parameters, however long the log is.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from auv_gym.physics.namespaces import Array, Indices
from baselines.identification.log import MEASURED_COLUMNS, unwrapped
from baselines.identification.model import LOG_STATES, LogModel

INNER = 5  # most steps to the best first states
_SETTLED = 1e-6  # [standard deviations] change of the predictions at which they are found
BLOWN_UP = 1e60  # [standard deviations] error that nothing is learned from
MOST = 30  # evaluations of a fit
_TOLERANCE = 1e-7  # relative change of the squared errors, or of the parameters, at which it ends


@dataclass(frozen=True)
class Left:
    """What parameters and their best first states leave of the measurements, in standard deviations."""

    states: Array  # x, y, psi, u, v, r at the segments' starts, shape (S, 6)
    errors: Array  # measured less predicted, shape (T, 6)
    slopes: Array  # of the errors by the free parameters, less what first states explain, shape (T, 6, F)
    raw: Array  # the same with first states held, shape (T, 6, F)


def first_states(model: LogModel) -> Array:
    """Return the measurements at the starts of the segments, shape (S, 6): where the search for states begins."""
    return np.asarray(unwrapped(model.log)[model.starts])


def leave(model: LogModel, values: Array, free: Indices, states: Array, noise: Array) -> Left | None:
    """Return what parameters leave, with the best first states near given ones; None where the prediction blows up.

    Args:
        model: the simulator on a log.
        values: of `model.FITTED_PARAMETERS`, shape (P,).
        free: indices of those that the slopes are for, shape (F,).
        states: at the segments' starts, shape (S, 6).
        noise: standard deviations of the measurements, shape (6,).
    """
    measured, cuts = unwrapped(model.log), [*model.starts.tolist(), len(model.log.t)]
    segments = [slice(a, b) for a, b in itertools.pairwise(cuts)]
    for _ in range(INNER):
        prediction = model.predict(values, states)
        errors = (measured - prediction.seen) / noise
        raw = -prediction.by_value[:, :, free] / noise[:, None]
        by_start = prediction.by_start / noise[:, None]
        if not all(np.abs(part).max() < BLOWN_UP for part in (errors, raw, by_start)):  # nor if it is no number
            return None
        bases, moves = [], np.empty_like(states)
        change = 0.0
        for i, part in enumerate(segments):
            q, triangle = np.linalg.qr(by_start[part].reshape(-1, LOG_STATES))
            along = q.T @ errors[part].ravel()
            moves[i] = np.linalg.lstsq(triangle, along, rcond=None)[0]
            change = max(change, float(np.abs(along).max()))
            bases.append(q)
        if change < _SETTLED:
            break
        states = states + moves
    slopes, projected = np.empty_like(raw), np.empty_like(errors)
    for q, part in zip(bases, segments, strict=True):
        both = np.column_stack((raw[part].reshape(-1, len(free)), errors[part].ravel()))
        both -= q @ (q.T @ both)
        slopes[part], projected[part] = both[:, :-1].reshape(raw[part].shape), both[:, -1].reshape(errors[part].shape)
    return Left(states, projected, slopes, raw)


def fit(
    model: LogModel,
    values: Array,
    free: Indices,
    bounds: tuple[Array, Array],
    scales: Array,
    states: Array,
    noise: Array,
) -> tuple[Array, Left]:
    """Return the parameters with the least squared prediction errors, shape (P,), and what they leave.

    Args:
        model: the simulator on a log.
        values: where the search begins, within the bounds, shape (P,).
        free: indices of the parameters that are searched for, shape (F,).
        bounds: least and largest values, shape (P,) each.
        scales: changes of the parameters that matter, shape (P,).
        states: where the search for first states begins, shape (S, 6).
        noise: standard deviations of the measurements, shape (6,).

    Raises:
        ValueError: the prediction blows up at the values where the search begins.
    """
    kept: dict[bytes, Left | None] = {}
    best, near = math.inf, states

    def at(x: Array) -> Left | None:
        nonlocal best, near
        if (key := x.tobytes()) not in kept:
            trial = values.copy()
            trial[free] = x * scales[free]
            kept[key] = found = leave(model, trial, free, near, noise)
            if found is not None and (cost := float(np.sum(found.errors**2))) < best:
                best, near = cost, found.states
                for other in kept.keys() - {key}:
                    del kept[other]
        return kept[key]

    def errors(x: Array) -> Array:
        left = at(x)
        return np.full(len(model.log.t) * len(MEASURED_COLUMNS), np.inf) if left is None else left.errors.ravel()

    def slopes(x: Array) -> Array:
        left = at(x)
        assert left is not None
        return np.asarray(left.slopes.reshape(-1, len(free)) * scales[free])

    begin = values[free] / scales[free]
    if at(begin) is None:
        raise ValueError("the simulator blows up on this log; is the time step short enough for the vehicle?")
    low, high = (bound[free] / scales[free] for bound in bounds)
    done = least_squares(errors, begin, slopes, (low, high), ftol=_TOLERANCE, xtol=_TOLERANCE, gtol=None, max_nfev=MOST)
    found = values.copy()
    found[free] = done.x * scales[free]
    left = at(done.x)
    assert left is not None
    return found, left
