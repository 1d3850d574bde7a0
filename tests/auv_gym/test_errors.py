"""Tracking errors: (17)-(20) as the difference of two vehicles, angles and rotations."""

import math
from functools import partial

import numpy as np
import pytest
import sympy as sp
import torch
from hypothesis import given
from hypothesis import strategies as st

from auv_gym.physics.dynamics import state_rates
from auv_gym.physics.errors import to_body, to_world, tracking_errors
from auv_gym.physics.namespaces import ARRAYS, tensors, wrap_angle

angles = st.floats(-1e3, 1e3)
lengths = st.floats(-1e3, 1e3)


def test_the_difference_of_two_vehicles_is_the_papers_error_dynamics():
    _, _, psi_e, u_e, v_e, r_e = e = sp.symbols("x_e y_e psi_e u_e v_e r_e", real=True)
    _, _, psi_R, u_R, v_R, r_R = R = sp.symbols("x_R y_R psi_R u_R v_R r_R", real=True)
    F_uR, F_rR, F_ue, F_re = sp.symbols("F_uR F_rR F_ue F_re", real=True)
    m11, m22, m33, d11, d22, d33 = sp.symbols("m11 m22 m33 d11 d22 d33", positive=True)
    c, s, c_R, s_R = sp.cos(psi_R + psi_e), sp.sin(psi_R + psi_e), sp.cos(psi_R), sp.sin(psi_R)
    paper = (
        c * u_e - s * v_e + (c - c_R) * u_R - (s - s_R) * v_R,  # (17a)
        s * u_e + c * v_e + (s - s_R) * u_R + (c - c_R) * v_R,  # (17b)
        r_e,  # (17c)
        m22 / m11 * (v_e * r_e + v_e * r_R + v_R * r_e) - d11 / m11 * u_e + F_ue / m11,  # (20a)
        -m11 / m22 * (u_e * r_e + u_e * r_R + u_R * r_e) - d22 / m22 * v_e,  # (20b)
        (m11 - m22) / m33 * (u_e * v_e + u_e * v_R + u_R * v_e) - d33 / m33 * r_e + F_re / m33,  # (20c)
    )
    rates = partial(state_rates, coefficients=(m11, m22, m33, d11, d22, d33, *[0] * 7), ns=sp)
    actual = rates([a + b for a, b in zip(R, e, strict=True)], (F_uR + F_ue, 0, F_rR + F_re))
    wanted = rates(R, (F_uR, 0, F_rR))
    assert [sp.expand(p - a + b) for p, a, b in zip(paper, actual, wanted, strict=True)] == [0] * 6


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
