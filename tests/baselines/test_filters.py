"""Filters: those with scheduled gains against linear theory, and the equations of the extended Kalman filter."""

import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are, solve_discrete_lyapunov

from auv_gym import decode_observation
from auv_gym.codegen.derivatives import jacobian
from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.codegen.matrices import symmetric, triangle
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.errors import to_world
from auv_gym.physics.namespaces import ARRAYS, FLOATS
from auv_gym.physics.vehicle import PAPER_VEHICLE, Coefficients, Vehicle
from auv_gym.scenarios.presets import PRESETS, TYPICAL_NOISE
from auv_gym.scenarios.vehicles import vehicle_model, vehicle_names
from auv_gym.task.observation import Observation
from baselines.agents import filters
from baselines.agents.filters import (
    ACROSS_MEASURED,
    ALONG_MEASURED,
    BIAS_ROWS,
    BIASED,
    LAGS,
    LEVELS,
    MEMORY_ENTRIES,
    POSITION_LEVELS,
    ROWS,
    SHARED,
    VELOCITY_LEVELS,
)
from baselines.control.backstepping import Backstepping
from baselines.control.linearisation import error_dynamics
from baselines.estimation.filter_equations import measured_update, predicted
from baselines.estimation.sea_model import (
    PLACE,
    STATE_SIZE,
    Estimate,
    measurement,
    transition,
    wave_transition,
)
from research.trainings import filter_gains

KINDS = range(len(LAGS))
SPEEDS = (0.08, 0.12, 0.28, 0.6, 1.1, 1.7)
NAMES = [*(name for name in Estimate._fields if name != "lag"), *BIAS_ROWS]


def tabled(kind, speed, levels=(1.0, 1.0)):
    """Return the gain of the table at a speed and noise levels, without the lag, shape (21, 6), or (23, 6)."""
    own = filters.gains("cruise" if speed > 0.4 else "slow")[kind]
    K, s = np.zeros((len(NAMES) if kind == BIASED else STATE_SIZE - 1, 6)), filters.speed_share(speed)
    p, v = (
        [np.interp(np.log(x), np.log(knots), unit) for unit in np.eye(len(knots))]
        for x, knots in zip(levels, (POSITION_LEVELS, VELOCITY_LEVELS), strict=True)
    )
    basis = np.kron(np.kron(p, v), s ** np.arange(4))
    for part, entries, measured in zip(own, filters.entries_of(kind), (ALONG_MEASURED, ACROSS_MEASURED), strict=True):
        for entry, row in zip(entries, part, strict=True):
            for sensor, coefficients in zip(measured, row, strict=True):
                K[NAMES.index(entry), NAMES.index(sensor)] = coefficients @ basis
    return K


