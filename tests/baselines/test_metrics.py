"""Metrics and score, compared with values computed by hand and with SciPy."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation import metrics
from baselines.evaluation.metrics import Measures
from baselines.evaluation.report.columns import ranked
from baselines.evaluation.report.numbers import compare, pool
from baselines.evaluation.runner import Run
from baselines.evaluation.score import (
    Score,
    cap_of,
    capped,
    count_failures,
    difference,
    error_cap,
    fixed,
    fixed_ends,
    has_failed,
    in_paper_metres,
    interval_text,
    relative_error,
    score,
    unit_of,
)


def test_metrics_by_hand():
    assert metrics.rmse(np.array([3.0, 4.0])) == pytest.approx(math.sqrt(12.5))
    assert metrics.steady_rmse(np.array([9.0, 9.0, 1.0, 1.0, 1.0, 7.0])) == pytest.approx(math.sqrt(52 / 4))
    assert metrics.steady_rmse(np.array([9.0, 1.0, 1.0, 1.0, 1.0])) == 1.0  # floor(5/3) = 1 step is left out
    assert metrics.effort(np.array([[1.0, 0.0], [0.5, 0.5]])) == pytest.approx(1.5 / 4)
    assert metrics.smoothness(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])) == pytest.approx(5 / 4)
    assert metrics.smoothness(np.array([[1.0, 1.0]])) == 0
    assert metrics.ratio(3.0, 2.0) == 1.5
    assert math.isnan(metrics.ratio(3.0, 0.0))
    errors = np.array([[3.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 2.0, 0.0]])
    np.testing.assert_allclose(metrics.settling_time(errors, 1.0, 0.5), [0.5, 1.5, 0.0])
    assert metrics.cvar(np.arange(1.0, 101.0)) == 98  # of 96 ... 100
    assert metrics.cvar(np.array([1.0, 2.0])) == 2


def measures(steady_rmse, failed=None, steps=600):
    steady_rmse = np.asarray(steady_rmse, dtype=np.float64)
    zero = np.zeros_like(steady_rmse)
    failed = np.zeros(len(steady_rmse), dtype=bool) if failed is None else np.array(failed)
    half, count = np.full_like(steady_rmse, 0.5), np.full_like(steady_rmse, steps)
    return Measures(steady_rmse, steady_rmse, zero, zero, zero, half, zero, count, failed)


def test_summary_by_hand():
    s = metrics.summarise(Measures.joined([measures([1.0]), measures([3.0], [True], 200)]))
    assert s.steady_rmse_m.mean == s.rmse_m == 2
    assert s.steady_rmse_m.median == 2
    assert s.steady_rmse_m.p95 == pytest.approx(2.9)
    assert s.steady_rmse_m.cvar95 == 3
    assert (s.episodes, s.saturation) == (2, 0.5)


def test_distances_of_a_vehicle_of_twice_the_length():
    scenario = Scenario(name="slow-calm", vehicle=replace(PAPER_VEHICLE, m33=4 * PAPER_VEHICLE.m33))
    assert (unit_of(scenario), unit_of(Scenario()), cap_of(scenario)) == (2, 1, 1.2)
    m = in_paper_metres(measures([3.0]), scenario)
    assert (m.rmse, m.steady_rmse, m.saturation) == (1.5, 1.5, 0.5)


def test_score_by_hand():
    """Errors are pooled before the division: (6 - 3) / (6 - 2), not the mean of the two ratios."""
    expert, policy, oracle = ([np.full(4, a), np.full(4, b)] for a, b in ((1.0, 5.0), (2.0, 1.0), (0.5, 1.5)))
    s = score(expert, policy, oracle)
    assert s.mean == pytest.approx(0.75)
    assert s.ci95 == pytest.approx((0.75, 0.75))
    assert score(expert, expert, oracle).mean == 0
    assert score(expert, oracle, oracle).mean == 1
    assert math.isnan(score(oracle, policy, expert).mean)


def test_relative_error_by_hand():
    """The ratios 1/2 and 8 have the geometric mean 2; with a second seed of three times the errors it is 4."""
    rival, own = [np.full(4, 2.0), np.full(3, 1.0)], [np.full(4, 1.0), np.full(3, 8.0)]
    assert relative_error(rival, own).mean == pytest.approx(2)
    found = relative_error(rival, [np.stack((e, 3 * e)) for e in own])
    assert (found.mean, *found.ci95) == pytest.approx((4, 2, 6))


def run_of(scenario, policy, m):
    return Run(policy, Scenario(name=scenario), "hash", m, decision_seconds=1e-3)


def test_the_capped_score_limits_the_effect_of_failed_episodes():
    runs = [
        run_of("slow-calm", "backstepping", measures([0.5, 0.5])),
        run_of("slow-calm", "p", measures([0.1, 9.0])),
        run_of("slow-calm", "clairvoyant", measures([0.0, 0.0])),
        run_of("cruise-calm", "backstepping", measures([0.5])),
    ]
    found = {(entry.policy, entry.place): entry for entry in pool(runs)}
    entry = found["p", "slow"]
    assert entry.failed == 1
    assert entry.score.mean == pytest.approx((0.5 - 4.55) / 0.5)
    assert entry.capped.mean == pytest.approx((0.5 - 0.35) / 0.5)
    assert ("p", "cruise") not in found
    assert found["backstepping", "cruise"].score is None


def test_failed_episodes():
    m = measures([0.1, 2.0, 0.1, math.nan], [False, False, True, False])
    assert has_failed(m, 2.0).tolist() == [False, True, True, True]
    assert (count_failures(m, 2.0), count_failures(measures([0.1, 9.0], [True, False]), math.inf)) == (3, 1)
    np.testing.assert_array_equal(capped(m, 2.0), [0.1, 2.0, 2.0, 2.0])
    np.testing.assert_array_equal(capped(measures([9.0, 7.0], [True, False]), math.inf), [9.0, 7.0])
    caps = {name: error_cap(name) for name in ("slow-storm", "cruise-calm@remus100", "harbour")}
    assert list(caps.values()) == [0.6, 2.0, math.inf]


def test_ranking_has_the_best_first_and_failed_runs_last():
    runs = [run_of("slow-calm", p, measures([e, e])) for p, e in (("backstepping", 0.5), ("p", 0.1), ("oracle", 0.0))]
    runs += [Run("broken", Scenario(name="slow-calm"), "hash", error="no")]
    entries = [result.entry for result in compare(runs)]
    assert [entry.policy for entry in ranked(entries)] == ["oracle", "p", "backstepping", "broken"]
    assert [entry.policy for entry in ranked(entries[:2])] == ["p", "backstepping"]


def test_scores_as_text():
    s = Score(0.12345, (-0.0001, 123.4))
    assert (fixed(s.mean), fixed(s.mean, 1), interval_text(s)) == ("0.123", "0.1", "0.000 ... 123")
    assert fixed_ends((0.1, 0.25)) == "0.100 ... 0.250"
    assert {interval_text(None), interval_text(Score(math.nan, (math.nan, math.nan)))} == {"-"}


def test_score_intervals_are_paired():
    """A factor per episode that all three policies share does not widen the interval."""
    rng = np.random.default_rng(0)
    hard = rng.lognormal(0.0, 1.0, 300)
    s = score([hard], [0.3 * hard], [0.0 * hard])
    assert s.ci95 == pytest.approx((0.7, 0.7))
    noisy = score([hard], [0.3 * rng.permutation(hard)], [0.0 * hard])
    assert noisy.ci95[1] - noisy.ci95[0] > 0.05


@pytest.mark.parametrize("count", [2, 20, 260])
def test_bootstrap_interval_is_that_of_scipy(count):
    values = np.random.default_rng(count).lognormal(0, 2, count)
    options = {"n_resamples": metrics.RESAMPLES, "rng": np.random.default_rng(0)}
    np.testing.assert_allclose(
        metrics.bootstrap_interval(values), stats.bootstrap((values,), np.mean, **options).confidence_interval
    )


@pytest.mark.parametrize(("failed", "episodes"), [(0, 2080), (1, 20), (19, 20), (20, 20)])
def test_bounds_of_failure_rates_are_those_of_scipy(failed, episodes):
    upper = stats.binomtest(failed, episodes, alternative="less").proportion_ci(0.95).high
    assert metrics.failure_bound(failed, episodes) == pytest.approx(upper, rel=1e-12)


def test_difference_to_the_best_equals_a_paired_bootstrap():
    rng = np.random.default_rng(3)
    best, own = rng.gamma(4, 0.01, 40), rng.gamma(4, 0.012, 40)
    found = difference([best], [own])
    assert found.mean == pytest.approx(own.mean() - best.mean())
    other = stats.bootstrap((own - best,), np.mean, n_resamples=9999, method="percentile", rng=np.random.default_rng(4))
    np.testing.assert_allclose(found.ci95, other.confidence_interval, atol=0.002)
    means = metrics.resamplings((40,))[0][1:] @ (own - best) / 40
    assert found.ci95 == pytest.approx(np.percentile(means, (2.5, 97.5)), rel=1e-12)


def test_each_policy_is_compared_with_the_best_one_without_full_information():
    errors = {"clairvoyant": [0.1, 0.1], "lqi": [0.2, 0.4], "ekf": [0.5, 0.5]}
    entries = pool([run_of("slow-calm", policy, measures(values)) for policy, values in errors.items()])
    found = {entry.policy: entry.to_best and entry.to_best.mean for entry in entries}
    assert found == {"clairvoyant": pytest.approx(-0.2), "lqi": None, "ekf": pytest.approx(0.2)}
