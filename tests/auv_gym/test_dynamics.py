"""Equations of motion: against the matrix form, the paper's symbols, other kinds of number and their own symmetries."""

import math
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
import torch
from hypothesis import given
from hypothesis import strategies as st
from matrix_form import matrix_form
from scipy.integrate import solve_ivp

from auv_gym.physics.dynamics import from_outside, rates, rk4_step, state_rates
from auv_gym.physics.errors import to_body
from auv_gym.physics.vehicle import PAPER_VEHICLE, Coefficients, CrossTerms, Vehicle

ROUGH = Vehicle(215.0, 265.0, 80.0, 70.0, 100.0, 50.0, X_uu=40.0, Y_vv=150.0, N_rr=60.0)
FINNED = replace(ROUGH, Y_uv=60.0, Y_ur=40.0, N_uv=25.0, N_ur=30.0)  # 4 Y_uv N_ur > (Y_ur + N_uv)^2: takes energy
CROSSED = replace(
    FINNED, X_vv=9.0, X_vr=-30.0, X_rr=5.0, Y_rv=70.0, Y_vr=-40.0, Y_rr=20.0, N_vv=25.0, N_rv=-15.0, N_vr=35.0
)
VEHICLES = pytest.mark.parametrize(
    "vehicle", [PAPER_VEHICLE, ROUGH, FINNED, CROSSED], ids=["linear", "quadratic", "lift", "cross-flow"]
)
START, LOAD, CURRENT = (1.0, -2.0, 0.5, 0.8, -0.2, 0.3), (120.0, -15.0, 20.0), (0.2, -0.1)

unit = st.floats(-1.0, 1.0)
states = st.tuples(*[unit.map(lambda q, top=top: top * q) for top in (50, 50, 4, 2, 2, 1)])
loads = st.tuples(*[unit.map(lambda q, top=top: top * q) for top in (400, 100, 200)])


def roll(state, load, vehicle, seconds, dt, current=(0.0, 0.0)):
    for _ in range(round(seconds / dt)):
        state = rk4_step(state, load, vehicle.acting, dt, current)
    return np.array(state)


@given(states, loads)
@VEHICLES
def test_rates_are_those_of_the_matrix_form(vehicle, state, load):
    got = state_rates(state, load, vehicle.acting, CURRENT)
    np.testing.assert_allclose(got, matrix_form(state, load, vehicle, CURRENT), rtol=1e-12, atol=1e-12)


@VEHICLES
def test_rollout_agrees_with_a_tight_integrator_of_the_matrix_form(vehicle):
    exact = solve_ivp(
        lambda t, state: matrix_form(state, LOAD, vehicle, CURRENT),
        (0, 20),
        START,
        method="DOP853",
        rtol=1e-12,
        atol=1e-12,
    )
    np.testing.assert_allclose(roll(START, LOAD, vehicle, 20, 0.01, CURRENT), exact.y[:, -1], rtol=0, atol=1e-9)


@VEHICLES
def test_error_falls_with_the_fourth_power_of_the_step(vehicle):
    exact = roll(START, LOAD, vehicle, 4, 0.005)
    coarse, fine = (np.abs(roll(START, LOAD, vehicle, 4, dt) - exact).max() for dt in (0.1, 0.05))
    assert math.log2(coarse / fine) == pytest.approx(4, abs=0.3)


def test_rates_are_the_papers_equations():
    psi, u, v, r, X, Y, N = sp.symbols("psi u v r F_u Y F_r", real=True)
    m11, m22, m33, d11, d22, d33, *further = c = Coefficients(*sp.symbols(Coefficients._fields, positive=True))
    paper = (
        u * sp.cos(psi) - v * sp.sin(psi),  # (1a)
        u * sp.sin(psi) + v * sp.cos(psi),  # (1b)
        m22 / m11 * v * r - d11 / m11 * u + X / m11,  # (2a)
        -m11 / m22 * u * r - d22 / m22 * v,  # (2b)
        (m11 - m22) / m33 * u * v - d33 / m33 * r + N / m33,  # (2c)
    )
    got = rates(psi, u, v, r, (X, Y, N), c, ns=sp)
    as_in_the_paper = dict.fromkeys([Y, *further], 0)
    assert [sp.simplify(a.subs(as_in_the_paper) - b) for a, b in zip(got, paper, strict=True)] == [0] * 5
    lift = abs(u) * (c.Y_ur * r - c.Y_uv * v), abs(u) * (c.N_uv * v - c.N_ur * r)
    sway, yaw = (Y - c.Y_vv * abs(v) * v + lift[0]) / m22, (-c.N_rr * abs(r) * r + lift[1]) / m33
    beyond = [0, 0, -c.X_uu * abs(u) * u / m11, sway, yaw]
    bare = rates(psi, u, v, r, (X, Y, N), c.without_lift, ns=sp)
    assert [sp.simplify(a.subs(dict.fromkeys(further[3:], 0)) - b) for a, b in zip(got, bare, strict=True)] == [0] * 5
    assert [sp.simplify(a - b - e) for a, b, e in zip(got, paper, beyond, strict=True)] == [0] * 5


def test_cross_flow_is_that_of_fossen():
    psi, u, v, r = sp.symbols("psi u v r", real=True)
    c = Coefficients(*sp.symbols(Coefficients._fields, positive=True))
    f = CrossTerms(*sp.symbols(CrossTerms._fields, real=True))
    f = f._replace(eps=0)
    with_it, bare = (rates(psi, u, v, r, (0, 0, 0), row, ns=sp) for row in ((*c, *f), c))
    X = -f.X_vv * v**2 - f.X_vr * v * r - f.X_rr * r**2
    Y = -f.Y_rv * abs(r) * v - f.Y_vr * abs(v) * r - f.Y_rr * abs(r) * r - f.d23 * r
    N = -f.N_vv * abs(v) * v - f.N_rv * abs(r) * v - f.N_vr * abs(v) * r - f.d32 * v
    added = [0, 0, X / c.m11, Y / c.m22, N / c.m33]
    assert [sp.simplify(a - b - e) for a, b, e in zip(with_it, bare, added, strict=True)] == [0] * 5


