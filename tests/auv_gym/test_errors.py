"""Tracking errors: (17)-(20) compared with the difference of two vehicles, angles and rotations."""

import math

import numpy as np
import pytest
import sympy as sp
import torch
from hypothesis import given
from hypothesis import strategies as st
from matrix_form import matrix_form
from scipy.integrate import solve_ivp

from auv_gym.physics.dynamics import state_rates
from auv_gym.physics.errors import error_rates, to_body, to_world, tracking_errors
from auv_gym.physics.namespaces import ARRAYS, tensors, wrap_angle
from auv_gym.physics.vehicle import PAPER_VEHICLE, Coefficients

angles = st.floats(-1e3, 1e3)
lengths = st.floats(-1e3, 1e3)


def test_error_rates_are_the_difference_of_two_vehicles_symbolically():
    e, R = sp.symbols("x_e y_e psi_e u_e v_e r_e", real=True), sp.symbols("x_R y_R psi_R u_R v_R r_R", real=True)
    F_u, F_r, F_uR, F_rR = sp.symbols("F_u F_r F_uR F_rR", real=True)
    c = Coefficients(*sp.symbols("m11 m22 m33 d11 d22 d33", positive=True), *[0] * 7)
    actual = state_rates(tuple(a + b for a, b in zip(R, e, strict=True)), (F_u, 0, F_r), c, ns=sp)
    wanted = state_rates(R, (F_uR, 0, F_rR), c, ns=sp)
    got = error_rates(e, R, (F_u, F_r), (F_uR, F_rR), c, ns=sp)
    assert [sp.expand(g - a + b) for g, a, b in zip(got, actual, wanted, strict=True)] == [0] * 6


def test_error_rates_integrate_to_the_difference_of_two_integrated_vehicles():
    state, reference = np.array([1.0, 2.0, 0.3, 0.2, -0.1, 0.2]), np.array([0.5, 2.5, -0.4, 0.6, 0.05, -0.1])
    force, reference_force = (60.0, -9.0), (40.0, 5.0)

    def both(t, z):
        mine = matrix_form(z[:6], (force[0], 0, force[1]), PAPER_VEHICLE)
        theirs = matrix_form(z[6:12], (reference_force[0], 0, reference_force[1]), PAPER_VEHICLE)
        errors = error_rates(z[12:], z[6:12], force, reference_force, PAPER_VEHICLE.coefficients)
        return np.concatenate((mine, theirs, errors))

    start = np.concatenate((state, reference, state - reference))
    end = solve_ivp(both, (0, 10), start, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(end[12:], end[:6] - end[6:12], rtol=0, atol=1e-9)


@given(angles)
def test_wrapped_angle_is_the_same_direction_within_half_a_turn(angle):
    wrapped = wrap_angle(angle)
    assert -math.pi <= wrapped <= math.pi
    assert math.remainder(angle - wrapped, 2 * math.pi) == pytest.approx(0, abs=1e-12)
    assert wrap_angle(wrapped) == pytest.approx(wrapped, abs=1e-12)
    assert wrap_angle(np.array([angle]), ARRAYS) == wrapped
    assert wrap_angle(torch.tensor([angle], dtype=torch.float64), tensors()) == wrapped


@pytest.mark.parametrize(
    ("angle", "wrapped"), [(0.0, 0.0), (math.pi, -math.pi), (-math.pi, -math.pi), (4.0, 4 - math.tau)]
)
def test_wrapped_angle_includes_its_lower_bound_only(angle, wrapped):
    assert wrap_angle(angle) == wrapped


@given(lengths, lengths, angles)
def test_rotations_are_inverse_and_turn_counter_clockwise(x, y, psi):
    c, s = math.cos(psi), math.sin(psi)
    assert to_world(*to_body(x, y, c, s), c, s) == pytest.approx((x, y), abs=1e-9)
    turned = complex(*to_world(x, y, c, s))
    assert turned == pytest.approx(complex(x, y) * complex(c, s), abs=1e-9)


@given(st.tuples(*[lengths] * 6), st.tuples(*[lengths] * 6), st.integers(-3, 3))
def test_tracking_errors_are_differences_modulo_whole_turns(state, reference, turns):
    turned = (*state[:2], state[2] + turns * math.tau, *state[3:])
    errors = np.array(tracking_errors(turned, reference))
    difference = np.subtract(state, reference)
    difference[2] = math.remainder(difference[2], math.tau)
    offset = errors - difference
    offset[2] = math.remainder(offset[2], math.tau)
    np.testing.assert_allclose(offset, 0, atol=1e-11)
