"""The full-information optimum: SciPy finds no better commands, and the environment has the predicted error."""

from dataclasses import replace

import numpy as np
import pytest
from marks import slow_except
from scipy.optimize import minimize

import research  # noqa: F401, it adds the sealed suites
from auv_gym.physics.namespaces import FLOATS
from auv_gym.scenarios.mixtures import slewing
from auv_gym.scenarios.presets import CASES, PRESETS
from auv_gym.task.simulation import parameter_row, start, step
from baselines import make_policy
from baselines.control.privileged.optimum import arriving, oracle_actions
from baselines.control.privileged.problem import EFFORT_WEIGHT, TRANSIENT_WEIGHT, Problem
from baselines.control.privileged.solver import TOLERANCE, best_trajectory
from baselines.control.privileged.truth import Truth
from baselines.evaluation.cells import drawn
from baselines.evaluation.rollout import rollout
from baselines.evaluation.suites import load_suite


def optimum(scenario, episodes):
    problem = Problem.of(scenario, episodes)
    return problem, best_trajectory(problem, arriving(oracle_actions(scenario, episodes), problem.delay))


@pytest.mark.parametrize("speed_range", ["slow", "cruise"])
@pytest.mark.parametrize("case", slow_except(["storm"], CASES))
def test_at_least_as_good_as_the_oracle_in_every_episode(speed_range, case):
    scenario = PRESETS[f"{speed_range}-{case}"]
    episodes = drawn(scenario, 12, 100).episodes
    best, oracle = (rollout(make_policy(p), scenario, episodes, 10.0).measures for p in ("clairvoyant", "oracle"))
    assert not best.failed.any()
    assert (best.steady_rmse < oracle.steady_rmse + TOLERANCE).all()
    assert best.steady_rmse.max() < 0.001


@pytest.mark.parametrize("speed_range", ["slow", "cruise"])
def test_rate_limited_actuators(speed_range):
    """The commands leave the rate limits: the error is small, and smaller than that of predictive control."""
    scenario = slewing(PRESETS[f"{speed_range}-storm"], 2.0)
    episodes = drawn(scenario, 6, 100).episodes
    best, rival = (rollout(make_policy(p), scenario, episodes, 10.0).measures for p in ("clairvoyant", "nmpc-adverse"))
    assert best.steady_rmse.max() < 0.002
    assert (best.steady_rmse < 0.1 * rival.steady_rmse).all()


@pytest.mark.slow
@pytest.mark.parametrize("cell", ["cruise-far-start", "slow-all-at-once"])
def test_the_environment_has_the_predicted_error(cell):
    """With delayed commands, slow and weak actuators, a current that varies in space, and rounded actions."""
    own = next(c for c in load_suite("hard-v1").cells if c.scenario.name == cell)
    policy = make_policy("clairvoyant")
    run = rollout(policy, own.scenario, own.episodes[:6], 10.0)
    np.testing.assert_allclose(run.measures.steady_rmse, policy._trajectory.steady_rmse, rtol=1e-3, atol=TOLERANCE)


@pytest.mark.parametrize(
    ("scenario", "tolerance"),
    [(PRESETS["cruise-storm"], TOLERANCE), (slewing(PRESETS["cruise-storm"], 2.0), 1e-4)],  # rate limits are not smooth
)
def test_scipy_finds_no_better_commands(scenario, tolerance):
    """In a short episode, simulated in plain Python, from the optimum and from other initial commands."""
    scenario = replace(scenario, steps=24)
    episodes = drawn(scenario, 1, 3).episodes
    problem, trajectory = optimum(scenario, episodes)
    truth = Truth.of(scenario, episodes)
    rows = [float(np.ravel(row)[0]) for row in parameter_row(truth.parameters)]
    p, samples = scenario.parts.parameters(rows), truth.samples[..., 0].tolist()
    initial, _ = start(tuple(problem.begun[:6, 0].tolist()), samples[0], p, FLOATS)
    weight = problem.weight[:, 0, 0]

    def cost(flat):
        plant, total = initial, 0.0
        for w, action, sample in zip(weight, flat.reshape(-1, 2).tolist(), samples[1:], strict=True):
            plant, _, (_, _, squared, _) = step(plant, action, sample, p, FLOATS)
            total += w * squared + EFFORT_WEIGHT * (action[0] ** 2 + action[1] ** 2)
        return total

    mine = trajectory.commands[..., 0].ravel()
    assert cost(mine) == pytest.approx(trajectory.cost[0], rel=1e-9)
    assert weight.sum() == pytest.approx(1.0 + TRANSIENT_WEIGHT * 8 / 24)
    other = np.clip(mine + 0.3 * np.random.default_rng(0).standard_normal(len(mine)), -1, 1)
    for guess in (mine, other):
        theirs = minimize(cost, guess, method="L-BFGS-B", bounds=[(-1, 1)] * len(mine), options={"maxfun": 10_000})
        assert np.sqrt(theirs.fun) > np.sqrt(trajectory.cost[0]) - tolerance


def test_commands_act_after_the_delay():
    actions = np.arange(12.0).reshape(3, 2, 2)
    delayed = arriving(actions, np.array([0, 2]))
    np.testing.assert_array_equal(delayed[..., 0], actions[..., 0])
    np.testing.assert_array_equal(delayed[..., 1], [[0, 0], [0, 0], actions[0, :, 1]])
