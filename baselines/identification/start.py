"""Where the fit begins: the equations of motion, linear in the parameters, by least squares on smoothed speeds."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import Any

import numpy as np
from scipy.optimize import nnls
from scipy.signal import savgol_filter

from auv_gym.codegen.derivatives import jacobian
from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.actuators import Response, respond
from auv_gym.physics.dynamics import rates
from auv_gym.physics.namespaces import ARRAYS, Array
from baselines.identification.log import Log
from baselines.identification.model import COEFFICIENTS

_LAGS = (0.0, 1.0, 3.0, 8.0, 20.0)  # candidates of the lag, in time steps
_SHARES = (1.0, 0.8, 0.6, 0.4)  # candidates of a limit, as shares of the largest command
START_WINDOWS = (5, 11, 21, 41)  # rows that a speed is smoothed over: which are right depends on vehicle and noise
SIMPLER = 0.03
"""By how much the logarithm of the residuals must fall before a lag or a limit is believed."""


@dataclass(frozen=True)
class RoughStart:
    """Rough values from equations that hold at each instant."""

    coefficients: Array  # of `COEFFICIENTS`, what is optional 0, shape (H,)
    lag: float  # [s]
    limits: Array  # [N], [N m], shape (2,)
    shares: Array  # force that a unit of each parameter makes, as a share of all forces, shape (H,)


@dataclass(frozen=True)
class Begin:
    """Where a search begins, and what it may find."""

    values: Array  # of `LogModel.names`, shape (P,)
    scales: Array  # changes that matter, shape (P,)
    bounds: tuple[Array, Array]  # least and largest values, shape (P,) each
    free: tuple[str, ...]  # what is searched for
    shares: Mapping[str, float]  # force of a unit of a coefficient, as a share of all forces
    sizes: Array | None = None  # how large parameters may well be, see `least_squares.fit`

    def with_terms(self, terms: Sequence[str]) -> Begin:
        """Return the same with further terms of the vehicle among what is searched for."""
        more = [name for name in terms if name not in self.free and self.shares[name] > 0]
        return replace(self, free=(*self.free, *more))


@cache
def balance() -> Kernel:
    """Return the kernel of how the forces that do not balance depend on each parameter: the equations are linear."""

    def equation(motion: Any, coefficients: Any) -> Mapping[str, Sequence[Any]]:
        u, v, r, a_u, a_v, a_r, X, N = motion
        _, _, *found = rates(0.0, u, v, r, (X, 0.0, N), coefficients, SYMBOLS)
        left = [m * (a - b) for m, a, b in zip(coefficients[:3], (a_u, a_v, a_r), found, strict=True)]
        return {"terms": [entry for row in jacobian(left, coefficients) for entry in row]}

    return Kernel.traced(equation, {"motion": 8, "coefficients": len(COEFFICIENTS)}, shared=["coefficients"])


def rough_start(log: Log, needed: Sequence[str], window: int) -> RoughStart:
    """Return rough values for a log: what is `needed` of the vehicle, and the likeliest lag and limits.

    Args:
        log: what was measured and commanded.
        needed: names of the vehicle's parameters that are not taken as 0.
        window: rows that speeds are smoothed over.
    """
    speeds, accelerations = smoothed(log, window)
    motion = np.concatenate((speeds, accelerations, np.zeros((2, len(log.t)))))
    terms = balance()(motion=motion, coefficients=np.ones(len(COEFFICIENTS)))["terms"].reshape(3, len(COEFFICIENTS), -1)
    columns = [COEFFICIENTS.index(name) for name in needed]
    best: tuple[float, Array, float, Array] | None = None
    peaks = np.abs(log.commands).max(axis=0)
    for lag, *shares in product(_LAGS, _SHARES, _SHARES):
        if any(share < 1 and peak == 0 for share, peak in zip(shares, peaks, strict=True)):
            continue
        limits = np.where(peaks > 0, peaks * shares, math.inf)
        force = _forces(log, lag * log.dt, limits)
        load = np.stack((force[0], np.zeros_like(force[0]), force[1]))
        left, values = _solved(terms[:, columns], load)
        if best is None or left < best[0] - SIMPLER:
            best = left, values, lag * log.dt, limits
    assert best is not None
    coefficients = np.zeros(len(COEFFICIENTS))
    coefficients[columns] = best[1]
    _fill(coefficients, log)
    return RoughStart(coefficients, best[2], best[3], shares_of(terms, coefficients))


def _forces(log: Log, lag: float, limits: Array) -> Array:
    """Return the mean force [N] and moment [N m] of the actuators from each row to the next, shape (2, T)."""
    response = Response.of(lag, math.inf, math.inf, log.dt)
    commands = np.clip(log.commands, -limits, limits)
    force = tuple(commands[0])
    acting = np.empty((2, len(log.t)))
    if lag == 0:
        return commands.T
    for k, command in enumerate(commands.tolist()):
        acting[:, k], force = respond(force, tuple(command), response, ARRAYS)
    return acting


def smoothed(log: Log, window: int) -> tuple[Array, Array]:
    """Return u, v, r and their rates, each of shape (3, T), by local polynomials over so many rows."""
    speeds, accelerations = np.empty((2, 3, len(log.t)))
    for run in log.runs:
        t = log.t[run]
        even = np.linspace(t[0], t[-1], len(t))
        rows = np.stack([np.interp(even, t, column) for column in log.measured[run, 3:].T])
        speeds[:, run] = savgol_filter(rows, window, 2)
        accelerations[:, run] = savgol_filter(rows, window, 2, deriv=1, delta=float(even[1] - even[0]))
    return speeds, accelerations


def _solved(terms: Array, load: Array) -> tuple[float, Array]:
    """Return the logarithm of the residuals of the equations, and the parameters that leave them; none is negative.

    Nothing pushes sideways: forces there count as those ahead do. Counted by their residuals, they would be
    explained best by a vehicle without mass.
    """
    ahead, _, turning = np.sqrt(np.mean(load**2, axis=1)).tolist()
    scales = np.array((ahead or turning, ahead or turning, turning or ahead))  # one of them is not 0
    matrix = (terms / scales[:, None, None]).transpose(0, 2, 1).reshape(-1, terms.shape[1])
    norms = np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    values, left = nnls(matrix / norms, (load / scales[:, None]).ravel())
    return math.log(max(left, 1e-300)), values / norms


def _fill(coefficients: Array, log: Log) -> None:
    """Give masses and linear drags that the equations have left at 0 a value of a likely order, in place."""
    masses, drags = coefficients[:3], coefficients[3:6]
    speed = max(float(np.abs(log.measured[:, 3]).max()), 1e-6)
    length = max(speed * log.duration / 20, 1e-6)
    masses[0] = masses[0] or drags[0] * log.duration / 10 or float(np.abs(log.commands).max()) * log.duration / speed
    masses[1] = masses[1] or 1.5 * masses[0]
    masses[2] = masses[2] or masses[0] * min(length, 1.0) ** 2
    np.copyto(drags, masses / log.duration, where=drags <= 0)


def shares_of(terms: Array, coefficients: Array) -> Array:
    """Return the force of a unit of each parameter as a share of all forces, in the equation where that is largest."""
    sizes = np.sqrt(np.mean(terms**2, axis=2))  # (3, H)
    total = np.maximum((sizes * np.abs(coefficients)).sum(axis=1), 1e-300)
    return np.asarray((sizes / total[:, None]).max(axis=0))
