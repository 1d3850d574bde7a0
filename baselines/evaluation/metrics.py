"""The metrics of an evaluation; `score` has the definition of the score.

An episode of N control steps, k = 1 ... N, has errors and commands. The error e_k [m] is the distance of the centre of
mass to the reference after step k. The command a_k = (a_u, a_r) of step k is normalised and clipped to [-1, 1], as in
the actuators. Functions of errors take e_k along axis 0, for one episode (N,) or several (N, episodes).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array

RESAMPLES = 2000
"""Number of bootstrap samples of an interval."""
WORST = 0.05
"""Share of the worst episodes whose mean is the conditional value at risk."""


@dataclass(frozen=True)
class Track:
    """The trajectory of one episode, one row for each control instant, including the start."""

    rows: Array  # x, y, x_R, y_R [m], psi, psi_R [rad], V_x, V_y [m/s] of the water at the vehicle; in space z, z_R [m]

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def position(self) -> Array:
        """Positions x, y [m], shape (n, 2)."""
        return self.rows[:, 0:2]

    @property
    def reference(self) -> Array:
        """Positions of the reference x_R, y_R [m], shape (n, 2)."""
        return self.rows[:, 2:4]

    @property
    def heading(self) -> Array:
        """Headings psi, psi_R [rad], shape (n, 2)."""
        return self.rows[:, 4:6]

    @property
    def current(self) -> Array:
        """Current V_x, V_y [m/s] in world axes, shape (n, 2)."""
        return self.rows[:, 6:8]

    @property
    def height(self) -> Array:
        """Heights z, z_R [m], shape (n, 2); (n, 0) in the plane."""
        return self.rows[:, 8:10]

    @property
    def error(self) -> Array:
        """Distance to the reference [m], shape (n,)."""
        level = np.hypot(*(self.position - self.reference).T)
        return np.asarray(np.hypot(level, np.diff(self.height).sum(axis=1)))


@dataclass(frozen=True)
class Measures:
    """The metrics of M episodes, arrays of shape (M,)."""

    rmse: Array  # [m]
    steady_rmse: Array  # [m] see `steady_rmse`
    settling: Array  # [s]
    effort: Array
    smoothness: Array
    saturation: Array  # share of the steps with an actuator commanded to its limit
    total_reward: Array
    steps: Array  # number of control steps
    failed: NDArray[np.bool_]  # whether it ended beyond the scenario's `lost_distance`

    def __len__(self) -> int:
        return len(self.steady_rmse)

    def __getitem__(self, episodes: slice) -> Measures:
        return Measures(*(getattr(self, field.name)[episodes] for field in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[Measures]) -> Measures:
        """Return the metrics of the episodes of all parts, in order."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))


class Ended(NamedTuple):
    """The outcome of episodes, arrays of the same shape."""

    steady_rmse: Array  # [m] meaningless for failed episodes
    failed: NDArray[np.bool_]  # whether it ended beyond the scenario's `lost_distance`


@dataclass(frozen=True)
class Spread:
    """The distribution of one quantity over episodes."""

    mean: float
    ci95: tuple[float, float]  # 95 % confidence interval of the mean
    median: float
    p95: float  # 95th percentile over episodes
    cvar95: float  # mean of the worst 5 %


@dataclass(frozen=True)
class Summary:
    """Metrics of a policy in a scenario, averaged over its episodes."""

    episodes: int
    rmse_m: float  # [m]
    steady_rmse_m: Spread  # [m]
    settling_s: float  # [s]
    effort: float
    smoothness: float
    saturation: float  # share of the steps
    return_mean: float


def rmse(errors: Array) -> Array:
    """Return sqrt(mean_k e_k^2) [m]."""
    return np.asarray(np.sqrt(np.mean(np.square(errors), axis=0)))


