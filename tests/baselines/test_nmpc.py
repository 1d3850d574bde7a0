"""Model predictive control: the optima of CasADi and SciPy, commands within limits, finite for every observation."""

import math
from dataclasses import replace

import casadi
import numpy as np
import pytest
from casadi_solver import CasadiSolver
from hypothesis import given, settings
from hypothesis import strategies as st
from marks import slow_except
from scipy.integrate import solve_ivp
from scipy.optimize import lsq_linear

import baselines
from auv_gym.codegen.kernel import Kernel
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.dynamics import state_rates
from auv_gym.physics.namespaces import ARRAYS
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.presets import as_scenario as preset
from auv_gym.scenarios.vehicles import vehicle_model, vehicle_names
from baselines.control.nmpc.controller import ENDS, PREVIEW, paces, shift_matrix, targets
from baselines.control.nmpc.gauss_newton import (
    after_step,
    bounded_minimum,
    gauss_newton_step,
    optimised_plan,
    stage_jacobian,
)
from baselines.control.nmpc.problem import (
    COMMAND_SIZE,
    STAGE_ROWS,
    STATE_ROWS,
    CostWeights,
    Horizon,
    OptimalControl,
    Stage,
    next_state,
)
from baselines.evaluation.cells import drawn
from baselines.evaluation.rollout import rollout

DRAGGY = Vehicle(m11=215.0, m22=265.0, m33=80.0, d11=70.0, d22=100.0, d33=50.0, X_uu=30.0, Y_vv=80.0, N_rr=20.0)
WEIGHTS = CostWeights(huber=0.3, surge=3e-3, yaw=3e-3, sway=0.2, terminal=1.0)
STAGES = 12


def random_problem(rng, n, limits=(250.0, 100.0)):
    """Return states near 1 m/s, and a horizon with a circular arc as the reference, in a current and in waves."""
    motion = rng.normal((0, 0, 0, 1, 0, 0), (0.1, 0.1, 0.05, 0.1, 0.03, 0.03), (n, 6)).T
    start = np.vstack((motion, rng.normal(0, (30.0, 10.0), (n, 2)).T))
    dt = np.tile(rng.uniform(0.15, 0.4, (STAGES, 1)), n)
    angle = rng.uniform(-0.1, 0.1, n) * dt.cumsum(axis=0)
    target = dt.cumsum(axis=0)[:, None] * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    lag = rng.uniform(0.05, 0.6, n)
    gain = 1 - np.exp(-dt / lag)
    current, load = rng.normal(0, 0.1, (2, n)), rng.normal(0, 5, (STAGES, 3, n))
    last = np.tile((np.arange(STAGES) == STAGES - 1.0)[:, None], n)
    rows = Stage(
        dt,
        *target.transpose(1, 0, 2),
        *(np.tile(V, (STAGES, 1)) for V in current),
        *load.transpose(1, 0, 2),
        gain,
        1 - lag / dt * gain,
        last,
        np.ones_like(last),
        np.zeros_like(last),
    )
    return start, Horizon(np.stack(rows, axis=1), np.tile(np.array(limits)[:, None], n))


# The solver.


def stage_slopes(vehicle, state, command, stage, substeps=1):
    """Return the symbolic Jacobian of `next_state`, shape (N, STATES, STATES + COMMANDS)."""

    def equation(state, command, stage):
        rows = stage_jacobian(state, command, Stage(*stage), vehicle.coefficients, substeps)
        return {"slopes": [x for row in rows for x in row]}

    rows = {"state": STATE_ROWS, "command": COMMAND_SIZE, "stage": STAGE_ROWS}
    slopes = Kernel.traced(equation, rows, structural=True, blocked=True)(state=state, command=command, stage=stage)
    return slopes["slopes"].T.reshape(-1, STATE_ROWS, STATE_ROWS + COMMAND_SIZE)


