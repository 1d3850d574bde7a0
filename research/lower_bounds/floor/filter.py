"""How well a vehicle can be located: the Kalman filter of a `FloorModel`, its covariance and its own errors.

It is the best of all estimates of a linear system with Gaussian noise (R. E. Kalman, Journal of Basic Engineering
82(1):35-45, 1960). The position at an instant depends on commands that were decided on measurements up to the period
before, so whatever they are, its mean squared distance to a point that was chosen beforehand is at least the trace of
the covariance predicted from these measurements:

    E |p_(k+1) - p_R|^2 = E |p_(k+1) - E[p_(k+1) | y_0 ... y_k]|^2 + E |E[p_(k+1) | y_0 ... y_k] - p_R|^2
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array
from baselines.control.privileged.problem import STEADY_RMSE
from research.lower_bounds.floor.model import DRIVEN, FloorModel

SAMPLES = 16
"""Sequences of random numbers of each episode: the mean of a root of a mean square is not in the covariance."""


class Located(NamedTuple):
    """How far off the predicted position is, in the tails of N episodes."""

    square: Array  # [m^2] mean over the tail of the expected squared error, shape (N,)
    steady_rmse: Array  # [m] mean over sequences of the root mean square over the tail, shape (N,)


def located(model: FloorModel, seeds: NDArray[np.int64] | list[int], samples: int = SAMPLES) -> Located:
    """Return how well the vehicles of a model can be located in the tails of their episodes.

    Args:
        model: of N episodes.
        seeds: of the random numbers of each episode.
        samples: see `SAMPLES`.
    """
    steps, size = len(model.pose), model.begun.shape[-1]
    chance = [np.random.default_rng(seed) for seed in seeds]

    def normal(rows: int) -> Array:
        return np.stack([rng.standard_normal((rows, samples)) for rng in chance])

    P, R = model.begun, np.diag(model.noise**2)
    off = _root(P) @ normal(size)  # the estimate's error in each sequence
    variance, squares = np.zeros(len(seeds)), np.zeros((len(seeds), samples))
    for k in range(steps):
        C = model.output(k)
        PC = P @ C.swapaxes(1, 2)
        gain = np.linalg.solve(C @ PC + R, PC.swapaxes(1, 2)).swapaxes(1, 2)
        P = P - gain @ PC.swapaxes(1, 2)
        off = off - gain @ (C @ off + model.noise[:, None] * normal(len(model.noise)))
        rows, driven = model.forward(k)
        P = model.passed(rows, model.passed(rows, P).swapaxes(1, 2)) + driven @ driven.swapaxes(1, 2)
        P = 0.5 * (P + P.swapaxes(1, 2))  # rounding would grow in what is unstable
        off = model.passed(rows, off) + driven @ normal(DRIVEN)
        if k >= steps // STEADY_RMSE:
            variance += P[:, 0, 0] + P[:, 1, 1]
            squares += (off[:, :2] ** 2).sum(axis=1)
    count = steps - steps // STEADY_RMSE
    return Located(variance / count, np.sqrt(squares / count).mean(axis=1))


def _root(P: Array) -> Array:
    """Return matrices whose squares are covariances, shape (N, n, n); some of their eigenvalues are zero."""
    values, vectors = np.linalg.eigh(P)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None])
