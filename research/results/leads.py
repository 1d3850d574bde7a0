"""Paired comparisons of tails: how robust a lead is to the way in which it is measured, and to how many there are.

All policies have run the same episodes. Every number is a mean, a ratio or a median over them, its interval is that of
a bootstrap over the episodes of each case and over training seeds, and its p-value that of a normal distribution with
the bootstrap's spread, the same draws for all. Where several are told at once, p-values are corrected by S. Holm's
step-down ("A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 6:65-70, 1979).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from auv_gym.physics.namespaces import Array
from baselines.evaluation.metrics import resamplings, seed_shares

LEVEL = 0.05
"""Chance of a single wrong statement among all of a table, after Holm's correction."""
WORST_LEFT_OUT = 0.01
"""Share of each side's episodes, its worst ones, that are left out where they are."""
COMPARISONS = ("pooled", "storm", "median", "geometric mean", "without worst 1 %")
"""How the tails of two sides are compared, see `ratios`."""


@dataclass(frozen=True)
class LeadEstimate:
    """What is found of a comparison."""

    value: float
    ci95: tuple[float, float]
    p: float  # that there is no difference, two-sided, before any correction


def differences(rival: Sequence[Array], own: Sequence[Array]) -> LeadEstimate:
    """Return by how much own tails are smaller than a rival's, the mean over episodes [m]; 0: no difference.

    Args:
        rival: tails [m] of paired episodes, shape (M,) for each case.
        own: the same, shape (S, M) for each case, S training seeds.
    """
    draws = _Draws(rival, own)
    return _estimate(draws.mean(draws.rival - draws.own) / draws.episodes)


def ratios(rival: Mapping[str, Array], own: Mapping[str, Array]) -> dict[str, LeadEstimate]:
    """Return own tails over a rival's in each of the `COMPARISONS`; below 1 is nearer to the path.

    `pooled` is the ratio of the means, `storm` that in the storm alone, `median` and `geometric mean` those of the
    ratios of single episodes, and the last one `pooled` without the episodes that are among the worst 1 % of a side.

    Args:
        rival: tails [m] of paired episodes by case, shape (M,).
        own: the same, shape (S, M), S training seeds.
    """
    draws = _Draws(list(rival.values()), [own[case] for case in rival])
    storm = np.concatenate([np.full(len(tail), case.endswith("-storm")) for case, tail in rival.items()])
    logs = np.log(draws.own) - np.log(draws.rival)
    kept = ~(_worst(draws.own) | _worst(draws.rival[None]))
    found = {
        "pooled": _estimate(draws.ratio(np.ones_like(kept)), np.exp),
        "storm": _estimate(draws.ratio(np.broadcast_to(storm, kept.shape)), np.exp) if storm.any() else None,
        "median": draws.median(logs),
        "geometric mean": _estimate(draws.mean(logs) / draws.episodes, np.exp),
        "without worst 1 %": _estimate(draws.ratio(kept), np.exp),
    }
    return {kind: estimate for kind, estimate in found.items() if estimate is not None}


def holm(p: Sequence[float]) -> list[float]:
    """Return p-values corrected by Holm's step-down: one below `LEVEL` may be told among all of them."""
    order = np.argsort(p)
    steps = np.asarray(p, dtype=np.float64)[order] * np.arange(len(p), 0, -1)  # the smallest one times all of them
    corrected = np.empty(len(p))
    corrected[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return corrected.tolist()


class _Draws:
    """The tails of two sides, and how much each of them weighs in each bootstrap sample, in the first row as it is."""

    def __init__(self, rival: Sequence[Array], own: Sequence[Array]) -> None:
        self.rival, self.own = np.concatenate(rival), np.concatenate(own, axis=1)
        self.episodes = len(self.rival)
        self._weights = resamplings(tuple(map(len, rival)))
        self._shares = seed_shares(len(self.own))

    def mean(self, values: Array | NDArray[np.bool_]) -> Array:
        """Return the sums over episodes of values, shape (S, M), their mean over seeds, for each sample."""
        return np.asarray((self._sums(values) * self._shares).sum(axis=1))

    def ratio(self, kept: NDArray[np.bool_]) -> Array:
        """Return the logarithm of own tails over the rival's, sums over the episodes that are kept, shape (S, M)."""
        return np.asarray(np.log(self.mean(self.own * kept) / self.mean(self.rival * kept)))

    def median(self, values: Array) -> LeadEstimate:
        """Return the estimate of the median of values, shape (S, M), as a factor: they are logarithms.

        Its interval is that of R. S. Woodruff ("Confidence intervals for medians and other position measures", Journal
        of the American Statistical Association 47:635-646, 1952): the values about it between the shares of the values
        that the bootstrap's spread of the share below it leaves open. Its p-value is that of the share below 0.
        """
        middle = float(np.median(values))
        spread = float(np.std(self.mean(values <= middle)[1:] / self.episodes, ddof=1))
        reach = spread * float(stats.norm.ppf(0.975))
        low, high = np.exp(np.quantile(values, np.clip((0.5 - reach, 0.5 + reach), 0.0, 1.0))).tolist()
        p = _estimate(self.mean(values < 0) / self.episodes - 0.5).p
        return LeadEstimate(math.exp(middle), (low, high), p)

    def _sums(self, values: Array | NDArray[np.bool_]) -> Array:
        parts = np.split(
            np.asarray(values, dtype=np.float64), np.cumsum([w.shape[1] for w in self._weights])[:-1], axis=1
        )
        return np.asarray(sum(w @ part.T for w, part in zip(self._weights, parts, strict=True)))


def _worst(tails: Array) -> NDArray[np.bool_]:
    """Return which of the tails, shape (S, M), are the worst ones of their seed."""
    count = math.ceil(WORST_LEFT_OUT * tails.shape[1] - 1e-9)
    return np.asarray(tails.shape[1] - count <= np.argsort(np.argsort(tails, axis=1), axis=1))


def _estimate(values: Array, shown: Callable[[Array], Array] = np.asarray) -> LeadEstimate:
    """Return the estimate of a value, which is 0 without a difference, from it and its bootstrap samples.

    Args:
        values: the value, then the samples.
        shown: takes them to what is told.
    """
    distance, spread = abs(float(values[0])), float(np.std(values[1:], ddof=1))
    p = 1.0 if not distance else 2 * float(stats.norm.sf(distance / spread)) if spread else 0.0
    value, low, high = shown(np.array([values[0], *np.quantile(values[1:], (0.025, 0.975))])).tolist()
    return LeadEstimate(value, (low, high), p)
