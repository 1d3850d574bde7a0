"""Metrics and score by hand."""

import math

import numpy as np
import pytest

from baselines.evaluation import metrics
from baselines.evaluation.metrics import Measures
from baselines.evaluation.score import pooled, score


def test_metrics_by_hand():
    assert metrics.rmse(np.array([3.0, 4.0])) == pytest.approx(math.sqrt(12.5))
    assert metrics.tail_rmse(np.array([9.0, 9.0, 1.0, 1.0, 1.0, 7.0])) == pytest.approx(math.sqrt(52 / 4))
    assert metrics.tail_rmse(np.array([9.0, 1.0, 1.0, 1.0, 1.0])) == 1.0  # floor(5/3) = 1 step is left out
    assert metrics.effort(np.array([[1.0, 0.0], [0.5, 0.5]])) == pytest.approx(1.5 / 4)
    assert metrics.smoothness(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])) == pytest.approx(5 / 4)
    assert metrics.smoothness(np.array([[1.0, 1.0]])) == 0
    assert metrics.ratio(3.0, 2.0) == 1.5
    assert math.isnan(metrics.ratio(3.0, 0.0))
    errors = np.array([[3.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 2.0, 0.0]])
    np.testing.assert_allclose(metrics.settling_time(errors, 1.0, 0.5), [0.5, 1.5, 0.0])
    assert metrics.cvar(np.arange(1.0, 101.0)) == 98  # of 96 ... 100
    assert metrics.cvar(np.array([1.0, 2.0])) == 2


def measures(tail, lost=None, steps=600):
    tail = np.asarray(tail, dtype=np.float64)
    zero = np.zeros_like(tail)
    lost = np.zeros(len(tail), dtype=bool) if lost is None else np.array(lost)
    return Measures(tail, tail, zero, zero, zero, np.full_like(tail, 0.5), zero, np.full_like(tail, steps), lost)


def test_summary_by_hand():
    s = metrics.summarise(Measures.joined([measures([1.0]), measures([3.0], [True], 200)]))
    assert s.tail_rmse_m.mean == s.rmse_m == 2
    assert s.tail_rmse_m.p95 == pytest.approx(2.9)
    assert s.tail_rmse_m.cvar95 == 3
    assert (s.episodes, s.failures, s.saturation) == (2, 1, 0.5)


def test_score_by_hand():
    """Errors are pooled before the division: (6 - 3) / (6 - 2), not the mean of the two ratios."""
    expert, policy, oracle = ([np.full(4, a), np.full(4, b)] for a, b in ((1.0, 5.0), (2.0, 1.0), (0.5, 1.5)))
    s = score(expert, policy, oracle)
    assert s.mean == pytest.approx(0.75)
    assert s.ci95 == pytest.approx((0.75, 0.75))
    assert score(expert, expert, oracle).mean == 0
    assert score(expert, oracle, oracle).mean == 1
    assert math.isnan(score(oracle, policy, expert).mean)


def test_the_capped_score_forgives_lost_episodes():
    cases = {
        "slow-calm": {"backstepping": measures([0.5, 0.5]), "p": measures([0.1, 9.0]), "oracle": measures([0.0, 0.0])},
        "cruise-calm": {"backstepping": measures([0.5])},
    }
    entry = pooled("p", "slow", cases)
    assert entry.lost == 0.5
    assert entry.score.mean == pytest.approx((0.5 - 4.55) / 0.5)
    assert entry.capped.mean == pytest.approx((0.5 - 0.35) / 0.5)
    assert pooled("p", "cruise", cases) is None
    assert pooled("backstepping", "cruise", cases).score is None


def test_score_intervals_are_paired():
    """What all three share from episode to episode does not widen the interval."""
    rng = np.random.default_rng(0)
    hard = rng.lognormal(0.0, 1.0, 300)
    s = score([hard], [0.3 * hard], [0.0 * hard])
    assert s.ci95 == pytest.approx((0.7, 0.7))
    noisy = score([hard], [0.3 * rng.permutation(hard)], [0.0 * hard])
    assert noisy.ci95[1] - noisy.ci95[0] > 0.05


def test_bootstrap_interval():
    values = np.random.default_rng(1).normal(5.0, 1.0, 400).tolist()
    low, high = metrics.bootstrap_interval(values)
    assert (low, high) == metrics.bootstrap_interval(values)
    assert high - low == pytest.approx(2 * 1.96 / 20, rel=0.15)
    assert low < np.mean(values) < high
    assert metrics.bootstrap_interval([2.0, 2.0, 2.0]) == (2.0, 2.0)
    assert all(math.isnan(end) for end in metrics.bootstrap_interval([2.0]))
