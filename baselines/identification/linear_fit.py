"""First values of the parameters by linear least squares: the equations of motion at each instant, smoothed speeds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Any

import numpy as np
from scipy.optimize import nnls
from scipy.signal import savgol_filter

from auv_gym.codegen.derivatives import jacobian
from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.effects.actuators import Response, respond
from auv_gym.physics.dynamics import rates
from auv_gym.physics.namespaces import ARRAYS, Array
from baselines.identification.log import Log
from baselines.identification.model import COEFFICIENTS, NEEDED

_LAGS = (0.0, 1.0, 3.0, 8.0, 20.0)  # candidate lags, in time steps
_LIMIT_SHARES = (1.0, 0.8, 0.6, 0.4)  # candidate limits, as shares of the largest command
SMOOTHING_LENGTHS = (
    5,
    11,
    21,
    41,
)  # candidate lengths of the smoothing [rows]; the best one depends on vehicle and noise
LEAST_GAIN = 0.03  # least decrease of the logarithm of the residual for which another lag or limit is accepted


@dataclass(frozen=True)
class LinearFit:
    """Result of the linear least squares."""

    coefficients: Array  # of `COEFFICIENTS`, 0 for optional ones, shape (H,)
    lag: float  # [s]
    limits: Array  # [N], [N m], shape (2,)
    shares: Array  # force per unit of each coefficient, as a share of all forces, shape (H,)


@cache
def _derivatives() -> Kernel:
    """Return the kernel of the derivatives of the equations of motion by the parameters, in which they are linear."""

    def equation(motion: Any, coefficients: Any) -> Mapping[str, Sequence[Any]]:
        u, v, r, a_u, a_v, a_r, X, N = motion
        _, _, *predicted = rates(0.0, u, v, r, (X, 0.0, N), coefficients, SYMBOLS)
        residuals = [m * (a - b) for m, a, b in zip(coefficients[:3], (a_u, a_v, a_r), predicted, strict=True)]
        return {"terms": [entry for row in jacobian(residuals, coefficients) for entry in row]}

    return Kernel.traced(equation, {"motion": 8, "coefficients": len(COEFFICIENTS)}, shared=["coefficients"])


def regressors(speeds: Array, accelerations: Array) -> Array:
    """Return the force per unit of each coefficient in the three equations of motion, shape (3, H, T).

    `speeds` are u, v, r and `accelerations` their time derivatives, shape (3, T) each.
    """
    motion = np.concatenate((speeds, accelerations, np.zeros((2, speeds.shape[1]))))
    terms = _derivatives()(motion=motion, coefficients=np.ones(len(COEFFICIENTS)))["terms"]
    return terms.reshape(3, len(COEFFICIENTS), -1)


def linear_fit(log: Log, window: int) -> LinearFit:
    """Return masses and linear drags by linear least squares, with the best one of several lags and limits.

    `window` is the number of rows of the smoothing of the log, which has commands of forces.
    """
    terms = regressors(*smoothed(log, window))
    columns = [COEFFICIENTS.index(name) for name in NEEDED]
    best: tuple[float, Array, float, Array] | None = None
    peaks = np.abs(log.commands).max(axis=0)
    for lag, *shares in product(_LAGS, _LIMIT_SHARES, _LIMIT_SHARES):
        if any(share < 1 and peak == 0 for share, peak in zip(shares, peaks, strict=True)):
            continue
        limits = np.where(peaks > 0, peaks * shares, math.inf)
        residual, values = _non_negative_fit(terms[:, columns], _loads(log, lag * log.dt, limits))
        if best is None or residual < best[0] - LEAST_GAIN:
            best = residual, values, lag * log.dt, limits
    assert best is not None
    coefficients = np.zeros(len(COEFFICIENTS))
    coefficients[columns] = best[1]
    _fill(coefficients, log)
    return LinearFit(coefficients, best[2], best[3], force_shares(terms, coefficients))


def _loads(log: Log, lag: float, limits: Array) -> Array:
    """Return the mean force [N], no sway force and the mean moment [N m] from each row to the next, shape (3, T)."""
    commands, loads = np.clip(log.commands, -limits, limits), np.zeros((3, len(log.t)))
    if lag == 0:
        loads[::2] = commands.T
        return loads
    response, force = Response.of(lag, math.inf, math.inf, log.dt), tuple(commands[0])
    for k, command in enumerate(commands.tolist()):
        loads[::2, k], force = respond(force, tuple(command), response, ARRAYS)
    return loads


def smoothed(log: Log, window: int) -> tuple[Array, Array]:
    """Return u, v, r and their time derivatives, shape (3, T) each, by local polynomials over `window` rows."""
    speeds, accelerations = np.empty((2, 3, len(log.t)))
    for run in log.runs:
        t = log.t[run]
        even = np.linspace(t[0], t[-1], len(t))
        rows = np.stack([np.interp(even, t, column) for column in log.measured[run, 3:].T])
        speeds[:, run] = savgol_filter(rows, window, 2)
        accelerations[:, run] = savgol_filter(rows, window, 2, deriv=1, delta=float(even[1] - even[0]))
    return speeds, accelerations


def _non_negative_fit(terms: Array, load: Array) -> tuple[float, Array]:
    """Return the logarithm of the residual and the coefficients, none of them negative.

    There is no sway load, so the sway equation has the weight of the surge equation. With weights by the residuals a
    vehicle without mass would be the best fit.
    """
    surge, _, yaw = np.sqrt(np.mean(load**2, axis=1)).tolist()
    scales = np.array((surge or yaw, surge or yaw, yaw or surge))  # one of them is not 0
    matrix = (terms / scales[:, None, None]).transpose(0, 2, 1).reshape(-1, terms.shape[1])
    norms = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    values, residual = nnls(matrix / norms, (load / scales[:, None]).ravel())
    return math.log(max(residual, 1e-300)), values / norms


def _fill(coefficients: Array, log: Log) -> None:
    """Replace masses and linear drags of 0 by values of a likely order of magnitude, in place."""
    masses, drags = coefficients[:3], coefficients[3:6]
    speed = max(float(np.abs(log.measured[:, 3]).max()), 1e-6)
    length = max(speed * log.duration / 20, 1e-6)
    masses[0] = masses[0] or drags[0] * log.duration / 10 or float(np.abs(log.commands).max()) * log.duration / speed
    masses[1] = masses[1] or 1.5 * masses[0]
    masses[2] = masses[2] or masses[0] * min(length, 1.0) ** 2
    np.copyto(drags, masses / log.duration, where=drags <= 0)


def force_shares(terms: Array, coefficients: Array) -> Array:
    """Return the force per unit of each coefficient as a share of all forces, in the equation where it is largest.

    `terms` are the `regressors`, shape (3, H, T); result and `coefficients` have shape (H,).
    """
    sizes = np.sqrt(np.mean(terms**2, axis=2))  # (3, H)
    total = np.maximum((sizes * np.abs(coefficients)).sum(axis=1), 1e-300)
    return np.asarray((sizes / total[:, None]).max(axis=0))
