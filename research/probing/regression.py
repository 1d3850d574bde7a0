"""Probes: how much of a quantity can be read from some numbers, on episodes that the probe was not fitted to.

A linear probe is ridge regression, a nonlinear one is ridge regression with a Gaussian kernel; both have a closed form,
and both choose how strongly they are held back by the errors of leaving one episode out (G. H. Golub, M. Heath and
G. Wahba, Technometrics 21(2):215-223, 1979; the closed form is that of R. D. Cook, Technometrics 19(1):15-18, 1977).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from auv_gym.physics.namespaces import Array
from baselines.evaluation.metrics import resamplings

HELD_BACK = 10.0 ** np.arange(-4.0, 5.0)
"""Penalties that are tried, as shares of the number of episodes."""
FLAT = 1e-9
"""Standard deviation below which a column or a target is constant."""
WIDTHS = (1.0, 4.0)
"""Widths of the kernel that are tried, as multiples of the mean squared distance of two episodes."""


class Read(NamedTuple):
    """How well something can be read: the share of its variance, R^2 = 1 - error^2 / variance."""

    r2: float
    low: float  # 95 % interval, bootstrap over the test's episodes
    high: float


class Probed(NamedTuple):
    """What a probe says of some targets on the test's episodes."""

    errors: Array  # squared, shape (n, targets)
    spread: Array  # squared distances of the truth to the mean of the fitted episodes, shape (n, targets)


def linear(fitted: Array, truth: Array, test: Array, test_truth: Array) -> Probed:
    """Return what a linear probe says.

    Args:
        fitted: what is read from, in the episodes that it is fitted to, shape (n, columns).
        truth: what is asked, shape (n, targets).
        test: what is read from in the others, shape (m, columns).
        test_truth: what is asked there, shape (m, targets).
    """
    X, Z = _scaled(fitted, test)
    mean = truth.mean(axis=0)
    U, s, Vt = np.linalg.svd(X, full_matrices=False)
    told = U.T @ (truth - mean)
    best, chosen = np.full(truth.shape[1], np.inf), np.zeros((X.shape[1], truth.shape[1]))
    for share in HELD_BACK:
        kept = s * s / (s * s + share * len(X))
        left_out = (truth - mean - U @ (kept[:, None] * told)) / (1 - 1 / len(X) - (U * U) @ kept)[:, None]
        loss = np.square(left_out).mean(axis=0)
        weights = Vt.T @ ((kept / np.maximum(s, 1e-12))[:, None] * told)
        chosen[:, loss < best], best = weights[:, loss < best], np.minimum(loss, best)
    return Probed(np.square(test_truth - mean - Z @ chosen), np.square(test_truth - mean))


def nonlinear(fitted: Array, truth: Array, test: Array, test_truth: Array) -> Probed:
    """Return what a probe with a Gaussian kernel says; arguments as of `linear`."""
    X, Z = _scaled(fitted, test)
    mean, unit = truth.mean(axis=0), 2.0 * X.shape[1]  # of scaled columns the mean squared distance
    own, others = _distances(X, X) / unit, _distances(Z, X) / unit
    best, chosen = np.full(truth.shape[1], np.inf), np.zeros(test_truth.shape)
    for width in WIDTHS:
        values, vectors = np.linalg.eigh(np.exp(-own / width))
        told = vectors.T @ (truth - mean)
        there = np.exp(-others / width) @ vectors
        for share in HELD_BACK:
            inverse = 1 / (np.maximum(values, 0.0) + share)
            weights = vectors @ (inverse[:, None] * told)
            loss = np.square(weights / ((vectors * vectors) @ inverse)[:, None]).mean(axis=0)
            said = there @ (inverse[:, None] * told)
            chosen[:, loss < best], best = said[:, loss < best], np.minimum(loss, best)
    return Probed(np.square(test_truth - mean - chosen), np.square(test_truth - mean))


def _scaled(fitted: Array, test: Array) -> tuple[Array, Array]:
    """Return both with columns of mean 0 and deviation 1 where they are fitted, constant columns left out."""
    mean, deviation = fitted.mean(axis=0), fitted.std(axis=0)
    use = deviation > FLAT
    return (fitted[:, use] - mean[use]) / deviation[use], (test[:, use] - mean[use]) / deviation[use]


def read(probed: Probed) -> list[Read]:
    """Return how well each target is read; what is constant is not asked, and gives nan."""
    return [Read(*_ends(share)) for share in _shares(probed).T]


def lead(one: Probed, other: Probed) -> list[Read]:
    """Return by how much R^2 of one probe is above that of another one on the same episodes, for each target."""
    return [Read(*_ends(share)) for share in (_shares(one) - _shares(other)).T]


def _shares(probed: Probed) -> Array:
    """Return R^2 of the test, and behind it of each bootstrap sample, shape (1 + samples, targets)."""
    (counts,) = resamplings((len(probed.errors),))
    spread = counts @ probed.spread
    return np.where(
        spread > FLAT**2 * len(probed.errors), 1 - counts @ probed.errors / np.maximum(spread, 1e-300), np.nan
    )


def _ends(share: Array) -> tuple[float, float, float]:
    low, high = np.quantile(share[1:], (0.025, 0.975))
    return float(share[0]), float(low), float(high)


def _distances(A: Array, B: Array) -> Array:
    squares = np.square(A).sum(axis=1)[:, None] + np.square(B).sum(axis=1)[None] - 2 * A @ B.T
    return np.asarray(np.maximum(squares, 0.0))