def steady_rmse(errors: Array) -> Array:
    """Return sqrt(mean_(k > floor(N/3)) e_k^2) [m], the steady-state RMSE: after the first third of the episode."""
    return rmse(errors[len(errors) // 3 :])


def settling_time(errors: Array, bound: float, dt: float) -> Array:
    """Return the time [s] of the last e_k above a bound [m], for a control period dt [s]; 0 if there is none."""
    above = errors > bound
    last = len(errors) - np.argmax(above[::-1], axis=0)
    return np.asarray(np.where(above.any(axis=0), last, 0) * dt)


def effort(actions: Array) -> float:
    """Return the mean square of commands, shape (n, channels): mean_k (a_u,k^2 + a_r,k^2) / 2 in the plane."""
    return float(np.mean(np.square(actions)))


def smoothness(actions: Array) -> float:
    """Return the mean squared change of a command, in the plane mean_(k >= 2) |a_k - a_(k-1)|^2 / 2; 0 for one step."""
    return float(np.mean(np.square(np.diff(actions, axis=0)))) if len(actions) > 1 else 0.0


def bootstrap_interval(values: Sequence[float] | Array) -> tuple[float, float]:
    """Return the 95 % confidence interval of the mean of independent values, by bias-corrected bootstrap.

    The interval is the BCa interval, as in `scipy.stats.bootstrap` (B. Efron, "Better bootstrap confidence intervals",
    Journal of the American Statistical Association 82:171-185, 1987). The resampling has a fixed seed, so the same
    values give the same interval. For a single value the result is (nan, nan).
    """
    values = np.asarray(values, dtype=np.float64)
    if len(values) < 2:
        return math.nan, math.nan
    if values.max() == values.min():
        return float(values[0]), float(values[0])
    means = values[_drawn(len(values))].mean(axis=1)
    below = (np.sum(means < values.mean()) + np.sum(means <= values.mean())) / (2 * RESAMPLES)
    off = values - values.mean()
    acceleration = np.sum(off**3) / (6 * np.sum(off**2) ** 1.5)
    normal = NormalDist()
    bias, quantiles = normal.inv_cdf(below), map(normal.inv_cdf, (0.025, 0.975))
    ends = [normal.cdf(bias + (bias + z) / (1 - acceleration * (bias + z))) for z in quantiles]
    low, high = np.quantile(means, ends).tolist()
    return low, high


@lru_cache(maxsize=4)
def _drawn(count: int) -> NDArray[np.int64]:
    """Return the indices of the values in each bootstrap sample of `count` values, shape (RESAMPLES, count)."""
    return np.random.default_rng(0).integers(0, count, (RESAMPLES, count))


@lru_cache(maxsize=8)
def resamplings(lengths: tuple[int, ...]) -> list[Array]:
    """Return the bootstrap weights of the episodes of each case, shape (1 + RESAMPLES, n); the first row is ones."""
    rng = np.random.default_rng(0)
    counts = (rng.multinomial(n, np.full(n, 1 / n), RESAMPLES) for n in lengths)
    return [np.vstack((np.ones((1, n)), count)) for n, count in zip(lengths, counts, strict=True)]


@lru_cache(maxsize=4)
def seed_shares(count: int) -> Array:
    """Return the bootstrap weights of training seeds, shape (1 + RESAMPLES, count); the first row is uniform."""
    drawn = np.random.default_rng(1).multinomial(count, np.full(count, 1 / count), RESAMPLES) / count
    return np.vstack((np.full((1, count), 1 / count), drawn))


def cvar(values: Array) -> float:
    """Return the mean of the largest share `WORST` of the values, shape (M,), at least of one value."""
    worst = max(1, math.ceil(WORST * len(values) - 1e-9))
    return float(np.mean(np.sort(values)[-worst:]))


def distribution(values: Array, interval: bool = True) -> Spread:
    """Return the distribution of one value per episode; without `interval` the interval of the mean is nan."""
    ends = bootstrap_interval(values) if interval else (math.nan, math.nan)
    median, p95 = np.quantile(values, (0.5, 0.95))
    return Spread(float(np.mean(values)), ends, float(median), float(p95), cvar(values))


def failure_bound(failed: int, episodes: int) -> float:
    """Return the 95 % upper confidence bound of a failure rate (Clopper and Pearson), about 3 / episodes for none."""
    if not failed:
        return float(1 - 0.05 ** (1 / episodes))
    from scipy.special import betaincinv  # it takes a tenth of a second

    return float(betaincinv(failed + 1, episodes - failed, 0.95)) if failed < episodes else 1.0


def summarise(m: Measures, interval: bool = True) -> Summary:
    """Return the averages over the episodes of a policy; `interval` adds that of the steady-state RMSE (slow)."""
    return Summary(
        episodes=len(m),
        rmse_m=float(np.mean(m.rmse)),
        steady_rmse_m=distribution(m.steady_rmse, interval),
        settling_s=float(np.mean(m.settling)),
        effort=float(np.mean(m.effort)),
        smoothness=float(np.mean(m.smoothness)),
        saturation=float((m.saturation * m.steps).sum() / m.steps.sum()),
        return_mean=float(np.mean(m.total_reward)),
    )


def ratio(value: float, reference: float) -> float:
    """Return value / reference, nan if the reference is zero."""
    return value / reference if reference else math.nan
