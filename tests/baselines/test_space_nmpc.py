"""The filter in space against differences, a joint update and true disturbances; predictive control against SciPy."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear, minimize

import baselines
from auv_gym.codegen.kernel import Kernel
from auv_gym.codegen.matrices import solution, symmetric, triangle
from auv_gym.envs.space import UnderactuatedAUVTrack3DVectorEnv
from auv_gym.physics.namespaces import ARRAYS, FLOATS, wrap_angle
from auv_gym.planning.paths import Circle
from auv_gym.planning.paths.space import Climb, WithHeight
from auv_gym.planning.reserves import ThroughWater
from auv_gym.planning.space import plan
from auv_gym.scenarios.presets import SPACE_PRESETS, TYPICAL_NOISE
from auv_gym.task.space import SPACE, Observation
from baselines.control.nmpc.controller import NMPC_GAINS
from baselines.control.nmpc.gauss_newton import after_step, bounded_minimum_of_three, stage_jacobian
from baselines.control.nmpc.problem import CostWeights, Horizon, OptimalControl, next_state
from baselines.estimation.filter_equations import Belief, measured_update, predicted
from baselines.estimation.kalman import ExtendedKalmanFilter, tuning_of
from baselines.estimation.sea_model import Estimate, measurement, transition
from baselines.evaluation.cells import drawn
from baselines.evaluation.rollout import rollout
from baselines.gains.loading import load_gains
from baselines.space.ekf import PLAN_ROWS, plan_in_water
from baselines.space.kalman import SPACE_FILTER, SPACE_SEA, SpaceEstimate, reference_motion
from baselines.space.nmpc import SPACE_SYSTEM, SpaceStage

SIZE, SENSORS, STATES, COMMANDS = SPACE_SEA.size, SPACE_SEA.motion.stop, SPACE_SYSTEM.states, SPACE_SYSTEM.commands
VEHICLE = SPACE_PRESETS["space-storm"].known
ROW = VEHICLE.all_coefficients
STEP = (0.1, 0.05, -0.02)
WEIGHTS = CostWeights(huber=0.3, surge=3e-3, yaw=3e-3, sway=0.2, terminal=1.0)


def random_state(rng):
    """Return a state of the filter near 1 m/s."""
    z = np.array(SpaceEstimate(*rng.normal(0, 0.1, SIZE))._replace(u=1.0, lag=0.3))
    z[SPACE_SEA.force], z[SPACE_SEA.bias], z[SPACE_SEA.waves] = 20.0, rng.normal(0, 5, 5), rng.normal(0, 5, 10)
    return z


def observed(**values):
    """Return a decoded observation of one vehicle with these terms, zeros otherwise."""
    limits = {"dt": 0.1, "F_u_max": 400.0, "F_q_max": 200.0, "F_r_max": 200.0}
    return np.array(Observation(**dict.fromkeys(Observation._fields, 0.0) | limits | values))


def differences(f, x):
    """Return the Jacobian of a function by central differences."""
    steps = 1e-5 * np.maximum(np.abs(x), 1.0)
    return np.array([(f(x + d) - f(x - d)) / (2 * d.max()) for d in np.diag(steps)]).T


def computed(equation, **arrays):
    """Return the results of an equation on symbols for these numbers."""
    kernel = Kernel.traced(equation, {name: len(x) for name, x in arrays.items()}, structural=True, blocked=True)
    return {name: x[:, 0] for name, x in kernel(**{name: x[:, None] for name, x in arrays.items()}).items()}


def test_prediction_and_update_are_those_of_the_textbook():
    """P = F P F^T with F by differences, then K = P H^T (H P H^T + R)^-1 for all measurements at once."""
    rng = np.random.default_rng(0)
    z, root = random_state(rng), rng.normal(0, 0.1, (SIZE, SIZE)) + np.eye(SIZE)
    P, o = root @ root.T, observed(a_u=0.1, a_q=-0.1, a_r=0.2)
    innovation, noise = rng.normal(0, 0.01, SENSORS), rng.uniform(0.01, 0.1, SENSORS)

    def prediction(z, P, o):
        z, P = predicted(z, symmetric(P), [], STEP, Observation(*o), ROW, SPACE_SEA)
        return {"after": z, "smaller": triangle(P)}

    def update(z, P, innovation, noise):
        z, P, _ = measured_update(z, symmetric(P), innovation, noise, z[0] > 1e9, SPACE_FILTER)
        return {"after": z, "smaller": triangle(P)}

    def moved(x):
        return np.array(transition(SpaceEstimate(*x), (40.0, -20.0, 40.0), STEP, 0.1, ROW, ARRAYS, SPACE_SEA))

    def agree(found, state, covariance):
        np.testing.assert_allclose(found["after"], state, rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(np.array(symmetric(found["smaller"])), covariance, rtol=1e-5, atol=1e-5)

    F = differences(moved, z)
    before, after = F @ P @ F.T, moved(z)
    agree(computed(prediction, z=z, P=np.array(triangle(P)), o=o), after, before)
    H = differences(lambda x: np.array(measurement(SpaceEstimate(*x), ARRAYS, SPACE_SEA)), after)
    K = before @ H.T @ np.linalg.inv(H @ before @ H.T + np.diag(noise))
    found = computed(update, z=after, P=np.array(triangle(before)), innovation=innovation, noise=noise)
    agree(found, after + K @ innovation, before - K @ H @ before)


def test_level_motion_is_predicted_as_in_the_plane():
    z = SpaceEstimate(*random_state(np.random.default_rng(1)))
    vertical = [name for name in z._fields if name[0] in "ZM" or "_z" in name]
    z = z._replace(**dict.fromkeys((*vertical, "theta", "w", "q", "F_q"), 0.0))
    level = Estimate(**{name: getattr(z, name) for name in Estimate._fields})
    flat = transition(level, (40.0, 30.0), STEP[:2], 0.1, VEHICLE.horizontal.coefficients, FLOATS)
    found = transition(z, (40.0, 0.0, 30.0), STEP, 0.1, VEHICLE.acting, FLOATS, SPACE_SEA)
    np.testing.assert_allclose([getattr(found, name) for name in Estimate._fields], flat, rtol=1e-12, atol=1e-14)


def test_motion_of_the_reference_is_that_of_the_path():
    """From the errors of any measured attitude."""
    path, times = WithHeight(Circle(1.0, 0.15), Climb(0.2), -20.0), 0.1 * np.arange(50)
    reference = plan(path, VEHICLE, times)
    _, _, _, theta, psi, *others = reference.table[30].tolist()
    measured = (0.3, 0.1, 0.2, theta + 0.2, psi - 0.5, *others[:5])
    errors = SPACE.errors(measured, reference.table[30, :10].tolist(), FLOATS)
    terms = SPACE.terms(errors, measured, reference.table[30].tolist(), (1.0,) * 3, (0.0,) * 3, 0.1, FLOATS)
    found = reference_motion(Observation(*terms), ROW, FLOATS)
    np.testing.assert_allclose(found, path.derivatives(times[30:31])[1:3].ravel(), atol=2e-4)


def filtered(scenario, n, steps):
    """Return the environment, and in its second half errors of position and current with the memory of the filter."""
    env = UnderactuatedAUVTrack3DVectorEnv(n, scenario)
    policy, memory, first = baselines.make_policy("los-pid", scenario.known), None, np.ones(n, dtype=bool)
    kalman = ExtendedKalmanFilter(scenario.known, tuning_of(load_gains("nmpc", "space", NMPC_GAINS)), SPACE_FILTER)
    observation, beliefs, rows = env.reset(seed=0)[0], kalman.start(n), []
    for k in range(steps):
        beliefs, z = kalman.update(beliefs, np.array(SPACE.layout.named(SPACE.layout.terms_of(observation))))
        if k > steps // 2 and k % 5 == 0:
            position = env.state[:, :3].T - np.array(env.reference[:3])
            belief = Belief.of(beliefs[0].T, False, SPACE_FILTER)
            rows.append((position - z[:3], env.current.T - z[SPACE_SEA.current], belief))
        action, memory = policy.predict(observation, memory, first)
        observation, *_ = env.step(action)
        first[:] = False
    return env, rows


def test_filter_estimates_the_current_and_knows_its_error():
    storm = SPACE_PRESETS["space-storm"]
    scenario = replace(SPACE_PRESETS["space-current"], sensors=TYPICAL_NOISE["cruise"], steps=400)
    env, rows = filtered(scenario, 24, 400)
    error = np.mean([np.linalg.norm(current, axis=0) for _, current, _ in rows])
    assert error < 0.5 * np.linalg.norm(env.current, axis=1).mean()
    _, rows = filtered(replace(storm, steps=300), 24, 300)
    squares = []
    for position, _, belief in rows:
        P = np.array(symmetric(list(belief.covariance))).transpose(2, 0, 1)
        squares.append(np.einsum("in,nij,jn->n", position, np.linalg.inv(P[:, :3, :3]), position))
        assert np.linalg.eigvalsh(P)[:, 0].min() > 0
    assert 2 < np.median(squares) < 5  # 2.4 for a normal distribution of three variables


def test_plan_in_water_is_the_planners():
    """For the path less a steady current, from the terms of the observation."""
    level, current, dt = Circle(1.0, 0.1), np.array((0.2, -0.1, 0.05)), 0.1
    times = dt * np.arange(300)
    ground = plan(WithHeight(level, Climb(0.2), -40.0), VEHICLE, times).table
    water = plan(WithHeight(ThroughWater(level, tuple(current[:2])), Climb(0.15), -40.0), VEHICLE, times).table
    memory, still, found = np.zeros((PLAN_ROWS, 1)), np.zeros(1), []
    for row in ground:
        errors = SPACE.errors(row[:10], row[:10], ARRAYS)
        terms = SPACE.terms(errors, row[:10], row, (1.0,) * 3, (0.0,) * 3, dt, ARRAYS)
        o = Observation(*(np.atleast_1d(np.float64(x)) for x in terms))
        flow, attitude = (current[:, None], np.zeros((3, 1))), (row[3:4], row[4:5])
        memory, reference = plan_in_water(memory, o, flow, (still, still), attitude, VEHICLE)
        found.append(reference[:, 0])
    difference = np.array(found)[100:] - water[100:, 3:]
    difference[:, 1] = wrap_angle(difference[:, 1], ARRAYS)
    assert (abs(difference[:, :7]) < 2e-3).all()
    assert (abs(difference[:, 7:]) < (0.2, 0.5, 0.5)).all()


# The optimiser.


def test_minimum_in_a_box_of_three_is_that_of_scipy():
    rng = np.random.default_rng(6)
    for _ in range(40):
        root, g = rng.normal(size=(3, 3)) + 2 * np.eye(3), rng.normal(0, 4, 3)
        low, high, H = -rng.uniform(0.1, 2, 3), rng.uniform(0.1, 2, 3), root.T @ root
        c, free = bounded_minimum_of_three(H.tolist(), g, low, high, ARRAYS)
        expected = lsq_linear(root, -np.linalg.solve(root.T, g), (low, high), tol=1e-14).x
        np.testing.assert_allclose(np.array(c, dtype=float), expected, atol=1e-6)
        np.testing.assert_array_equal(free, (np.array(c) > low) & (np.array(c) < high))
        np.testing.assert_allclose(solution(H.tolist(), root.tolist()), np.linalg.solve(H, root), rtol=1e-8)


def random_problem(rng, stages, n=1):
    """Return states near 1 m/s, and a horizon with a climbing arc as the reference, in a current and in waves."""
    start = np.zeros((STATES, n))
    start[:10] = rng.normal(0, 0.1, (10, n))
    start[SPACE.plant.u] += 1.0
    dt = np.tile(rng.uniform(0.15, 0.4, (stages, 1)), n)
    far, turn = dt.cumsum(axis=0), rng.uniform(-0.1, 0.1, n)
    target = np.stack((far * np.cos(turn * far), far * np.sin(turn * far), 0.1 * far), axis=1)
    held, gain = np.tile(rng.normal(0, 0.1, (3, n)), (stages, 1, 1)), 1 - np.exp(-dt / 0.3)
    last = np.tile((np.arange(stages) == stages - 1.0)[:, None], n)
    one, zero, load = np.ones_like(dt), np.zeros_like(dt), rng.normal(0, 5, (stages, 5, n))
    columns = (gain, 1 - 0.3 / dt * gain, last, one, zero, one, zero)
    rows = SpaceStage(dt, *(a[:, i] for a in (target, held, load) for i in range(a.shape[1])), *columns)
    return start, Horizon(np.stack(rows, axis=1), np.tile(np.array((60.0, 12.0, 12.0))[:, None], n))


def test_slopes_of_a_stage_are_differences():
    rng = np.random.default_rng(3)
    start, horizon = random_problem(rng, 3)
    both, stage = np.append(start[:, 0], rng.normal(0, 20, COMMANDS)), horizon.stages[1]

    def equation(state, command, stage):
        rows = stage_jacobian(state, command, SpaceStage(*stage), ROW, 2, SPACE_SYSTEM)
        return {"slopes": [x for row in rows for x in row]}

    slopes = computed(equation, state=both[:STATES], command=both[STATES:], stage=stage[:, 0])["slopes"]
    given = SpaceStage(*stage[:, 0]), ROW, 2, math, SPACE_SYSTEM
    expected = differences(lambda x: np.array(next_state(x[:STATES], x[STATES:], *given)), both)
    np.testing.assert_allclose(slopes.reshape(STATES, -1), expected, atol=1e-7)


def test_steps_lower_the_cost_to_the_optimum_of_scipy():
    rng, stages = np.random.default_rng(1), 4
    start, horizon = random_problem(rng, stages)
    problem = OptimalControl(VEHICLE, WEIGHTS, SPACE_SYSTEM)
    guess = plan_ = problem.predict(start, np.zeros((stages, COMMANDS, 1)), horizon)
    for _ in range(30):
        better, _ = after_step(problem, plan_, horizon)
        assert better.cost <= plan_.cost
        plan_ = better

    def cost(shares):
        commands = shares.reshape(stages, COMMANDS, 1) * horizon.limits
        return problem.predict(start, commands, horizon).cost[0]

    best = minimize(cost, np.zeros(stages * COMMANDS), bounds=[(-1, 1)] * stages * COMMANDS, options={"ftol": 1e-14})
    assert plan_.cost[0] < 0.97 * guess.cost[0]
    assert plan_.cost[0] == pytest.approx(best.fun, rel=1e-4)
    assert (np.abs(plan_.commands) == horizon.limits).any()


@pytest.mark.parametrize(
    ("name", "other", "case", "share"), [("ekf", "backstepping", "current", 0.2), ("nmpc", "los-pid", "storm", 0.7)]
)
def test_estimates_make_the_error_smaller(name, other, case, share):
    scenario = replace(SPACE_PRESETS[f"space-{case}"], steps=300)
    episodes = drawn(scenario, 6, 3).episodes
    mine, theirs = (rollout(baselines.make_policy(p, scenario.known), scenario, episodes) for p in (name, other))
    assert not mine.measures.failed.any()
    assert mine.measures.steady_rmse.mean() < share * theirs.measures.steady_rmse.mean()
