"""How well the parameters are known: the noise, their covariance, and what coloured residuals do to it."""

from __future__ import annotations

import itertools
import math

import numpy as np
from scipy.linalg import toeplitz
from scipy.special import chdtrc

from auv_gym.physics.namespaces import Array, Indices
from baselines.identification.least_squares import Left
from baselines.identification.log import Log, unwrapped

NORMAL_QUANTILE = 1.959964  # of a 95 % interval
_TINY = 1e-6  # least noise, as a share of the range of a measurement
SINGULAR = 1e-9  # least singular value of slopes of length one
_WINDOW = 4  # residuals are taken as related over at most a fourth of a segment
PORTMANTEAU = 10  # rows over which it is tested whether residuals are related


def rough_noise(log: Log) -> Array:
    """Return standard deviations of the measurements' noise, shape (6,), from what no smooth motion does."""
    measured = unwrapped(log)
    bends = np.concatenate([np.diff(measured[run], 2, axis=0) for run in log.runs])
    noise = 1.4826 * np.median(np.abs(bends - np.median(bends, axis=0)), axis=0) / math.sqrt(6)
    return np.asarray(np.maximum(noise, least_noise(log)))


def least_noise(log: Log) -> Array:
    """Return the least standard deviations that are believed, shape (6,)."""
    return np.asarray(np.maximum(_TINY * np.ptp(unwrapped(log), axis=0), 1e-9))


def found_noise(left: Left, noise: Array, log: Log) -> Array:
    """Return the standard deviations that a fit has left, shape (6,), for errors in units of assumed ones."""
    count = left.errors.size
    chosen = left.slopes.shape[2] + left.states.size
    rms = np.sqrt(np.mean(left.errors**2, axis=0) * count / max(count - chosen, 1))
    return np.asarray(np.maximum(rms * noise, least_noise(log)))


def whiteness(errors: Array, starts: Indices) -> float:
    """Return the probability that white noise leaves residuals as related from row to row as these, or more.

    By the portmanteau statistic of all measurements together (G. M. Ljung and G. E. P. Box, "On a measure of lack of
    fit in time series models", Biometrika 65:297-303, 1978).

    Args:
        errors: measured less predicted, shape (T, 6).
        starts: rows at which segments begin, shape (S,).
    """
    cuts = [*starts.tolist(), len(errors)]
    total = 0.0
    for channel in range(errors.shape[1]):
        for k in range(1, PORTMANTEAU + 1):
            pairs = [errors[a : b - k, channel] @ errors[a + k : b, channel] for a, b in itertools.pairwise(cuts)]
            count = sum(max(b - a - k, 0) for a, b in itertools.pairwise(cuts))
            variance = float(np.mean(errors[:, channel] ** 2))
            total += (sum(pairs) / variance) ** 2 / max(count, 1)
    return float(chdtrc(PORTMANTEAU * errors.shape[1], total))


def covariance(left: Left, starts: Indices, misfit: bool = False) -> Array:
    """Return the covariance of the free parameters, shape (F, F).

    That of white noise is the inverse of the information. Where residuals are related from row to row, as waves or a
    wrong model make them, it is corrected by their autocorrelation (E. A. Morelli and V. Klein, "Determining the
    accuracy of maximum likelihood parameter estimates with colored residuals", NASA CR-194893, 1994), and no variance
    is taken to be smaller for it. With a misfit it is also not smaller than what the scatter of the segments says, each
    taken as a whole (K.-Y. Liang and S. L. Zeger, "Longitudinal data analysis using generalized linear models",
    Biometrika 73:13-22, 1986). A direction that the log says nothing about has a variance beyond all numbers.
    """
    F = left.slopes.shape[2]
    flat = left.slopes.reshape(-1, F)
    norms = np.linalg.norm(flat, axis=0)
    lengths = np.where(norms > 0, norms, 1.0)
    _, sizes, axes = np.linalg.svd(flat / lengths, full_matrices=False)
    white = (axes.T / np.maximum(sizes, SINGULAR) ** 2) @ axes / np.outer(lengths, lengths)
    white[norms == 0, norms == 0] = np.inf
    if not np.isfinite(white).all():
        return np.asarray(white)
    cuts = [*starts.tolist(), len(left.errors)]
    window = max(2, min(b - a for a, b in itertools.pairwise(cuts)) // _WINDOW)
    middle = np.zeros((F, F))
    for channel in range(left.errors.shape[1]):
        related = _autocovariance(left.errors[:, channel], cuts, window)
        for a, b in itertools.pairwise(cuts):
            row = np.zeros(b - a)
            row[: min(window, b - a)] = related[: b - a]
            own = left.slopes[a:b, channel]
            middle += own.T @ toeplitz(row) @ own
    variances = [np.diag(white @ middle @ white)]
    if misfit:
        pulls = [left.slopes[a:b].reshape(-1, F).T @ left.errors[a:b].ravel() for a, b in itertools.pairwise(cuts)]
        S = len(pulls)
        variances.append(S / max(S - 1, 1) * np.sum((np.array(pulls) @ white) ** 2, axis=0))
    wider = np.sqrt(np.maximum(np.max(variances, axis=0) / np.diag(white), 1.0))
    return np.asarray(white * np.outer(wider, wider))


def _autocovariance(errors: Array, cuts: list[int], window: int) -> Array:
    """Return the autocovariance of errors within segments at 0 ... window - 1 rows, tapered to none (Bartlett)."""
    sums, counts = np.zeros(window), np.zeros(window)
    for a, b in itertools.pairwise(cuts):
        own = errors[a:b]
        for k in range(min(window, b - a)):
            sums[k] += own[: b - a - k] @ own[k:]
            counts[k] += b - a
    return np.asarray(sums / np.maximum(counts, 1) * (1 - np.arange(window) / window))