@pytest.mark.parametrize(("vehicle", "substeps"), [(PAPER_VEHICLE, 1), (DRAGGY, 1), (DRAGGY, 3)])
def test_derivatives_are_those_of_casadi(vehicle, substeps):
    rng = np.random.default_rng(0)
    start, horizon = random_problem(rng, 3)
    commands, stage = rng.normal(0, 40, (COMMAND_SIZE, 3)), horizon.stages[3]
    both, stages = casadi.SX.sym("both", STATE_ROWS + COMMAND_SIZE), casadi.SX.sym("stage", STAGE_ROWS)
    state, command = casadi.vertsplit(both)[:STATE_ROWS], casadi.vertsplit(both)[STATE_ROWS:]
    given = state, command, Stage(*casadi.vertsplit(stages)), vehicle.coefficients
    after = casadi.vertcat(*next_state(*given, substeps, casadi))
    slopes = casadi.Function("slopes", [both, stages], [casadi.jacobian(after, both)])
    ours = stage_slopes(vehicle, start, commands, stage, substeps)
    for i in range(3):
        expected = slopes(np.append(start[:, i], commands[:, i]), stage[:, i])
        np.testing.assert_allclose(ours[i], np.array(expected), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("name", ["paper", *vehicle_names()])
def test_the_longest_stage_of_a_hard_turn_is_predicted_as_by_scipy(name):
    vehicle = PAPER_VEHICLE if name == "paper" else vehicle_model(name).in_paper_units.vehicle
    problem, motion = OptimalControl(vehicle, WEIGHTS), np.array((0.0, 0.0, 0.0, vehicle.speed, 0.3, 0.3))
    stage = Stage(0.5, *[0.0] * 10, 1.0, 0.0)._replace(gain=1.0, share=1.0)
    found = next_state([*motion, 0.0, 0.0], (0.0, 0.0), stage, vehicle.all_coefficients, problem.substeps, math)

    def slope(_, z):
        return state_rates(tuple(z), (0.0, 0.0, 0.0), vehicle.all_coefficients)

    expected = solve_ivp(slope, (0.0, 0.5), motion, rtol=1e-10, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(found[:6], expected, atol=0.05)


def test_gauss_newton_step_is_that_of_a_quadratic_program():
    """Without active limits, step and predicted decrease are those of linear least squares."""
    rng = np.random.default_rng(3)
    start, horizon = random_problem(rng, 1, limits=(1e5, 1e5))
    problem = OptimalControl(DRAGGY, WEIGHTS)
    plan = problem.predict(start, rng.normal(0, 40, (STAGES, COMMAND_SIZE, 1)), horizon)
    full = gauss_newton_step(problem, plan, horizon)
    size = STAGES * COMMAND_SIZE
    by_commands, residuals, rows = np.zeros((STATE_ROWS, size)), [], []
    for k in range(STAGES):
        stage = Stage(*horizon.stages[k, :, 0])
        choose = np.eye(size)[COMMAND_SIZE * k : COMMAND_SIZE * (k + 1)]
        root = np.sqrt(stage.dt)
        force_error = plan.commands[k, :, 0] - plan.states[k, 6:, 0]
        effort = root * np.diag((WEIGHTS.surge, WEIGHTS.yaw))
        residuals += list(effort @ force_error)
        rows += list(effort @ (choose - by_commands[6:]))
        f = stage_slopes(DRAGGY, plan.states[k], plan.commands[k], horizon.stages[k], problem.substeps)[0]
        by_commands = f[:, :STATE_ROWS] @ by_commands + f[:, STATE_ROWS:] @ choose
        x, y, *_, v, _, _, _ = plan.states[k + 1, :, 0]
        e = np.array((x - stage.target_x, y - stage.target_y))
        weight = np.sqrt((stage.dt + stage.last * WEIGHTS.terminal) / np.sqrt(1 + e @ e / WEIGHTS.huber**2))
        residuals += [*(weight * e), root * WEIGHTS.sway * v]
        rows += [*(weight * by_commands[:2]), root * WEIGHTS.sway * by_commands[4]]
    A, b = np.array(rows), np.array(residuals)
    best, *_ = np.linalg.lstsq(A, -b, rcond=None)
    changed = np.zeros(STATE_ROWS)
    for k in range(STAGES):  # the feedback acts on the state that results from the earlier changes
        feedback = full.feedback[k, :, 0].reshape(COMMAND_SIZE, STATE_ROWS)
        change = full.step[k, :, 0] + feedback @ changed
        np.testing.assert_allclose(change, best[COMMAND_SIZE * k : COMMAND_SIZE * (k + 1)], rtol=1e-6, atol=1e-6)
        f = stage_slopes(DRAGGY, plan.states[k], plan.commands[k], horizon.stages[k], problem.substeps)[0]
        changed = f[:, :STATE_ROWS] @ changed + f[:, STATE_ROWS:] @ change
    np.testing.assert_allclose(full.decrease[0], b @ b - np.sum((A @ best + b) ** 2), rtol=1e-8)


@given(seed=st.integers(0, 2**31 - 1))
@settings(max_examples=50, deadline=None)
def test_minimum_within_bounds_is_that_of_scipy(seed):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(4, 2, 2)) + 2 * np.eye(2)
    H, g = root.transpose(0, 2, 1) @ root, rng.normal(0, 3, (4, 2))
    low, high = -rng.uniform(0.1, 2, (4, 2)), rng.uniform(0.1, 2, (4, 2))
    c, free = bounded_minimum((H[:, 0, 0], H[:, 0, 1], H[:, 1, 1]), g.T, low.T, high.T, ARRAYS)
    c, free = np.array(c).T, np.array(free).T
    for i in range(4):
        expected = lsq_linear(root[i], -np.linalg.solve(root[i].T, g[i]), (low[i], high[i]), tol=1e-14).x
        np.testing.assert_allclose(c[i], expected, atol=1e-6)
    np.testing.assert_array_equal(free, (c > low) & (c < high))


@pytest.mark.parametrize("limits", [(250.0, 100.0), (60.0, 15.0)])
def test_optimum_is_that_of_casadi(limits):
    rng = np.random.default_rng(1)
    start, horizon = random_problem(rng, 6, limits)
    problem = OptimalControl(PAPER_VEHICLE, WEIGHTS)
    ours = guess = problem.predict(start, np.zeros((STAGES, COMMAND_SIZE, 6)), horizon)
    for _ in range(60):
        ours, _ = after_step(problem, ours, horizon)
    theirs = CasadiSolver(problem, STAGES)(guess, horizon, np.full(6, 100))
    assert (theirs.cost < 0.9 * guess.cost).all()
    np.testing.assert_allclose(ours.cost, theirs.cost, rtol=1e-5)
    np.testing.assert_allclose(ours.commands[:3], theirs.commands[:3], atol=0.02 * limits[1])
    assert (np.abs(ours.commands) <= horizon.limits).all()
    if limits[1] == 15.0:
        assert (np.abs(ours.commands) == horizon.limits).any()


def test_steps_lower_the_cost():
    rng = np.random.default_rng(2)
    start, horizon = random_problem(rng, 8)
    problem = OptimalControl(PAPER_VEHICLE, WEIGHTS)
    plan = problem.predict(start, rng.normal(0, 40, (STAGES, COMMAND_SIZE, 8)), horizon)
    better = optimised_plan(problem, plan, horizon, np.arange(8))  # no step of the first vehicle
    np.testing.assert_array_equal(better.commands[..., 0], plan.commands[..., 0])
    assert (better.cost[1:] < plan.cost[1:]).all()


def test_shifted_commands_are_the_means_one_period_later():
    ends = np.array((1.0, 2.0, 4.0, 7.0))
    commands = np.array((3.0, -1.0, 5.0, 2.0))
    fine = np.repeat(commands, (100, 100, 200, 500))  # the last command continues
    expected = [fine[a + 100 : b + 100].mean() for a, b in ((0, 100), (100, 200), (200, 400), (400, 700))]
    np.testing.assert_allclose(shift_matrix(ends) @ commands, expected)


# The controller.


def observations(n, scenario="cruise-storm"):
    return UnderactuatedAUVTrackVectorEnv(n, scenario, preview=PREVIEW).reset(seed=7)[0]


def test_the_horizon_has_the_same_length_at_a_shorter_control_period():
    dt, speed, turn_rate = np.array((0.2, 0.1, 0.05, 0.02)), 1.0, 0.12
    angle = turn_rate * dt[:, None] * np.array(PREVIEW)
    extra = speed / turn_rate * np.stack((np.sin(angle), 1 - np.cos(angle)), axis=2).reshape(len(dt), -1)
    pace = paces(dt)
    np.testing.assert_array_equal(pace, (1, 1, 2, 5))
    angle = turn_rate * dt * pace * np.array(ENDS)[:, None]
    expected = speed / turn_rate * np.stack((np.sin(angle), 1 - np.cos(angle)), axis=1)
    np.testing.assert_allclose(targets(extra, pace), expected, atol=1e-6)


@pytest.mark.parametrize("name", slow_except(["nmpc"], ["nmpc", "nmpc-adverse"]))
def test_a_shorter_control_period_does_not_increase_the_error(name):
    coarse = replace(preset("cruise-storm"), steps=200)
    fine = replace(coarse, control_dt=0.02, steps=1000)
    usual, short = (
        rollout(baselines.make_policy(name), s, drawn(s, 3, 5).episodes).measures.steady_rmse.mean()
        for s in (coarse, fine)
    )
    assert short < usual


def test_the_tracking_law_acts_if_the_prediction_diverges():
    policy, law = baselines.make_policy("nmpc"), baselines.make_policy("backstepping-normalised")
    rows = observations(2)
    rows[0, 3:6] = np.array((16.0, 16.0, 8.0)) * (2, 2, 8)
    action, _ = policy.predict(rows)
    np.testing.assert_array_equal(action[0], law.predict(rows[0])[0])


def test_actions_are_those_with_casadi():
    """After the first steps, in which the limited number of Gauss-Newton steps gives other commands."""
    env = UnderactuatedAUVTrackVectorEnv(2, "cruise-current", preview=PREVIEW)
    policies = [baselines.make_policy("nmpc") for _ in range(2)]
    for law in (policies[1].controller.slow, policies[1].controller.cruise):
        law.solve = CasadiSolver(law.problem, len(ENDS))
    observation, _ = env.reset(seed=5, options={"initial_error": np.zeros(3)})
    memories, first = [None, None], np.ones(2, dtype=bool)
    for _ in range(100):
        actions = []
        for i, policy in enumerate(policies):
            action, memories[i] = policy.predict(observation, memories[i], first)
            actions.append(action)
        observation, *_ = env.step(actions[0])
        first = np.zeros_like(first)
    np.testing.assert_allclose(actions[0], actions[1], atol=0.02)
