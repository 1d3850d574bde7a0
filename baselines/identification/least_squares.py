"""Prediction errors as small as they can be: the first states are eliminated, the rest is `scipy.optimize`.

For given parameters the best first state of each segment is found by Gauss and Newton; the residuals are projected onto
what no first state can explain (L. Kaufman, "A variable projection method for solving separable nonlinear least squares
problems", BIT 15:49-57, 1975). The problem then has as many unknowns as parameters, however long the log is.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from auv_gym.physics.namespaces import Array, Indices
from baselines.identification.log import MEASURED_COLUMNS, unwrapped
from baselines.identification.model import LOG_STATES, LogModel

INNER = 4  # predictions on the way to the best first states
BLOWN_UP = 1e60  # [standard deviations] error that nothing is learned from
MOST = 30  # evaluations of a fit
REFUSED = 1e3  # [standard deviations] that a form counts as which is too small by 1
LEAST_FORM = 0.02  # of a linear form that must not be negative
_TOLERANCE = 1e-7  # relative change of the squared errors, or of the parameters, at which it ends


@dataclass(frozen=True)
class Left:
    """What parameters and their best first states leave of the measurements, in standard deviations."""

    states: Array  # x, y, psi, u, v, r at the segments' starts, shape (S, 6)
    errors: Array  # measured less predicted, shape (T, 6)
    slopes: Array  # of the errors by the free parameters, less what first states explain, shape (T, 6, F)


def first_states(model: LogModel) -> Array:
    """Return the measurements at the starts of the segments, shape (S, 6): where the search for states begins."""
    return np.asarray(unwrapped(model.log)[model.starts])


def leave(model: LogModel, values: Array, free: Indices, states: Array, noise: Array) -> Left | None:
    """Return what parameters leave, with the best first states near given ones; None where the prediction blows up.

    Args:
        model: the simulator on a log.
        values: of `model.names`, shape (P,).
        free: indices of those that the slopes are for, shape (F,).
        states: at the segments' starts, shape (S, 6).
        noise: standard deviations of the measurements, shape (6,).
    """
    measured, cuts = unwrapped(model.log), [*model.starts.tolist(), len(model.log.t)]
    segments = [slice(a, b) for a, b in itertools.pairwise(cuts)]
    best, moves, least = states, np.zeros_like(states), np.full(len(segments), np.inf)
    share = np.ones(len(segments))
    for last in (*(False,) * INNER, True):
        trial = best if last else best + share[:, None] * moves
        prediction = model.predict(values, trial, free if last else free[:0])
        errors, by_start = (measured - prediction.seen) / noise, prediction.by_start / noise[:, None]
        slopes = -prediction.by_value / noise[:, None]
        with np.errstate(over="ignore", invalid="ignore"):
            squares = np.add.reduceat(np.sum(errors**2, axis=1), model.starts)
        if not last:
            better = squares < least
            best, least = np.where(better[:, None], trial, best), np.where(better, squares, least)
            share = np.where(better, 1.0, 0.25 * share)  # back, where a whole step went too far
            moves = np.where(better[:, None], _moves(by_start, errors, segments), moves)
    if not all(np.abs(x).max(initial=0.0) < BLOWN_UP for x in (errors, slopes, by_start)):  # nor if it is no number
        return None
    for part in segments:
        basis, _ = np.linalg.qr(by_start[part].reshape(-1, LOG_STATES))
        both = np.column_stack((slopes[part].reshape(errors[part].size, len(free)), errors[part].ravel()))
        both -= basis @ (basis.T @ both)
        slopes[part], errors[part] = both[:, :-1].reshape(slopes[part].shape), both[:, -1].reshape(errors[part].shape)
    return Left(trial, errors, slopes)


def _moves(by_start: Array, errors: Array, segments: Sequence[slice]) -> Array:
    """Return the best changes of the first states, shape (S, 6); none where a prediction blows up."""
    found = np.zeros((len(segments), LOG_STATES))
    for i, part in enumerate(segments):
        if np.abs(by_start[part]).max() < BLOWN_UP and np.abs(errors[part]).max() < BLOWN_UP:
            slopes = by_start[part].reshape(-1, LOG_STATES)
            found[i] = np.linalg.lstsq(slopes, errors[part].ravel(), rcond=None)[0]
    return found


def fit(
    model: LogModel,
    values: Array,
    free: Indices,
    bounds: tuple[Array, Array],
    scales: Array,
    states: Array,
    noise: Array,
    forms: Array | None = None,
    sizes: Array | None = None,
    used: NDArray[np.bool_] | None = None,
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
        forms: linear forms of the parameters that must not fall below `LEAST_FORM`, shape (K, P).
        sizes: standard deviations of the parameters about 0 before the log is seen, shape (P,); infinite where nothing
            is known.
        used: the rows that count, shape (T,); None: all.

    Raises:
        ValueError: the prediction blows up at the values where the search begins.
    """
    forms = np.zeros((0, len(values))) if forms is None else forms
    prior = np.zeros(len(free)) if sizes is None else scales[free] / sizes[free]
    kept: dict[bytes, Left | None] = {}
    best, near = math.inf, states

    def at(x: Array) -> Left | None:
        nonlocal best, near
        if (key := x.tobytes()) not in kept:
            trial = values.copy()
            trial[free] = x * scales[free]
            kept[key] = found = leave(model, trial, free, near, noise)
            if found is not None and used is not None:
                found.errors[~used] = found.slopes[~used] = 0.0
            if found is not None and (cost := float(np.sum(found.errors**2))) < best:
                best, near = cost, found.states
                for other in kept.keys() - {key}:
                    del kept[other]
        return kept[key]

    def refused(x: Array) -> Array:
        """Return by how much the forms are too small."""
        trial = values.copy()
        trial[free] = x * scales[free]
        return np.asarray(np.minimum(forms @ trial - LEAST_FORM, 0.0))

    def errors(x: Array) -> Array:
        left = at(x)
        size = len(model.log.t) * len(MEASURED_COLUMNS)
        found = np.full(size, np.inf) if left is None else left.errors.ravel()
        return np.concatenate((found, REFUSED * refused(x), prior * x))

    def slopes(x: Array) -> Array:
        left = at(x)
        assert left is not None
        wrong = np.where(refused(x)[:, None] < 0, REFUSED * forms[:, free], 0.0)
        shown = np.concatenate((left.slopes.reshape(-1, len(free)), wrong)) * scales[free]
        return np.concatenate((shown, np.diag(prior)))

    low, high = (bound[free] / scales[free] for bound in bounds)
    begin = values[free] / scales[free]
    inside = 1e-9 * np.maximum(1.0, np.abs(begin))  # where SciPy leaves it as it is
    begin = np.clip(begin, low + inside, high - inside)
    if at(begin) is None:
        raise ValueError("the simulator blows up on this log; is the time step short enough for the vehicle?")
    done = least_squares(errors, begin, slopes, (low, high), ftol=_TOLERANCE, xtol=_TOLERANCE, gtol=None, max_nfev=MOST)
    found = values.copy()
    found[free] = done.x * scales[free]
    left = at(done.x)
    assert left is not None
    return found, left
