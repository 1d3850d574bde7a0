"""Equations of the filter: derivatives against complex steps and CasADi, covariances against matrix algebra."""

from types import SimpleNamespace

import numpy as np
import pytest

from auv_gym.codegen.derivatives import jacobian
from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.codegen.matrices import symmetric, triangle
from auv_gym.physics.actuators import Response
from auv_gym.physics.namespaces import ARRAYS, FLOATS
from auv_gym.physics.vehicle import PAPER_VEHICLE, Coefficients, Vehicle
from auv_gym.task.observation import Observation
from baselines.estimation.filter_equations import measured_update, predicted
from baselines.estimation.sea_model import STATE_SIZE, Estimate, lag_response, measurement, transition, wave_transition

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
    P = np.zeros((rows.shape[1], STATE_SIZE, STATE_SIZE))
    P[:, TRIANGLE[0], TRIANGLE[1]] = rows.T
    P[:, TRIANGLE[1], TRIANGLE[0]] = rows.T
    return P


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


@pytest.mark.parametrize("lag", [None, 2e-3])
def test_jacobians_are_complex_step_derivatives(lag):
    rng = np.random.default_rng(0)
    z, o = random_state(rng, 5), observed(rng, 5)
    if lag is not None:
        z[15] = lag
    F, H = kernel_jacobians(z, o, PAPER_VEHICLE)
    for j in range(STATE_SIZE):
        shifted = z.astype(complex)
        shifted[j] += 1e-30j
        np.testing.assert_allclose(F[:, :, j].T, moved(shifted, o, PAPER_VEHICLE).imag / 1e-30, rtol=1e-10, atol=1e-12)
        exact = np.array(measurement(Estimate(*shifted), ARRAYS)).imag / 1e-30
        np.testing.assert_allclose(H[:, :, j].T, exact, atol=1e-12)


def test_jacobian_is_that_of_casadi():
    casadi = pytest.importorskip("casadi")
    rng = np.random.default_rng(2)
    z, o = random_state(rng, 3), observed(rng, 3)
    x, terms = casadi.SX.sym("x", STATE_SIZE), casadi.SX.sym("o", len(o))
    own, observation = Estimate(*casadi.vertsplit(x)), Observation(*casadi.vertsplit(terms))
    ns = SimpleNamespace(sin=casadi.sin, cos=casadi.cos, exp=casadi.exp, clip=lambda x, low, high: x)
    command = observation.a_u * observation.F_u_max, observation.a_r * observation.F_r_max
    after = casadi.vertcat(*transition(own, command, (0.1, 0.05), observation.dt, DRAGGY.coefficients, ns))
    slopes = casadi.Function("slopes", [x, terms], [casadi.jacobian(after, x)])
    F, _ = kernel_jacobians(z, o, DRAGGY)
    for i in range(3):
        np.testing.assert_allclose(F[i], np.array(slopes(z[:, i], o[:, i])), rtol=1e-10, atol=1e-12)


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


def test_response_of_rows_is_that_of_each_lag():
    lags, dt = np.array([1e-3, 0.1, 0.6]), np.array([0.1, 0.1, 0.2])
    rows = lag_response(lags, dt, ARRAYS)
    for i in range(3):
        one = Response.of(lags[i], np.inf, np.inf, dt[i])
        assert (rows.gain[i], rows.mean[i]) == pytest.approx((one.gain, one.mean))


def test_wave_oscillator():
    A, twice = (np.array(wave_transition(dt, FLOATS)) for dt in (0.3, 0.6))
    np.testing.assert_allclose(A @ A, twice, atol=1e-14)
    covariance = np.zeros((2, 2))
    for _ in range(400):
        covariance = A @ covariance @ A.T + np.eye(2) - A @ A.T
    np.testing.assert_allclose(covariance, np.eye(2), atol=1e-6)
