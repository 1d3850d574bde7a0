"""Uncertainty of a fit: noise, covariance of the parameters, and the test whether residuals are white."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import toeplitz
from scipy.special import chdtrc

from auv_gym.physics.namespaces import Array, Indices
from baselines.identification.least_squares import Residuals
from baselines.identification.log import Log, least_noise, slices

NORMAL_QUANTILE = 1.959964  # of a 95 % interval
SINGULAR = 1e-9  # least singular value of derivatives of unit length
_LAG_SHARE = 4  # residuals are taken as correlated over at most this fraction, 1/4, of a segment
PORTMANTEAU = 10  # number of lags of the portmanteau test


def estimated_noise(residuals: Residuals, noise: Array, log: Log) -> Array:
    """Return standard deviations of the noise, shape (6,), from residuals in units of the assumed ones, `noise`."""
    counts = np.full(6, len(residuals.errors)) if residuals.seen is None else residuals.seen.sum(axis=0)
    count = int(counts.sum())
    fitted = residuals.slopes.shape[2] + residuals.states.size
    rms = np.sqrt(np.sum(residuals.errors**2, axis=0) / np.maximum(counts, 1) * count / max(count - fitted, 1))
    return np.asarray(np.maximum(rms * noise, least_noise(log)))


def whiteness(residuals: Residuals, starts: Indices) -> float:
    """Return the probability that white noise has an autocorrelation as large as the residuals, or larger.

    It is the p-value of the portmanteau statistic of all measurements together (G. M. Ljung and G. E. P. Box, "On a
    measure of lack of fit in time series models", Biometrika 65:297-303, 1978). The initial states that are fitted in
    each segment make the residuals of white noise correlated; this correlation is subtracted.

    `starts` are the first rows of the segments.
    """
    segments, total, terms = slices(starts, len(residuals.errors)), 0.0, 0
    for j, channel in enumerate(residuals.errors.T):
        rows = [residuals.counted(s, j) for s in segments]
        parts = [channel[part] for part in rows]
        bases = [np.zeros((len(part), 0)) for part in parts]
        if residuals.bases is not None:
            bases = [residuals.bases[part, j] for part in rows]
        fitted = sum(float(np.sum(basis**2)) for basis in bases)
        variance = float(np.sum(channel**2)) / max(sum(map(len, parts)) - fitted, 1)
        for k in range(1, PORTMANTEAU + 1):
            if count := sum(max(len(part) - k, 0) for part in parts):
                products = sum(float(part[:-k] @ part[k:]) for part in parts) / variance
                expected = -sum(float(np.sum(basis[:-k] * basis[k:])) for basis in bases)
                total, terms = total + (products - expected) ** 2 / count, terms + 1
    return float(chdtrc(terms, total))


def covariance(residuals: Residuals, starts: Indices, misfit: bool = False) -> Array:
    """Return the covariance of the free parameters, shape (F, F).

    For white noise it is the inverse of the information matrix. Variances are increased by the autocorrelation of the
    residuals, and never decreased (E. A. Morelli and V. Klein, "Determining the accuracy of maximum likelihood
    parameter estimates with colored residuals", NASA CR-194893, 1994). With a misfit they are at least those of the
    cluster-robust estimate with the segments as clusters (K.-Y. Liang and S. L. Zeger, "Longitudinal data analysis
    using generalized linear models", Biometrika 73:13-22, 1986). A direction without information has a very large or
    infinite variance.

    `starts` are the first rows of the segments; with a misfit the residuals are not white.
    """
    F = residuals.slopes.shape[2]
    flat = residuals.slopes.reshape(-1, F)
    norms = np.linalg.norm(flat, axis=0)
    lengths = np.where(norms > 0, norms, 1.0)
    _, sizes, axes = np.linalg.svd(flat / lengths, full_matrices=False)
    white = (axes.T / np.maximum(sizes, SINGULAR) ** 2) @ axes / np.outer(lengths, lengths)
    white[norms == 0, norms == 0] = np.inf
    if not np.isfinite(white).all():
        return np.asarray(white)
    segments = slices(starts, len(residuals.errors))
    middle = np.zeros((F, F))
    for channel in range(residuals.errors.shape[1]):
        parts = [residuals.counted(s, channel) for s in segments]
        errors = [residuals.errors[part, channel] for part in parts]
        window = max(2, min(map(len, errors)) // _LAG_SHARE)
        autocovariance = _autocovariance(errors, window)
        for part in parts:
            slopes = residuals.slopes[part, channel]
            row = np.zeros(len(slopes))
            row[:window] = autocovariance[: len(slopes)]
            if not len(slopes):
                continue
            middle += slopes.T @ toeplitz(row) @ slopes
    variances = [np.diag(white @ middle @ white)]
    if misfit:
        scores = [residuals.slopes[s].reshape(-1, F).T @ residuals.errors[s].ravel() for s in segments]
        S = len(scores)
        variances.append(S / max(S - 1, 1) * np.sum((np.array(scores) @ white) ** 2, axis=0))
    factors = np.sqrt(np.maximum(np.max(variances, axis=0) / np.diag(white), 1.0))
    return np.asarray(white * np.outer(factors, factors))


def _autocovariance(parts: Sequence[Array], window: int) -> Array:
    """Return the autocovariance within segments at lags of 0 ... window - 1 rows, with a Bartlett taper."""
    sums, counts = np.zeros(window), np.zeros(window)
    for part in parts:
        for k in range(min(window, len(part))):
            sums[k] += part[: len(part) - k] @ part[k:]
            counts[k] += len(part)
    return np.asarray(sums / np.maximum(counts, 1) * (1 - np.arange(window) / window))
