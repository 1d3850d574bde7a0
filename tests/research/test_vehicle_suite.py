"""The suite of published vehicles: complete and reproducible; scores without units; the optimum; the page."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from similar_vehicles import twin

from auv_gym import PRESETS
from auv_gym.physics.units import Units
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.presets import CASES, as_scenario
from auv_gym.scenarios.vehicles import vehicle_model, vehicle_names
from baselines import make_policy
from baselines.control.privileged.optimum import arriving, oracle_actions
from baselines.control.privileged.problem import Problem
from baselines.control.privileged.solver import TOLERANCE, WINDOWS, best_trajectory, optimised, receding_horizon
from baselines.evaluation import suites
from baselines.evaluation.cells import drawn
from baselines.evaluation.metrics import Measures
from baselines.evaluation.report.numbers import pool
from baselines.evaluation.rollout import rollout
from baselines.evaluation.runner import Recorded, Run
from baselines.evaluation.score import in_paper_metres, unit_of
from research.results import vehicles
from research.results.collection import Results
from research.suites.builder import VEHICLE_EPISODES
from research.trainings.seed_runs import SeedRuns

OTHER = Units(length=16.0, time=4.0, mass=4096.0)  # of a similar vehicle


@pytest.fixture(scope="module")
def suite():
    return suites.load_suite(vehicles.VEHICLES_SUITE)


def test_the_suite_has_eight_published_vehicles_in_every_case(suite):
    assert suite.hash == "8e1a04e1caa7cbcfc32ee9fd78a0aff1bf2c56a63986bab05fd9dddf48f854b9"
    slow = [name for name in vehicle_names() if not vehicle_model(name).actuators.fin]
    names = [f"{r}-{c}@{v}" for r, own in (("cruise", vehicle_names()), ("slow", slow)) for v in own for c in CASES]
    assert [cell.scenario.name for cell in suite.cells] == names
    known = {cell.scenario.vehicle for cell in suite.cells}
    assert len(known - {PAPER_VEHICLE}) == len(known) == 8
    for cell in suite.cells:
        assert len(cell.episodes) == VEHICLE_EPISODES[cell.scenario.name.split("-")[0]]
        assert cell.scenario == as_scenario(cell.scenario.name)


def measures(steady_rmse):
    steady_rmse = np.array(steady_rmse, dtype=np.float64)
    ones = np.ones(len(steady_rmse))
    return Measures(steady_rmse.copy(), steady_rmse, ones, ones, ones, ones, ones, ones, ones < 0)


def runs_of(scenario, factor):
    """Return runs of policies whose errors are larger by a factor."""
    errors = {
        "backstepping": [1.0, 5.0, 0.5],
        "nmpc": [0.3, 0.1, 0.2],
        "ekf": [0.4, 0.3, 0.1],
        "clairvoyant": [0.0] * 3,
    }
    return [Run(policy, scenario, "", measures(factor * np.array(row))) for policy, row in errors.items()]


PAPER_CELL = PRESETS["cruise-storm"]
FAR_CELL = replace(changed(PAPER_CELL, twin(OTHER)), name="cruise-storm@twin")


def test_a_similar_vehicle_has_the_same_results_and_does_not_dominate_pooled_ones():
    """Scores and failures, with errors in proportion to the length of the vehicle."""
    alone = {e.policy: e for e in pool(runs_of(PAPER_CELL, 1.0))}
    entries = {(e.place, e.policy): e for e in pool([*runs_of(PAPER_CELL, 1.0), *runs_of(FAR_CELL, 16.0)])}
    assert {place for place, _ in entries} == {"cruise", "cruise@paper", "cruise@twin"}
    for policy, paper in alone.items():
        both, twins = entries["cruise", policy], entries["cruise@twin", policy]
        assert both.capped.mean == pytest.approx(paper.capped.mean) == pytest.approx(twins.capped.mean)
        assert both.score.mean == pytest.approx(paper.score.mean) == pytest.approx(twins.score.mean)
        assert both.error_ratio == pytest.approx(paper.error_ratio)
        assert (both.failed, twins.failed) == (2 * paper.failed, paper.failed)
        mean = paper.summary.steady_rmse_m.mean
        assert both.summary.steady_rmse_m.mean == pytest.approx(mean)  # metres of the paper's vehicle
        assert twins.summary.steady_rmse_m.mean == pytest.approx(16 * mean)


def test_the_optimum_of_a_similar_vehicle_is_similar():
    short = [replace(s, steps=s.steps // 3) for s in (PAPER_CELL, FAR_CELL)]
    steady_rmses = [
        rollout(make_policy("clairvoyant"), s, drawn(s, 3, 100).episodes).measures.steady_rmse for s in short
    ]
    np.testing.assert_allclose(steady_rmses[1] / 16, steady_rmses[0], atol=2 * TOLERANCE)


@pytest.mark.slow
def test_with_active_limits_a_receding_horizon_gives_a_better_optimum_than_the_oracle():
    """A torpedo with lift and small fins in a storm: started at the commands of the oracle, the solver ends badly."""
    scenario = as_scenario("cruise-storm@remus100")
    episodes = drawn(scenario, 23, 5).episodes[22:]
    problem = Problem.of(scenario, episodes)
    guess = arriving(oracle_actions(scenario, episodes), problem.delay)
    alone = optimised(problem, problem.open_loop(guess))
    both = best_trajectory(problem, guess, [partial(receding_horizon, WINDOWS[0])])
    assert both.steady_rmse[0] < 0.5 * alone.steady_rmse[0]
    run = rollout(make_policy("backstepping", scenario.vehicle), scenario, episodes)
    assert both.steady_rmse[0] < in_paper_metres(run.measures, scenario).steady_rmse[0]


def test_the_page_agrees_with_its_rows(suite):
    """Artificial rows: half the rival's errors on every vehicle."""
    rng, runs, when = np.random.default_rng(0), [], Recorded("2026-01-01", {"auv_gym": "0"})
    for cell in suite.cells:
        base = rng.uniform(0.01, 0.02, len(cell.episodes)) * unit_of(cell.scenario)
        factors = {"backstepping": 9.0, "nmpc": 1.0, "ekf": 0.5, "clairvoyant": 0.1}
        runs += [
            Run(policy, cell.scenario, cell.hash, measures(f * base), recorded=when) for policy, f in factors.items()
        ]
    results = Results(suite, tuple(runs))
    pairs = vehicles.pairs_of(results)
    assert list(pairs) == ["clairvoyant", "ekf", "nmpc", "backstepping"]
    for speed_range, episodes in (("", 1152), ("cruise", 1024), ("slow", 128)):
        pair = vehicles.pairs_of(results, speed_range)["ekf"]
        assert (pair.error.mean, pair.failed, pair.episodes) == (pytest.approx(0.5), 0, episodes)
    of_ekf = {name: [case["ekf"], case["ekf"]] for name, case in results.cases.items()}
    seeds = {
        "any": SeedRuns(of_ekf),
        "part": SeedRuns({name: own for name, own in of_ekf.items() if name.startswith("cruise")}),
    }
    half = "0.50 (0.50 ... 0.50)"
    (row,) = vehicles.seed_rows(pairs["nmpc"].policy, seeds)
    assert row == ["`any`", "2", half, half, "0 of 2304 (<= 0.13 %)"]


def test_failures_in_which_another_controller_succeeds():
    """Errors of three episodes; the error cap is 2 m."""
    errors = {"helm-any": (3, 3, 1), "nmpc": (3, 1, 1), "ekf": (3, 3, 3), "clairvoyant": (0, 0, 0)}
    pairs = {policy: vehicles.Pair({"cruise-storm@otter": measures(row)}, {}) for policy, row in errors.items()}
    assert [vehicles.avoidable_failures(pairs, policy) for policy in ("helm-any", "nmpc", "ekf")] == [1, 0, 2]
