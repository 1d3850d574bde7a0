"""Paired comparisons of tails: against scipy and direct sums; Holm's correction by its definition."""

import itertools

import numpy as np
import pytest
from scipy import stats

from research.results.leads import COMPARISONS, LEVEL, differences, holm, ratios

CASES = ("slow-calm", "slow-noise", "slow-storm")


@pytest.fixture(scope="module")
def tails():
    """Tails [m] of a rival, (M,), and of three seeds, (3, M), which are nearer by a fifth in the mean."""
    rng = np.random.default_rng(5)
    rival = {case: rng.lognormal(-3, 1, 100) for case in CASES}
    return rival, {case: 0.8 * tail * rng.lognormal(0, 0.3, (3, 100)) for case, tail in rival.items()}


def joined(tails):
    rival, own = tails
    return np.concatenate(list(rival.values())), np.concatenate([own[case] for case in CASES], axis=1)


def test_differences_are_those_of_scipy(tails):
    one = [{case: tail[:1] for case, tail in tails[1].items()}[case] for case in CASES]
    found, (rival, own) = differences(list(tails[0].values()), one), joined(tails)
    assert found.value == pytest.approx(np.mean(rival - own[0]), abs=1e-15)
    own_of_case = [rival_case - o[0] for rival_case, o in zip(tails[0].values(), one, strict=True)]
    error = np.sqrt(sum(np.var(d) / len(d) for d in own_of_case)) / len(CASES)  # of a mean within strata
    assert found.ci95[0] == pytest.approx(found.value - 1.96 * error, abs=0.2 * error)
    assert found.ci95[1] == pytest.approx(found.value + 1.96 * error, abs=0.2 * error)
    assert found.p == pytest.approx(2 * stats.norm.sf(found.value / error), rel=0.5)
    alike = differences(list(tails[0].values()), [tail[None] for tail in tails[0].values()])
    assert (alike.value, alike.ci95, alike.p) == (0.0, (0.0, 0.0), 1.0)


def test_ratios_by_direct_sums(tails):
    found, (rival, own) = ratios(*tails), joined(tails)
    assert tuple(found) == COMPARISONS
    assert found["pooled"].value == pytest.approx(own.mean() / rival.mean())
    assert found["storm"].value == pytest.approx(own[:, 200:].mean() / rival[200:].mean())
    assert found["geometric mean"].value == pytest.approx(stats.gmean(own / rival, axis=None))
    assert found["median"].value == pytest.approx(np.median(own / rival), rel=2e-3)
    lost = {int(i) for i in np.argsort(rival)[-3:]}
    above = below = 0.0
    for seed in own:
        kept = sorted(set(range(300)) - lost - {int(i) for i in np.argsort(seed)[-3:]})
        above, below = above + seed[kept].sum(), below + rival[kept].sum()
    assert found["without worst 1 %"].value == pytest.approx(above / below)
    for estimate in found.values():
        assert estimate.ci95[0] < estimate.value < estimate.ci95[1]
        assert estimate.p < 0.01


def test_intervals_of_single_agents_are_those_of_scipy():
    rng = np.random.default_rng(6)
    rival = rng.lognormal(-3, 1, 400)
    own = rival * rng.lognormal(0.1, 1, 400)
    found = ratios({"slow-calm": rival}, {"slow-calm": own[None]})
    assert "storm" not in found
    for kind, statistic in (("geometric mean", np.mean), ("median", np.median)):
        boot = stats.bootstrap((np.log(own / rival),), statistic, method="percentile", n_resamples=2000, rng=rng)
        np.testing.assert_allclose(np.log(found[kind].ci95), boot.confidence_interval, atol=0.03)


def test_seeds_that_differ_widen_every_interval(tails):
    rival, own = tails
    alike = {case: np.stack((tail[0],) * 3) for case, tail in own.items()}
    apart = {case: np.stack([factor * tail[0] for factor in (0.7, 1.0, 1.3)]) for case, tail in own.items()}
    for kind in COMPARISONS:
        narrow, wide = (ratios(rival, each)[kind] for each in (alike, apart))
        assert np.log(wide.ci95[1] / wide.ci95[0]) > 1.5 * np.log(narrow.ci95[1] / narrow.ci95[0])
        assert wide.p > narrow.p


def test_holm_rejects_what_its_definition_rejects():
    """Step down: the smallest of m is compared with LEVEL / m, the next one with LEVEL / (m - 1), while it is below."""
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([]) == []
    for p in itertools.permutations((0.001, 0.02, 0.0124, 0.6, 0.0126)):
        rejected = set()
        for k, each in enumerate(sorted(p)):
            if each > LEVEL / (len(p) - k):
                break
            rejected.add(each)
        assert {each for each, corrected in zip(p, holm(p), strict=True) if corrected <= LEVEL} == rejected
