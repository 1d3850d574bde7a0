"""The pages of suites with artificial results: ratios to the best controller, cells, seeds, errors over the noise."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.evaluation.cells import Cell
from baselines.evaluation.metrics import Measures
from baselines.evaluation.runner import Run
from baselines.evaluation.suites import load_suite
from research.results import overview, suite_page
from research.results.collection import CONTROLLERS, Results
from research.trainings.seed_runs import SeedRuns

FACTORS = {"nmpc": 1.0, "nmpc-adverse": 2.0, "ekf": 3.0, "los-pid": 4.0, "lqi": 5.0, "backstepping": 9.0, "helm": 0.5}
"""Errors of the policies over those of `nmpc`."""


def measures(errors, rate=1.0):
    """Return the metrics of episodes with given errors [m]; those of 10 m and more have failed."""
    ones = np.ones(len(errors))
    return Measures(errors, errors, ones, ones, rate * ones, ones, ones, ones, errors >= 10.0)


@pytest.fixture(scope="module")
def results():
    """All policies have the errors of `nmpc` times a factor; in cruise-storm `ekf` is best and `helm` fails once."""
    whole, rng, runs = load_suite("benchmark-v3"), np.random.default_rng(0), []
    suite = replace(whole, cells=tuple(Cell(c.scenario, c.episodes[:20]) for c in whole.cells))
    for cell in suite.cells:
        base = rng.uniform(0.01, 0.02, len(cell.episodes))
        for policy, factor in FACTORS.items():
            storm = cell.scenario.name == "cruise-storm"
            errors = base * (0.1 if storm and policy == "ekf" else factor)
            errors[0] = 10.0 if storm and policy == "helm" else errors[0]
            runs.append(Run(policy, cell.scenario, cell.hash, measures(errors, 2.0 if policy == "helm" else 1.0)))
    return Results(suite, tuple(runs))


def test_the_best_controller_of_each_cell(results):
    assert {best for cell, best in results.best.items() if cell != "cruise-storm"} == {"nmpc"}
    assert results.best["cruise-storm"] == "ekf"
    assert results.to_best(results.errors("lqi", "slow")).mean == pytest.approx(5)
    assert results.to_best(results.errors("helm", "slow")).ci95 == pytest.approx((0.5, 0.5))


def test_the_headline_by_hand(results):
    """The failed episode counts with the error cap of 2 m."""
    own, theirs = (results.cases["cruise-storm"][policy].steady_rmse.copy() for policy in ("helm", "ekf"))
    own[0] = 2.0
    worst = own.mean() / theirs.mean()
    shown = suite_page.headline(results)
    assert float(shown["ratio"].split()[0]) == pytest.approx((0.5**23 * worst) ** (1 / 24), abs=6e-3)
    assert shown["worst"].endswith(" in `cruise-storm`")
    assert shown["worst"].startswith(f"{worst:.2f}" if worst < 100 else f"{worst:.0f}")
    assert shown["failed"] == "1 (best controllers: 0) of 480"
    assert shown["behind"] in ("`cruise-storm`", "none")


def test_rows_of_cells_policies_and_seeds(results):
    first = suite_page.cell_rows(results)[0]
    assert first[:2] == ["`slow-calm`", "`nmpc`"]
    assert first[4:] == ["0.50 (0.50 ... 0.50)", "0, 0", "2.00"]
    by_cell = {row[0]: row for row in suite_page.cell_rows(results)}
    assert by_cell["`cruise-storm-rtk`"][4].startswith("0.50")
    own, best = (float(number) for number in by_cell["`cruise-storm`"][3:1:-1])
    assert float(by_cell["`cruise-storm`"][4].split()[0]) == pytest.approx(own / best, rel=0.01)  # without -rtk, -usbl
    rows = suite_page.policy_rows(results, "slow")
    assert [row[0].strip("`") for row in rows] == sorted(FACTORS, key=FACTORS.get)
    assert rows[0][1:] == ["0.50 (0.50 ... 0.50)", "0 of 240 (<= 1.2 %)", "1.00", "2.00", "nan"]
    cell = results.cases["slow-calm"]
    (row,) = suite_page.seed_rows(results, {"helm": SeedRuns({"slow-calm": [cell["helm"], cell["nmpc"]]})})
    assert row == ["`helm`", "2", "0.75 (0.50 ... 1.00)", "0 of 40 (<= 7.2 %)", "1.50"]


def test_errors_over_the_noise_have_every_episode_of_storms(results):
    for policy in ("helm", *CONTROLLERS):
        points = overview.noise_curve(results, policy, "slow")
        assert len(points) == overview._BINS + 2
        levels = [level for level, _ in points]
        assert (levels[0], levels[-1]) == (pytest.approx(0.006), pytest.approx(0.6))
        assert levels == sorted(levels)
        mean = np.mean([error for _, error in points[1:-1]])
        assert mean == pytest.approx(results.errors(policy)["slow-storm"].mean())
