"""Errors of the position that the Kalman filter of an `EstimationModel` predicts.

The Kalman filter has the least mean squared error of all estimators of a linear system with Gaussian noise (R. E.
Kalman, Journal of Basic Engineering 82(1):35-45, 1960). The command of a period depends on measurements up to its
start. So for any commands, the mean squared distance of the next position to a given reference is at least the trace
of the covariance that is predicted from these measurements:

    E |p_(k+1) - p_R|^2 = E |p_(k+1) - E[p_(k+1) | y_0 ... y_k]|^2 + E |E[p_(k+1) | y_0 ... y_k] - p_R|^2
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array
from baselines.control.privileged.problem import STEADY_RMSE
from research.estimation_bound.model import GUST_INPUTS, EstimationModel

SAMPLES = 16
"""Random sequences of each episode: the mean of the steady-state errors does not follow from the covariance."""


class PositionErrors(NamedTuple):
    """Errors of the predicted position after the first third of N episodes."""

    square: Array  # [m^2] mean over time of the expected squared error, shape (N,)
    steady_rmse: Array  # [m] mean over random sequences of the root mean square over time, shape (N,)


def position_errors(
    model: EstimationModel, seeds: NDArray[np.int64] | list[int], samples: int = SAMPLES
) -> PositionErrors:
    """Return the errors of the predicted position in the episodes of a model.

    Args:
        model: the model of N episodes.
        seeds: seeds of the random numbers of each episode.
        samples: number of random sequences, see `SAMPLES`.
    """
    steps, size = len(model.pose), model.initial.shape[-1]
    generators = [np.random.default_rng(seed) for seed in seeds]

    def normal(rows: int) -> Array:
        return np.stack([rng.standard_normal((rows, samples)) for rng in generators])

    P, R = model.initial, np.diag(model.noise**2)
    error = _root(P) @ normal(size)  # of the estimate, in each random sequence
    variance, squares = np.zeros(len(seeds)), np.zeros((len(seeds), samples))
    for k in range(steps):
        C = model.output(k)
        PC = P @ C.swapaxes(1, 2)
        gain = np.linalg.solve(C @ PC + R, PC.swapaxes(1, 2)).swapaxes(1, 2)
        P = P - gain @ PC.swapaxes(1, 2)
        error = error - gain @ (C @ error + model.noise[:, None] * normal(len(model.noise)))
        rows, gamma = model.transition(k)
        P = model.propagate(rows, model.propagate(rows, P).swapaxes(1, 2)) + gamma @ gamma.swapaxes(1, 2)
        P = 0.5 * (P + P.swapaxes(1, 2))  # keeps P symmetric: rounding errors would grow in unstable directions
        error = model.propagate(rows, error) + gamma @ normal(GUST_INPUTS)
        if k >= steps // STEADY_RMSE:
            variance += P[:, 0, 0] + P[:, 1, 1]
            squares += (error[:, :2] ** 2).sum(axis=1)
    count = steps - steps // STEADY_RMSE
    return PositionErrors(variance / count, np.sqrt(squares / count).mean(axis=1))


def _root(P: Array) -> Array:
    """Return matrices L with L L^T = P for singular covariances P, shape (N, n, n) each."""
    values, vectors = np.linalg.eigh(P)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None])
