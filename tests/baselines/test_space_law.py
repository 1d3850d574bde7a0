"""The law in space: that of the plane, its error equations, eigenvalues about steady motion, large errors."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_gym.physics.space import State, rk4_step, state_rates, tracking_errors
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.planning.paths import Circle
from auv_gym.planning.paths.space import Climb, WithHeight
from auv_gym.planning.space import plan
from auv_gym.scenarios.vehicles import PAPER, vehicle_model
from baselines.control import backstepping
from baselines.control.backstepping import GAINS
from baselines.space.backstepping import Wanted, tracking_forces
from research.paper import stability
from research.paper.stability_in_space import closed_loop_eigenvalues, spectral_abscissa

SPACE = PAPER.in_space
SETS = pytest.mark.parametrize("gains", ["paper", "cruise", "normalised"])
unit = st.floats(-1.0, 1.0)
errors = st.tuples(*[unit.map(lambda x, top=top: top * x) for top in (3, 3, 3, 0.5, 1, 1, 0.3, 0.3, 0.2, 0.2)])


def wanted(row):
    return Wanted(row[3], *row[5:])


@pytest.mark.parametrize("horizon", [None, 3.0])
@pytest.mark.parametrize("name", ["paper", "lauv", "remus100", "nps-auv2"])
@SETS
@given(o=errors, v_R=unit)
def test_without_vertical_errors_it_is_the_law_of_the_plane_to_the_last_bit(gains, name, horizon, o, v_R):
    vehicle = PAPER.in_space if name == "paper" else vehicle_model(name).in_space
    e_x, e_y, _, _, psi_e, u_e, v_e, _, _, r_e = o
    level = (e_x, e_y, psi_e, u_e, v_e, r_e, 1.2, v_R, 0.1, 30.0, 4.0)
    level = backstepping.bounded_error(level, horizon) if horizon else level
    flat = backstepping.tracking_forces(level, vehicle.horizontal, GAINS[gains])
    reference = Wanted(0.0, 1.2, v_R, 0.0, 0.0, 0.1, 30.0, 0.0, 4.0)
    got = tracking_forces((e_x, e_y, 0, 0, psi_e, u_e, v_e, 0, 0, r_e), 0.0, reference, vehicle, GAINS[gains], horizon)
    assert (got[0], got[2], got[1]) == (*flat, 0.0)


@SETS
@given(o=errors, theta=unit)
def test_surge_pitch_and_yaw_accelerate_as_34_and_47_want(gains, o, theta):
    G, R = GAINS[gains], Wanted(0.3, 1.1, 0.1, -0.2, 0.05, 0.1, 80.0, 3.0, 4.0)
    forces = tracking_forces(o, theta, R, SPACE, G)
    state = (0, 0, 0, theta, 0, *np.add(R[1:6], o[5:]))
    got = np.subtract(
        state_rates(state, (forces[0], 0, 0, *forces[1:]), SPACE.acting)[5:],
        state_rates((0, 0, 0, R.theta, 0, *R[1:6]), (R.F_u, 0, 0, R.F_q, R.F_r), SPACE.acting)[5:],
    )
    e, nu_e, kappa = np.array(o[:3]), np.array(o[5:8]), G.k + G.k1
    scale = 1.0 if G.reference_speed is None else G.reference_speed / math.sqrt(1.1**2 + 0.1**2 + 0.2**2)
    g, z = scale * 215 / 265 * state[5], nu_e + kappa * e
    n, chi, rho = scale * z[1:], np.array([o[4], -o[3]]), np.array([o[9], -o[8]])
    z_r = rho - G.cr * (g * n - chi)
    tau = -n - chi - G.cr * (g * g + 1) * rho - (G.c + G.kc * G.cr**2 * g * g) * z_r
    tau_u = -kappa * nu_e[0] - (G.cu + G.ku * kappa**2) * z[0]
    np.testing.assert_allclose([got[0], got[4], -got[3]], [tau_u, *tau], rtol=1e-9, atol=1e-9)


@SETS
@pytest.mark.parametrize("climb", [0.0, 0.35, -1.2])
def test_a_straight_line_of_any_climb_has_the_eigenvalues_of_the_plane_with_the_lateral_ones_twice(gains, climb):
    for speed in (0.3, 1.0, 2.0):
        space = np.poly(closed_loop_eigenvalues(SPACE, GAINS[gains], speed, 0.0, climb))
        flat = stability.closed_loop_eigenvalues(PAPER_VEHICLE, GAINS[gains], speed, 0.0)
        G = GAINS[gains]
        kappa = G.k + G.k1
        decay = kappa + G.cu + G.ku * kappa**2  # surge: e_x'' + decay e_x' + kappa (cu + ku kappa^2) e_x = 0
        surge = [1.0, decay, kappa * (G.cu + G.ku * kappa**2)]
        lateral, rest = np.polydiv(np.poly(flat), surge)
        assert np.abs(rest).max() < 1e-7
        np.testing.assert_allclose(space, np.polymul(np.poly(flat), lateral), rtol=1e-6, atol=1e-7)


@SETS
def test_the_eigenvalues_of_a_level_circle_are_among_those_of_space(gains):
    space = closed_loop_eigenvalues(SPACE, GAINS[gains], 1.0, 0.2, 0.0)
    flat = stability.closed_loop_eigenvalues(PAPER_VEHICLE, GAINS[gains], 1.0, 0.2)
    assert max(np.abs(space - one).min() for one in flat) < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize(("gains", "most"), [("cruise", -0.013), ("normalised", -0.126)])
def test_the_law_is_stable_on_180_helices(gains, most):
    speeds, rates, climbs = (
        (0.1, 0.3, 0.5, 1.0, 2.0),
        (-0.3, -0.1, 0.1, 0.3),
        np.radians([-60, -45, -30, -15, 0, 15, 30, 45, 60]),
    )
    worst = max(spectral_abscissa(SPACE, GAINS[gains], v, r, c) for v in speeds for r in rates for c in climbs)
    assert worst < most


def test_the_printed_gains_fail_on_a_climb_at_the_speed_of_the_plane():
    below, above = (spectral_abscissa(SPACE, GAINS["paper"], speed, 0.0, 0.5) for speed in (0.4969, 0.4971))
    assert below < 0 < above


@pytest.mark.parametrize("gains", ["cruise", "normalised"])
def test_a_vehicle_finds_its_helix_from_metres_away(gains):
    R = plan(WithHeight(Circle(1.0, 0.1), Climb(-0.3)), SPACE, 0.05 * np.arange(1801)).table
    state = State(*(R[0, :10] + [2.0, -3.0, 2.0, 0.2, 0.5, -0.3, 0, 0, 0, 0]))
    for row in R[:-1]:
        F = tracking_forces(tracking_errors(state, row[:10]), state.theta, wanted(row), SPACE, GAINS[gains], 3.0)
        F_u, F_q, F_r = np.clip(F, (-400, -200, -200), (400, 200, 200))
        state = rk4_step(state, (F_u, 0, 0, F_q, F_r), SPACE.acting, 0.05)
    assert math.dist(state[:3], R[-1, :3]) < 0.03


def test_a_vehicle_with_a_side_force_of_its_fins_finds_its_helix():
    vehicle = vehicle_model("lauv").in_space
    R = plan(WithHeight(Circle(0.8, 0.05), Climb(-0.2)), vehicle, 0.05 * np.arange(1801)).table
    state = State(*(R[0, :10] + [0.3, -0.3, 0.3, 0.1, 0.1, 0, 0, 0, 0, 0]))
    for row in R[:-1]:
        F_u, F_q, F_r = tracking_forces(
            tracking_errors(state, row[:10]), state.theta, wanted(row), vehicle, GAINS["normalised"], 3.0
        )
        state = rk4_step(state, (F_u, 0, 0, F_q, F_r), vehicle.acting, 0.05)
    assert math.dist(state[:3], R[-1, :3]) < 0.05