def test_a_rudder_moves_the_tracked_point_by_its_torque_alone():
    """v + eps r of the equations about the origin, with the side force of a rudder at m33 / (m22 eps) behind it.

    A force from outside, with a yaw moment of its own, acts on the origin.
    """
    psi, u, v, r, X, N, X_o, Y_o, N_o = sp.symbols("psi u v r X N X_o Y_o N_o", real=True)
    c = Coefficients(*sp.symbols(Coefficients._fields, positive=True))
    f = CrossTerms(*sp.symbols(CrossTerms._fields, real=True))
    side = -N * f.eps * c.m22 / c.m33
    x_dot, y_dot, u_dot, v_dot, r_dot = rates(
        psi, u, v, r, (X + X_o, side + Y_o, N + N_o), (*c, *f._replace(eps=0)), ns=sp
    )
    forward, left = sp.cos(psi), sp.sin(psi)
    expected = x_dot - f.eps * r * left, y_dot + f.eps * r * forward, u_dot, v_dot + f.eps * r_dot, r_dot
    X_w, Y_w, N_w = from_outside((X_o, Y_o, N_o), (*c, *f))
    tracked = rates(psi, u, v + f.eps * r, r, (X + X_w, Y_w, N + N_w), (*c, *f), ns=sp)
    assert [sp.simplify(a - b) for a, b in zip(tracked, expected, strict=True)] == [0] * 5


@pytest.mark.parametrize("vehicle", [PAPER_VEHICLE, FINNED])
def test_without_a_side_force_a_load_from_outside_is_the_load(vehicle):
    load = 1.0, 2.0, 3.0
    assert from_outside(load, vehicle.acting) is load


@pytest.mark.parametrize(("vehicle", "terms"), [(PAPER_VEHICLE, 9), (ROUGH, 9), (FINNED, 13), (CROSSED, 25)])
def test_what_a_vehicle_has_not_is_not_computed(vehicle, terms):
    assert len(vehicle.acting) == terms


def test_floats_arrays_and_tensors_agree():
    rng = np.random.default_rng(0)
    state, load = rng.normal(size=(6, 7)), 50 * rng.normal(size=(3, 7))
    arguments = ROUGH.coefficients, 0.1, CURRENT
    alone = [rk4_step(tuple(s), tuple(f), *arguments) for s, f in zip(state.T.tolist(), load.T.tolist(), strict=True)]
    together = rk4_step(tuple(state), tuple(load), *arguments, ns=np)
    tensors = rk4_step(tuple(torch.tensor(state)), tuple(torch.tensor(load)), *arguments, ns=torch)
    np.testing.assert_allclose(np.array(together).T, alone, rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(torch.stack(tensors).numpy().T, alone, rtol=1e-14, atol=1e-15)


@given(states)
@VEHICLES
def test_kinetic_energy_falls_by_the_work_of_drag(vehicle, state):
    m11, m22, m33, *drag = vehicle.coefficients
    c = vehicle.cross_terms
    (*_, u, v, r), (Y_uv, Y_ur, N_uv, N_ur) = state, drag[6:]
    rate = state_rates(state, (0.0, 0.0, 0.0), vehicle.acting)
    power = m11 * u * rate[3] + m22 * v * rate[4] + m33 * r * rate[5]
    work = sum((d + q * abs(s)) * s * s for d, q, s in zip(drag[:3], drag[3:6], (u, v, r), strict=True))
    work += abs(u) * (Y_uv * v * v - (Y_ur + N_uv) * v * r + N_ur * r * r)
    slope = c.slopes(vehicle.Y_vv, vehicle.N_rr)[v * r < 0]
    work += sum(k * abs(v) ** (3 - n) * abs(r) ** n for n, k in enumerate(slope) if n in (1, 2))
    work += u * (c.X_vv * v * v + c.X_vr * v * r + c.X_rr * r * r)
    assert power == pytest.approx(-work, abs=1e-9)

    def energy(state):
        return 0.5 * (m11 * state[3] ** 2 + m22 * state[4] ** 2 + m33 * state[5] ** 2)

    later = roll(state, (0.0, 0.0, 0.0), vehicle, 1, 0.1)
    assert energy(later) <= energy(state)


@given(states, loads, st.floats(-4, 4), st.floats(-9, 9), st.floats(-9, 9))
def test_turning_and_shifting_the_world_changes_nothing(state, load, angle, x0, y0):
    def moved(x, y, psi, *velocities):
        return (*to_body(x - x0, y - y0, math.cos(angle), math.sin(angle)), psi - angle, *velocities)

    current = to_body(*CURRENT, math.cos(angle), math.sin(angle))
    here = roll(state, load, PAPER_VEHICLE, 1, 0.1, CURRENT)
    there = roll(moved(*state), load, PAPER_VEHICLE, 1, 0.1, current)
    np.testing.assert_allclose(moved(*here), there, rtol=0, atol=1e-11)


@given(states, loads, unit, unit)
def test_a_constant_current_carries_the_motion_along(state, load, V_x, V_y):
    drifting = roll(state, load, ROUGH, 2, 0.1, (V_x, V_y))
    carried = roll(state, load, ROUGH, 2, 0.1) + 2 * np.array([V_x, V_y, 0, 0, 0, 0])
    np.testing.assert_allclose(drifting, carried, rtol=0, atol=1e-11)