def test_the_table_is_what_its_command_writes():
    kept, made = (json.loads(t) for t in (filters.FILTER_GAINS.read_text(encoding="utf-8"), filter_gains.text()))
    assert kept.keys() == made.keys()
    for speed_range in kept:
        for a, b in zip(kept[speed_range], made[speed_range], strict=True):
            for part in ("along", "across"):
                np.testing.assert_allclose(a[part], b[part], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("speed", [0.2, 1.0])
def test_gains_are_those_of_the_steady_covariance(kind, speed):
    """Prediction and update of a covariance, Joseph's form, until nothing changes any more."""
    A, H, Q, R = filter_gains.problem(speed, kind, (2.0, 0.5))
    P = np.eye(len(A))
    for _ in range(6000):
        P = A @ P @ A.T + Q
        K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        left = np.eye(len(A)) - K @ H
        P = left @ P @ left.T + K @ R @ K.T
    found = np.delete(filter_gains.gain(speed, kind, (2.0, 0.5)), PLACE.lag, axis=0)
    np.testing.assert_allclose(found, K, rtol=1e-3, atol=1e-5 * np.abs(K).max())


def test_the_vehicle_model_is_that_of_the_linearised_equations():
    A, H, dt = filter_gains.model(1.0, 0.24)
    errors, _ = error_dynamics(PAPER_VEHICLE, 1.0, 0.0, 0.0)
    np.testing.assert_allclose(A[:6, :6], expm(errors * dt), atol=2e-6)
    np.testing.assert_allclose(H[:, :6], np.eye(6), atol=1e-9)
    np.testing.assert_allclose(H[3:5, PLACE.V_x : PLACE.V_y + 1], np.eye(2), atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_errors_with_gains_between_speeds_and_levels_are_near_those_of_the_equation(kind):
    """Standard deviations of position and heading; the gains of the table make the errors shrink everywhere."""
    rng = np.random.default_rng(kind)
    for speed in SPEEDS:
        levels = tuple(np.exp(rng.uniform(np.log((0.2, 0.3)), np.log((20.0, 3.0)))).tolist())
        A, H, Q, R = filter_gains.problem(speed, kind, levels)
        exact = np.delete(filter_gains.gain(speed, kind, levels), PLACE.lag, axis=0)
        ratio = spread(A, H, Q, R, tabled(kind, speed, levels)) / spread(A, H, Q, R, exact)
        assert ratio[:3].max() < 1.06


def spread(A, H, Q, R, K):
    """Return the standard deviations of what a filter with a gain predicts; its errors must shrink."""
    F = A @ (np.eye(len(A)) - K @ H)
    radius = max(abs(np.linalg.eigvals(F)))
    assert radius < 1
    return np.sqrt(np.diag(solve_discrete_lyapunov(F, A @ K @ R @ K.T @ A.T + Q)))


@pytest.mark.parametrize("name", vehicle_names())
def test_errors_of_the_gains_for_other_vehicles(name):
    """Errors of position, heading and velocity relative to those of a filter with gains for the vehicle."""
    model = vehicle_model(name).in_paper_units
    worst = np.zeros(6)
    for speed in (0.5, 1.5) if model.slowest else (0.2, 0.5, 1.5):
        drags = dict(zip(("d11", "d22", "d33"), model.drag(speed), strict=True))  # scales of the disturbances
        for kind in KINDS:
            A, H, _, R = filter_gains.problem(speed, kind, vehicle=model.vehicle)
            Q = filter_gains.problem(speed, kind, vehicle=replace(model.vehicle, **drags))[2]
            P = solve_discrete_are(A.T, H.T, Q, R)
            own = np.linalg.solve(H @ P @ H.T + R, H @ P).T
            worst = np.maximum(worst, (spread(A, H, Q, R, tabled(kind, speed)) / spread(A, H, Q, R, own))[:6])
    assert worst[:3].max() < 1.3  # position and heading
    assert worst[[3, 5]].max() < 3.5  # velocities through the water, which nobody measures, and the yaw rate
    assert worst[4] < 2.7


def straight(speed, heading, errors=(0.0,) * 6, action=(0.0, 0.0)):
    """Return an observation on a straight line, with measured errors: e_x, e_y in the body, and the others."""
    storm = filter_gains.storm_at(speed)
    psi = heading + errors[2]
    terms = (*errors, speed, 0.0, 0.0, PAPER_VEHICLE.d11 * speed, 0.0, np.cos(psi), np.sin(psi))
    limits = storm.actuators.F_u_max, storm.actuators.F_r_max
    return Observation(*(np.array([float(x)]) for x in (*terms, *limits, *action, storm.control_dt)))


def seen(memory, kind, name):
    """Return an entry of a filter's estimate from the memory."""
    return float(memory[SHARED + kind * len(MEMORY_ENTRIES) + MEMORY_ENTRIES.index(name)][0])


@pytest.mark.parametrize("heading", [0.0, 2.5])
@pytest.mark.parametrize("kind", [0, BIASED])
def test_small_deviations_follow_the_linear_filter(heading, kind):
    """Along the world's x, and turned: what is a vector in the world turns along."""
    speed, rng = 1.0, np.random.default_rng(0)
    A, H, *_ = filter_gains.problem(speed, kind)
    K, z, memory = tabled(kind, speed, (0.2, 0.3)), np.zeros(len(A)), [np.zeros(1)] * ROWS
    F_u = PAPER_VEHICLE.d11 * speed
    held = F_u / filter_gains.storm_at(speed).actuators.F_u_max
    for k in range(40):
        y = 1e-4 * rng.standard_normal(6)
        _, memory = filters.filter_step(straight(speed, heading, y, (held, 0.0)), speed, memory, ARRAYS)
        if k == 0:
            memory = list(memory)
            for i in KINDS:  # a start from rest is a large deviation
                memory[SHARED + i * len(MEMORY_ENTRIES) + MEMORY_ENTRIES.index("F_u")] = np.array([F_u])
        ahead = A @ z
        z = ahead + K @ (y - H @ ahead) if k else np.concatenate((y, z[6:]))
    c, s = np.cos(heading), np.sin(heading)
    found = {name: seen(memory, kind, name) for name in MEMORY_ENTRIES}
    for a, b in filters.VECTORS:
        found[a], found[b] = c * found[a] + s * found[b], c * found[b] - s * found[a]
    found |= {"psi": found["psi"] - heading, "u": found["u"] - speed, "F_u": found["F_u"] - F_u}
    if kind == BIASED:
        found |= {name: float(memory[SHARED - 2 + i][0]) for i, name in enumerate(BIAS_ROWS)}
    for name, x in found.items():
        assert x == pytest.approx(z[NAMES.index(name)], rel=2e-3, abs=3e-6 * max(1, abs(z).max())), name


def test_a_position_without_a_new_fix_is_ignored():
    speed, dt = 1.0, 0.1
    memory = [np.zeros(1)] * ROWS
    held = []
    for k in range(6):
        stale = -dt * speed if k == 4 else 0.0  # the fix of the period before: the reference has moved on
        output, memory = filters.filter_step(straight(speed, 0.0, (stale, 0, 0, 0, 0, 0)), speed, memory, ARRAYS)
        held.append(bool(output.held[0]))
    assert held == [False, False, False, False, True, False]


def test_velocities_that_do_not_change_are_ignored():
    """After a velocity freezes, the filters predict it: the vehicle still slows down as without thrust."""
    memory, out = [np.zeros(1)] * ROWS, []
    for k in range(40):
        output, memory = filters.filter_step(
            straight(1.0, 0.0, (0, 0, 0, 1e-3 * (-1) ** min(k, 30), 0, 0)), 1.0, memory, ARRAYS
        )
        out.append(bool(output.velocity_held[0]))
    assert out == [False] * 31 + [True] * 9


@cache
def compiled_step():
    """Return the kernel of the filters: it takes a twentieth of the time of arrays."""

    def equation(o, memory):
        o = Observation(*o)
        output, after = filters.filter_step(o, SYMBOLS.hypot(o.u_R, o.v_R), memory, SYMBOLS)
        estimates = [x for z in output.estimates for name, x in z._asdict().items() if name != "lag"]
        return {"estimates": estimates, "bias": output.bias, "levels": output.levels, "after": after}

    return Kernel.traced(equation, {"o": len(Observation._fields), "memory": ROWS}, blocked=True)


def outputs_in(scenario, steps=400, n=6):
    """Return true x, y errors and outputs of the filters while a law steers, for n episodes and some steps."""
    env = UnderactuatedAUVTrackVectorEnv(n, [scenario] * n)
    law, memory, found = Backstepping(), np.zeros((ROWS, n)), []
    observation, _ = env.reset(seed=3)
    for _ in range(steps):
        o = decode_observation(observation.astype(float))
        results = compiled_step()(o=np.array(o), memory=memory)
        memory, estimates = results["after"], results["estimates"].reshape(len(LAGS), -1, n)
        output = SimpleNamespace(estimates=estimates, bias=results["bias"], levels=results["levels"])
        true = env.pose[:, 0] - env.reference.x, env.pose[:, 1] - env.reference.y
        found.append((true, to_world(o.e_x, o.e_y, o.cos_psi, o.sin_psi), output))
        observation, *_ = env.step(law.predict(observation)[0])
    return found


def rms(found, part):
    errors = [np.hypot(*np.subtract(part(measured, output), true)) for true, measured, output in found[200:]]
    return float(np.sqrt(np.square(errors).mean()))


def test_estimates_are_more_accurate_than_noisy_measurements():
    found = outputs_in(PRESETS["slow-noise"])
    seen = rms(found, lambda measured, _: measured)
    rough, calm = (rms(found, lambda _, output, i=i: output.estimates[i][:2]) for i in (0, 1))
    assert calm < 0.25 * seen
    assert calm < rough < 0.7 * seen


@pytest.mark.parametrize("factors", [(0.2, 1.0), (1.0, 3.0), (6.0, 1.0)])
def test_noise_levels_are_those_of_the_sensors(factors):
    for speed_range, unit in LEVELS.items():
        scenario = PRESETS[f"{speed_range}-storm"]
        sensors = replace(TYPICAL_NOISE[speed_range], position=unit[0] * factors[0], velocity=unit[2] * factors[1])
        found = outputs_in(replace(scenario, sensors=sensors))
        levels = np.sqrt([[np.mean(x) for x in output.levels] for *_, output in found[200:]]).mean(axis=0)
        np.testing.assert_allclose(levels[[0, 2]], factors, rtol=0.2)
        assert levels[1] == pytest.approx(1.0, rel=0.2)


def test_noise_with_a_correlation_time_has_a_slow_level():
    storm = PRESETS["cruise-storm"]
    found = outputs_in(replace(storm, sensors=replace(storm.sensors, position=0.3, correlation=2.0)))
    levels = np.sqrt([[np.mean(x) for x in output.levels] for *_, output in found[200:]]).mean(axis=0)
    assert levels[0] < 2.0
    assert levels[3] > 6.0


def test_a_bias_of_the_velocity_is_estimated():
    storm = PRESETS["cruise-storm"]
    found = outputs_in(replace(storm, sensors=replace(storm.sensors, velocity_bias=(0.05, 0.05))))
    bias = np.mean([output.bias for *_, output in found[250:]], axis=(0, 2))
    np.testing.assert_allclose(bias, 0.05, atol=0.006)
    rough, faulty = (rms(found, lambda _, output, i=i: output.estimates[i][:2]) for i in (0, BIASED))
    assert faulty < 0.3 * rough


def test_a_moment_from_outside_has_no_side_force_of_the_rudder():
    """In the model of the filters, as in `dynamics.from_outside`; the moment of the rudder has it."""
    vehicle, still = vehicle_model("lauv").vehicle, np.zeros(STATE_SIZE)
    still[PLACE.u], still[PLACE.lag] = 1.0, 1e-3
    sways = []
    for outside, rudder in ((5.0, 0.0), (0.0, 5.0)):
        z = Estimate(*still)._replace(N=outside, F_r=rudder)
        after = transition(z, (0.0, rudder), (0.0, 0.0), 1e-3, vehicle.all_coefficients, FLOATS)
        sways.append(after.v / 1e-3)
    assert sways[0] == pytest.approx(5.0 * vehicle.eps / vehicle.m33, rel=0.02)
    assert abs(sways[1]) < 0.02 * sways[0]


# The extended Kalman filter: derivatives against CasADi, covariances against matrix algebra.

DRAGGY = Vehicle(m11=215.0, m22=265.0, m33=80.0, d11=70.0, d22=100.0, d33=50.0, X_uu=30.0, Y_vv=80.0, N_rr=20.0)


def random_state(rng, n):
    """Return states of typical magnitude, in the order of `Estimate`."""
    size = np.array([1, 1, 3, 1, 0.3, 0.3, 90, 40, 0.3, 0.3, 0.02, 0.02, 20, 20, 8, 0, 20, 20, 20, 20, 8, 8])
    z = rng.standard_normal((STATE_SIZE, n)) * size[:, None]
    z[15] = rng.uniform(0.05, 0.8, n)
    return z


TRIANGLE = np.tril_indices(STATE_SIZE)


def random_covariance(rng, n):
    """Return well-conditioned covariances in the units of a state, shape (n, SIZE, SIZE)."""
    root = rng.normal(size=(n, STATE_SIZE, STATE_SIZE)) + 3 * np.eye(STATE_SIZE)
    size = np.abs(random_state(rng, 1))[:, 0] + 0.1
    return root @ root.transpose(0, 2, 1) * size[:, None] * size / 30


def full(rows):
    """Return the matrices (n, SIZE, SIZE) of lower triangles (SIZE (SIZE + 1) / 2, n)."""
    return np.array(symmetric(list(rows))).transpose(2, 0, 1)


def observed(rng, n):
    """Return observations with random values of the terms that `transition` depends on, shape (18, n)."""
    values = dict.fromkeys(Observation._fields, np.zeros(n))
    values |= {"a_u": rng.uniform(-0.5, 0.5, n), "a_r": rng.uniform(-0.5, 0.5, n), "dt": np.linspace(0.05, 0.3, n)}
    return np.array(Observation(**values | {"F_u_max": np.full(n, 400.0), "F_r_max": np.full(n, 200.0)}))


def kernel_jacobians(z, o, vehicle):
    """Return the symbolic Jacobians of `transition` and of `measurement`, (n, ..., SIZE)."""

    def equation(z, o):
        z, o = Estimate(*z), Observation(*o)
        command = o.a_u * o.F_u_max, o.a_r * o.F_r_max
        after = transition(z, command, (0.1, 0.05), o.dt, vehicle.coefficients, SYMBOLS)
        entries = [x for outputs in (after, measurement(z, SYMBOLS)) for row in jacobian(outputs, z) for x in row]
        return {"entries": entries}

    entries = Kernel.traced(equation, {"z": STATE_SIZE, "o": len(o)}, structural=True, blocked=True)(z=z, o=o)[
        "entries"
    ]
    entries = entries.T.reshape(z.shape[1], -1, STATE_SIZE)
    return entries[:, :STATE_SIZE], entries[:, STATE_SIZE:]


def moved(z, o, vehicle):
    o = Observation(*o)
    command = o.a_u * o.F_u_max, o.a_r * o.F_r_max
    return np.array(transition(Estimate(*z), command, (0.1, 0.05), o.dt, vehicle.coefficients, ARRAYS))


@pytest.mark.parametrize(("vehicle", "lag"), [(PAPER_VEHICLE, 2e-3), (DRAGGY, None)])
def test_jacobians_are_those_of_casadi(vehicle, lag):
    casadi = pytest.importorskip("casadi")
    rng = np.random.default_rng(2)
    z, o = random_state(rng, 3), observed(rng, 3)
    z[15] = lag or z[15]
    x, terms = casadi.SX.sym("x", STATE_SIZE), casadi.SX.sym("o", len(o))
    state, observation = Estimate(*casadi.vertsplit(x)), Observation(*casadi.vertsplit(terms))
    ns = SimpleNamespace(sin=casadi.sin, cos=casadi.cos, exp=casadi.exp, clip=lambda x, low, high: x)
    command = observation.a_u * observation.F_u_max, observation.a_r * observation.F_r_max
    after = casadi.vertcat(*transition(state, command, (0.1, 0.05), observation.dt, vehicle.coefficients, ns))
    measured = casadi.vertcat(*measurement(state, ns))
    slopes = casadi.Function("slopes", [x, terms], [casadi.jacobian(after, x), casadi.jacobian(measured, x)])
    for i, jacobians in enumerate(zip(*kernel_jacobians(z, o, vehicle), strict=True)):
        for mine, theirs in zip(jacobians, slopes(z[:, i], o[:, i]), strict=True):
            np.testing.assert_allclose(mine, np.array(theirs), rtol=1e-10, atol=1e-12)


def test_covariance_is_propagated_by_the_jacobian():
    rng = np.random.default_rng(3)
    z, o, P = random_state(rng, 3), observed(rng, 3), random_covariance(rng, 3)

    def equation(z, o, P):
        z, P = predicted(z, symmetric(P), [], (0.1, 0.05), Observation(*o), Coefficients(*DRAGGY.coefficients))
        return {"z": z, "P": triangle(P)}

    rows = {"z": STATE_SIZE, "o": len(o), "P": len(TRIANGLE[0])}
    after = Kernel.traced(equation, rows, structural=True, blocked=True)(z=z, o=o, P=P[:, TRIANGLE[0], TRIANGLE[1]].T)
    F, _ = kernel_jacobians(z, o, DRAGGY)
    np.testing.assert_allclose(full(after["P"]), F @ P @ F.transpose(0, 2, 1), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(after["z"], moved(z, o, DRAGGY), rtol=1e-12, atol=1e-12)


def test_sequential_updates_equal_the_joint_update():
    rng = np.random.default_rng(4)
    z, P = random_state(rng, 3), random_covariance(rng, 3)
    innovation, noise = rng.normal(0, 0.1, (6, 3)), rng.uniform(1e-4, 1e-1, (6, 3))

    def equation(z, P, innovation, noise):
        z, P, _ = measured_update(z, symmetric(P), innovation, noise, False)
        return {"z": z, "P": triangle(P)}

    rows = {"z": STATE_SIZE, "P": len(TRIANGLE[0]), "innovation": 6, "noise": 6}
    kernel = Kernel.traced(equation, rows, structural=True, blocked=True)
    after = kernel(z=z, P=P[:, TRIANGLE[0], TRIANGLE[1]].T, innovation=innovation, noise=noise)
    _, H = kernel_jacobians(z, observed(rng, 3), PAPER_VEHICLE)
    gain = P @ H.transpose(0, 2, 1) @ np.linalg.inv(H @ P @ H.transpose(0, 2, 1) + noise.T[:, :, None] * np.eye(6))
    expected = z + np.einsum("nij,jn->in", gain, innovation)
    expected[15] = np.clip(expected[15], 1e-3, 2.0)
    np.testing.assert_allclose(after["z"], expected, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(full(after["P"]), P - gain @ H @ P, rtol=1e-6, atol=1e-8)


def test_wave_oscillator():
    A, twice = (np.array(wave_transition(dt, FLOATS)) for dt in (0.3, 0.6))
    np.testing.assert_allclose(A @ A, twice, atol=1e-14)
    covariance = np.zeros((2, 2))
    for _ in range(400):
        covariance = A @ covariance @ A.T + np.eye(2) - A @ A.T
    np.testing.assert_allclose(covariance, np.eye(2), atol=1e-6)
