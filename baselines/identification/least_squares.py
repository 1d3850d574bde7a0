"""Nonlinear least squares on prediction errors, with the initial states of segments eliminated.

For given parameters the best initial state of each segment is found by Gauss-Newton steps. The residuals are projected
onto the space that is orthogonal to the effect of the initial states (L. Kaufman, "A variable projection method for
solving separable nonlinear least squares problems", BIT 15:49-57, 1975). The number of unknowns is then that of the
parameters, for any length of the log. `scipy.optimize.least_squares` solves the reduced problem.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from auv_gym.physics.namespaces import Array, Indices
from auv_gym.physics.vehicle import CrossTerms
from baselines.identification.log import MEASURED_COLUMNS, slices, unwrapped
from baselines.identification.model import CROSS_TERMS, LOG_STATES, LogModel

INNER = 4  # Gauss-Newton steps to the best initial states
DIVERGENT_ERROR = 1e60  # [standard deviations] error from which a prediction counts as divergent
MAX_EVALUATIONS = 30  # of a fit
PENALTY = 1e3  # [standard deviations] residual of a constraint that is violated by 1
LEAST_CONSTRAINT = 0.02  # least value of a linear constraint
_TOLERANCE = 1e-7  # relative change of the squared errors, or of the parameters, at which a fit ends
_RATIOS = np.geomspace(1e-2, 1e2, 33)  # of yaw rate and sway velocity at which damping must be dissipative


@dataclass(frozen=True)
class InitialValues:
    """Initial values of a fit, with scales and bounds of the parameters and the names of the free ones."""

    values: Array  # of `LogModel.names`, shape (P,)
    scales: Array  # typical changes, shape (P,)
    bounds: tuple[Array, Array]  # least and largest values, shape (P,) each
    free: tuple[str, ...]  # names of the free parameters
    shares: Mapping[str, float]  # force per unit of a coefficient, as a share of all forces
    prior: Array | None = None  # standard deviations of a normal prior with mean 0, shape (P,); infinite: no prior

    def constraints(self, names: Sequence[str]) -> Array:
        """Return linear forms of the parameters `names`, shape (K, P), that are negative where damping adds power.

        They are those of `CrossTerms.slopes`, in units in which the scales of Y_vv and N_rr are 1. Without a free cross
        term there are none.
        """
        if not set(CROSS_TERMS) & set(self.free):
            return np.zeros((0, len(names)))
        at = {name: names.index(name) for name in (*CROSS_TERMS, "Y_vv", "N_rr")}
        unit = np.cbrt(self.scales[at["N_rr"]] / self.scales[at["Y_vv"]])
        rows = np.eye(len(names))
        cross = CrossTerms._make([*(rows[at[name]] for name in CROSS_TERMS), 0.0, 0.0, 0.0])
        ratios = _RATIOS[:, None] / unit
        forms = [
            sum(c * ratios**k for k, c in enumerate(slope)) / self.scales[at["Y_vv"]]
            for slope in cross.slopes(rows[at["Y_vv"]], rows[at["N_rr"]])
        ]
        return np.concatenate(forms) / np.tile(1 + _RATIOS[:, None] ** 3, (2, 1))


@dataclass(frozen=True)
class Residuals:
    """Residuals for given parameters and the best initial states, in standard deviations of the noise."""

    states: Array  # x, y, psi, u, v, r at the first rows of the segments, shape (S, 6)
    errors: Array  # measured minus predicted, shape (T, 6)
    slopes: Array  # derivatives of the errors by the free parameters, projected like them, shape (T, 6, F)
    seen: NDArray[np.bool_] | None = (
        None  # measurements that count, shape (T, 6), see `Log`; the others have errors of 0
    )
    bases: Array | None = None  # orthonormal basis, for each segment, of what its initial state explains, (T, 6, 6)

    def counted(self, rows: slice, column: int) -> slice | Indices:
        """Return those of some rows in which a measurement counts."""
        return rows if self.seen is None else np.arange(rows.start, rows.stop)[self.seen[rows, column]]


def measured_states(model: LogModel) -> Array:
    """Return the measurements at the first rows of the segments, shape (S, 6), as initial states of a fit."""
    return np.asarray(unwrapped(model.log)[model.starts])


def residuals(model: LogModel, values: Array, free: Indices, states: Array, noise: Array) -> Residuals | None:
    """Return the residuals of parameters, shape (P,), with the best initial states, None if the prediction diverges.

    Derivatives are those by the parameters at the positions `free`. `states` are a first guess of the initial states,
    shape (S, 6), and `noise` the standard deviations of the measurements, shape (6,).
    """
    measured, segments = unwrapped(model.log), slices(model.starts, len(model.log.t))
    best, changes, least = states, np.zeros_like(states), np.full(len(segments), np.inf)
    share = np.ones(len(segments))
    for last in (*(False,) * INNER, True):
        trial = best if last else best + share[:, None] * changes
        prediction = model.predict(values, trial, free if last else free[:0])
        errors, by_state = (measured - prediction.outputs) / noise, prediction.by_state / noise[:, None]
        slopes = -prediction.by_value / noise[:, None]
        if (seen := model.log.seen) is not None:
            errors, by_state, slopes = errors * seen, by_state * seen[:, :, None], slopes * seen[:, :, None]
        with np.errstate(over="ignore", invalid="ignore"):
            squares = np.add.reduceat(np.sum(errors**2, axis=1), model.starts)
        if not last:
            better = squares < least
            best, least = np.where(better[:, None], trial, best), np.where(better, squares, least)
            share = np.where(better, 1.0, 0.25 * share)  # a shorter step if the errors have increased
            changes = np.where(better[:, None], _state_changes(by_state, errors, segments), changes)
    if not all(np.abs(x).max(initial=0.0) < DIVERGENT_ERROR for x in (errors, slopes, by_state)):  # false for nan too
        return None
    bases = np.empty_like(by_state)
    for part in segments:
        basis, _ = np.linalg.qr(by_state[part].reshape(-1, LOG_STATES))
        bases[part] = basis.reshape(bases[part].shape)
        both = np.column_stack((slopes[part].reshape(errors[part].size, len(free)), errors[part].ravel()))
        both -= basis @ (basis.T @ both)
        slopes[part], errors[part] = both[:, :-1].reshape(slopes[part].shape), both[:, -1].reshape(errors[part].shape)
    if seen is not None:  # the projection leaves rounding errors
        errors, slopes = errors * seen, slopes * seen[:, :, None]
    return Residuals(trial, errors, slopes, seen, bases)


def _state_changes(by_state: Array, errors: Array, segments: Sequence[slice]) -> Array:
    """Return the Gauss-Newton steps of the initial states, shape (S, 6); 0 where a prediction diverges."""
    steps = np.zeros((len(segments), LOG_STATES))
    for i, part in enumerate(segments):
        if np.abs(by_state[part]).max() < DIVERGENT_ERROR and np.abs(errors[part]).max() < DIVERGENT_ERROR:
            steps[i] = np.linalg.lstsq(by_state[part].reshape(-1, LOG_STATES), errors[part].ravel(), rcond=None)[0]
    return steps


def fit(
    model: LogModel, initial: InitialValues, states: Array, noise: Array, used: NDArray[np.bool_] | None = None
) -> tuple[Array, Residuals]:
    """Return the parameters with the least squared prediction errors, shape (P,), and their residuals.

    Args:
        model: the simulator with the commands of a log.
        initial: initial values of the parameters, within the bounds.
        states: first guess of the initial states, shape (S, 6).
        noise: standard deviations of the measurements, shape (6,).
        used: the rows that count, shape (T,); None: all.

    Raises:
        ValueError: the prediction diverges at the initial values.
    """
    free = model.indices(initial.free)
    scales = initial.scales[free]
    forms = initial.constraints(model.names)
    weights = np.zeros(len(free)) if initial.prior is None else scales / initial.prior[free]
    cache: dict[bytes, Residuals | None] = {}
    least, best_states = math.inf, states

    def parameters(x: Array) -> Array:
        values = initial.values.copy()
        values[free] = x * scales
        return values

    def residuals_at(x: Array) -> Residuals | None:
        nonlocal least, best_states
        if (key := x.tobytes()) not in cache:
            cache[key] = result = residuals(model, parameters(x), free, best_states, noise)
            if result is not None and used is not None:
                result.errors[~used] = result.slopes[~used] = 0.0
            if result is not None and (cost := float(np.sum(result.errors**2))) < least:
                least, best_states = cost, result.states
                for other in cache.keys() - {key}:
                    del cache[other]
        return cache[key]

    def violations(x: Array) -> Array:
        return np.asarray(np.minimum(forms @ parameters(x) - LEAST_CONSTRAINT, 0.0))

    def errors(x: Array) -> Array:
        result = residuals_at(x)
        flat = np.full(len(model.log.t) * len(MEASURED_COLUMNS), np.inf) if result is None else result.errors.ravel()
        return np.concatenate((flat, PENALTY * violations(x), weights * x))

    def slopes(x: Array) -> Array:
        result = residuals_at(x)
        assert result is not None
        penalties = np.where(violations(x)[:, None] < 0, PENALTY * forms[:, free], 0.0)
        by_parameter = np.concatenate((result.slopes.reshape(-1, len(free)), penalties)) * scales
        return np.concatenate((by_parameter, np.diag(weights)))

    low, high = (bound[free] / scales for bound in initial.bounds)
    x = initial.values[free] / scales
    margin = 1e-9 * np.maximum(1.0, np.abs(x))  # SciPy moves values that are on a bound
    x = np.clip(x, low + margin, high - margin)
    if residuals_at(x) is None:
        raise ValueError("the simulator diverges on this log; is the time step short enough for the vehicle?")
    x = least_squares(
        errors, x, slopes, (low, high), ftol=_TOLERANCE, xtol=_TOLERANCE, gtol=None, max_nfev=MAX_EVALUATIONS
    ).x
    result = residuals_at(x)
    assert result is not None
    return parameters(x), result
