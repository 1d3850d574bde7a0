"""What an evaluation measures: every number of the report is defined here, once.

An episode of N control steps gives two arrays, k = 1 ... N: e_k [m] is the distance of the centre of mass to the
reference after step k, and a_k = (a_u, a_r) the normalised command of step k, clipped to [-1, 1] as the actuators do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

Array = NDArray[np.float64]

RESAMPLES = 2000
"""Bootstrap samples behind an interval."""


@dataclass(frozen=True)
class Track:
    """The way of one episode through the plane, one row per control instant, the start included."""

    position: Array  # x, y [m], shape (n + 1, 2)
    reference: Array  # x, y [m], shape (n + 1, 2)
    current: Array  # mean V_x, V_y [m/s] of the water in the world, shape (2,)


@dataclass(frozen=True)
class EpisodeRecord:
    """What is kept of one episode that ran for n control steps, n < N if it was lost."""

    seed: int
    errors: Array  # e_k [m], shape (n,)
    actions: Array  # a_k, shape (n, 2)
    saturated: int  # steps with an actuator commanded to its limit
    total_reward: float
    lost: bool  # terminated: farther from the reference than the scenario allows
    seconds: float  # wall time
    track: Track | None = None


@dataclass(frozen=True)
class Spread:
    """The distribution of one quantity over episodes."""

    mean: float
    ci95: tuple[float, float]  # of the mean
    p95: float  # 95th percentile over episodes


@dataclass(frozen=True)
class Summary:
    """A policy in a scenario: averages over its episodes."""

    episodes: int
    rmse_m: float  # [m]
    tail_rmse_m: Spread  # [m]
    effort: float
    smoothness: float
    failures: int  # episodes that were lost
    saturation: float  # share of the steps
    return_mean: float
    seconds: float  # wall time of all episodes together


def padded(errors: Array, steps: int) -> Array:
    """Return the errors, shape (steps,): an episode that was lost keeps the error at which it ended."""
    return np.concatenate((errors, np.full(steps - len(errors), errors[-1])))


def rmse(errors: Array) -> float:
    """Return sqrt(mean_k e_k^2) [m]."""
    return float(np.sqrt(np.mean(np.square(errors))))


def tail_rmse(errors: Array) -> float:
    """Return sqrt(mean_(k > floor(N/3)) e_k^2) [m]: the error once the start is forgotten."""
    return rmse(errors[len(errors) // 3 :])


def effort(actions: Array) -> float:
    """Return mean_k (a_u,k^2 + a_r,k^2) / 2, the mean square of the normalised command of shape (n, 2)."""
    return float(np.mean(np.square(actions)))


def smoothness(actions: Array) -> float:
    """Return mean_(k >= 2) |a_k - a_(k-1)|^2 / 2, the mean squared change of the command; 0 for a single step."""
    return float(np.mean(np.square(np.diff(actions, axis=0)))) if len(actions) > 1 else 0.0


def bootstrap_interval(values: Sequence[float]) -> tuple[float, float]:
    """Return the 95 % confidence interval of the mean of independent values, by bias-corrected bootstrap.

    The resampling is seeded, so the same values give the same interval. One value has none: (nan, nan).
    """
    if len(values) < 2:
        return math.nan, math.nan
    if max(values) == min(values):
        return values[0], values[0]
    rng = np.random.default_rng(0)
    low, high = stats.bootstrap(
        (np.asarray(values),), np.mean, n_resamples=RESAMPLES, vectorized=True, rng=rng
    ).confidence_interval
    return float(low), float(high)


def distribution(values: Sequence[float]) -> Spread:
    """Return mean, interval of the mean and 95th percentile of one value per episode."""
    return Spread(float(np.mean(values)), bootstrap_interval(values), float(np.quantile(values, 0.95)))


def summarise(records: Sequence[EpisodeRecord], steps: int) -> Summary:
    """Return the averages over the episodes of one policy in one scenario of that many control steps.

    Errors of lost episodes are padded, see `padded`; command and saturation are averaged over the steps that ran.
    """
    errors = [padded(record.errors, steps) for record in records]
    return Summary(
        episodes=len(records),
        rmse_m=float(np.mean([rmse(e) for e in errors])),
        tail_rmse_m=distribution([tail_rmse(e) for e in errors]),
        effort=float(np.mean([effort(record.actions) for record in records])),
        smoothness=float(np.mean([smoothness(record.actions) for record in records])),
        failures=sum(record.lost for record in records),
        saturation=sum(record.saturated for record in records) / sum(len(record.errors) for record in records),
        return_mean=float(np.mean([record.total_reward for record in records])),
        seconds=sum(record.seconds for record in records),
    )


def ratio(value: float, yardstick: float) -> float:
    """Return value / yardstick, nan where the yardstick is zero."""
    return value / yardstick if yardstick else math.nan
