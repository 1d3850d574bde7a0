"""The recomputed paper: every printed number against values that were derived independently."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from auv_gym import Scenario
from auv_gym.effects.actuators import Actuators
from auv_gym.physics.namespaces import ARRAYS
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.planning.paths import Circle
from auv_gym.planning.planner import plan
from baselines.control.backstepping import GAINS, Backstepping, tracking_forces
from baselines.control.linearisation import error_dynamics
from baselines.evaluation.episodes import run_episodes
from research.paper.command import held_growth, main
from research.paper.numbers import printed_surge_rate, reproduce_paper
from research.paper.stability import (
    closed_loop_eigenvalues,
    derived_sign_forces,
    held_abscissa,
    monodromy,
    spectral_abscissa,
)

STARTS = {
    # signs: to 5 cm [s], to 1 deg [s], peak |F_u| [N], peak |F_r| [N m]
    "+ + +": (16.9, 23.1, 251.2, 105.4),
    "+ + -": (23.2, 29.1, 86.8, 77.7),
    "+ - +": (23.4, 29.5, 85.8, 76.4),
    "+ - -": (16.2, 22.5, 264.0, 101.3),
    "- + +": (27.3, 33.1, 158.4, 136.3),
    "- + -": (21.3, 27.1, 380.4, 42.9),
    "- - +": (21.8, 27.9, 367.6, 45.5),
    "- - -": (27.3, 33.4, 159.1, 136.1),
}
TURN_RATES = (0.0, 0.1, 0.2, 0.3)
SPEEDS = (0.1, 0.3, 0.5, 1.0, 2.0)
ABSCISSAS = {
    "paper": [
        (-0.213, -0.168, -0.098, -0.051),
        (-0.222, -0.238, -0.279, -0.323),
        (+0.002, -0.010, -0.047, -0.096),
        (+0.230, +0.221, +0.195, +0.160),
        (+0.422, +0.414, +0.392, +0.362),
    ],
    "robust": [
        (-0.111, -0.114, -0.111, -0.111),
        (-0.122, -0.147, -0.168, -0.154),
        (-0.122, -0.133, -0.170, -0.197),
        (-0.117, -0.126, -0.144, -0.185),
        (-0.111, -0.130, -0.131, -0.154),
    ],
}
NUMBERS = {
    "path speed v_p": (0.1, 1e-9),
    "path turn rate omega": (-0.01, 1e-9),
    "sideslip gamma": (1.2317, 5e-5),
    "surge velocity u_R": (0.0999769, 5e-8),
    "sway velocity v_R": (0.0021495, 5e-8),
    "yaw rate r_R": (-0.01, 1e-9),
    "surge force F_uR": (7.00408, 5e-6),
    "yaw torque F_rR": (-0.48925, 1e-5),
    "factor 10 / (m22 - m11)": (0.2, 1e-12),
    "coefficient d22 / 10": (10.0, 1e-12),
    "coefficient d22 v_p^2 / 10": (0.1, 1e-12),
    "coefficient m11 |omega| / 10": (0.215, 1e-12),
    "u_R integrated from 1e-3 m/s": (0.0999769, 5e-8),
    "floor of the position error": (6.8e-6, 1e-6),
    "floor of the velocity error": (1.2e-5, 1e-6),
    "largest real part on the circle": (-0.213, 5e-4),
    "speed at which straight lines turn unstable": (0.4970, 5e-5),
    "std of F_u under noise": (41.0, 2.0),
    "std of F_r under noise": (10.0, 0.5),
    "rms position error under noise": (0.022, 0.002),
    "std of F_u, low-pass at 1 Hz": (22.0, 1.5),
    "std of F_u, low-pass at 0.5 Hz": (16.0, 1.5),
    "std of F_u, low-pass at 0.3 Hz": (13.0, 1.5),
    "rms position error, low-pass at 1 Hz": (0.023, 0.002),
    "rms position error, low-pass at 0.5 Hz": (0.024, 0.002),
    "rms position error, low-pass at 0.3 Hz": (0.026, 0.002),
}
"""Values with their tolerances, by quantity."""


@pytest.fixture(scope="module")
def paper():
    return reproduce_paper()


@pytest.fixture(scope="module")
def measured(paper):
    return {row.quantity: row.measured for row in paper.rows + paper.remarks}


def test_number(measured):
    for quantity, (value, tolerance) in NUMBERS.items():
        assert measured[quantity] == pytest.approx(value, abs=tolerance), quantity


def test_only_two_numbers_disagree(paper):
    assert [row.quantity for row in paper.rows if row.agrees is False] == [
        "yaw torque F_rR",
        "floor of the heading error",
    ]
    torque = next(row for row in paper.rows if row.quantity == "yaw torque F_rR")
    assert torque.paper == -0.488
    assert "0.3 %" in torque.note


def test_section_v_from_every_start(paper):
    for signs, *numbers, error in paper.starts:
        np.testing.assert_allclose(numbers, STARTS.pop(signs), rtol=0.01)
        assert error < 1e-7
    assert STARTS == {}


def test_remarks_on_the_printed_equations(measured):
    assert measured["u_R on the circle run counter-clockwise"] == pytest.approx(0.0999769, abs=5e-8)
    assert measured["factor of z_v in the bracket"] == pytest.approx(-215 / 265 * 0.0999769)
    assert measured["largest real part with the derived sign"] > 0
    assert measured["gains that meet both conditions"] == 0
    assert measured["width of the interval for k_2"] == 0


def test_the_command_writes_the_figures(tmp_path, capsys):
    assert main(["--out", str(tmp_path)]) == 0
    assert "| rms position error under noise |" in capsys.readouterr().out
    names = ("fig3_trajectory", "fig4_forces", "fig5_velocity_errors", "fig6_tracking_errors")
    for name in names:
        assert (tmp_path / f"{name}.png").read_bytes().startswith(b"\x89PNG")


def test_eigenvalues_on_the_circle():
    expected = [-0.213 - 0.061j, -0.213 + 0.061j, -0.326 - 0.900j, -0.326 + 0.900j, -1.199, -1.509]
    values = closed_loop_eigenvalues(PAPER_VEHICLE, GAINS["paper"], 0.1, -0.01)
    np.testing.assert_allclose(values, expected, atol=6e-4)


@pytest.mark.parametrize("gains", ABSCISSAS)
def test_stability_over_speed_and_turn_rate(gains):
    found = [[spectral_abscissa(PAPER_VEHICLE, GAINS[gains], U, w) for w in TURN_RATES] for U in SPEEDS]
    np.testing.assert_allclose(found, ABSCISSAS[gains], atol=6e-4)


def test_stability_does_not_depend_on_the_side_of_the_turn():
    one, other = (closed_loop_eigenvalues(PAPER_VEHICLE, GAINS["paper"], 0.3, w) for w in (0.1, -0.1))
    np.testing.assert_allclose(one, other, atol=1e-8)


def test_lateral_eigenvalues_are_roots_of_the_characteristic_polynomial():
    """On a straight line surge decouples, and the lateral motion has a characteristic polynomial of degree 4."""
    gains, v, U = GAINS["paper"], PAPER_VEHICLE, 0.2
    g, d, kap = v.m11 * U / v.m22, v.d22 / v.m22, gains.k + gains.k1
    C = gains.c + gains.kc * (gains.cr * g) ** 2
    P, Q, N = 1 - C * gains.cr * g, 1 + C * gains.cr, C + gains.cr * (1 + g * g)
    slip = (v.m22 - v.m11) / v.m22
    lateral = np.roots([1, N + d, Q + N * d - P * g, Q * d + P * kap * U * slip, P * kap * U * d])
    surge = np.roots([1, kap + gains.cu + gains.ku * kap**2, (gains.cu + gains.ku * kap**2) * kap])
    expected = np.concatenate((lateral, surge))
    found = closed_loop_eigenvalues(v, gains, U, 0.0)
    assert max(np.abs(found - root).min() for root in expected) < 1e-6


def test_with_the_derived_sign_straight_lines_are_a_saddle():
    for U in np.geomspace(0.02, 2.0, 15):
        assert spectral_abscissa(PAPER_VEHICLE, GAINS["paper"], U, 0.0, derived_sign_forces) > 0


@given(st.floats(0.1, 1.2), st.floats(0.1, 2.0), st.floats(-0.2, 0.2), st.floats(-0.5, -0.01))
def test_printed_surge_rate_holds_for_clockwise_curves(gamma, v_p, v_p_dot, omega):
    D = PAPER_VEHICLE.d22 + PAPER_VEHICLE.m22 * v_p_dot / v_p
    gamma_dot = -(PAPER_VEHICLE.m11 * omega + D * math.tan(gamma)) / (PAPER_VEHICLE.m22 - PAPER_VEHICLE.m11)
    expected = v_p_dot * math.cos(gamma) - v_p * math.sin(gamma) * gamma_dot
    got = printed_surge_rate(v_p * math.cos(gamma), v_p, v_p_dot, omega, PAPER_VEHICLE)
    assert got == pytest.approx(expected, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(
    ("gains", "speed", "turn_rate", "dt", "lag"),
    [("paper", 0.3, 0.04, 0.2, 1.0), ("paper", 0.1, -0.04, 0.2, 0.36), ("cruise", 1.5, 0.12, 0.1, 1.0),
     ("robust", 2.0, 0.3, 0.1, 0.12), ("normalised", 1.0, -0.2, 0.1, 2.0)],
)  # fmt: skip
def test_held_commands_are_the_exponential_of_the_augmented_system(gains, speed, turn_rate, dt, lag):
    """Lagged forces and held commands as states; the simulator's force has the same mean over a period."""
    law, (now, _) = GAINS[gains], plan(Circle(speed, turn_rate), PAPER_VEHICLE, np.array([0.0, 1.0])).table
    A, B = error_dynamics(PAPER_VEHICLE, *now[3:6])
    reference = [np.full(6, value) for value in now[3:]]
    high, low = (
        np.array(tracking_forces((*e, *reference), PAPER_VEHICLE, law, ARRAYS))
        for e in (1e-6 * np.eye(6), -1e-6 * np.eye(6))
    )
    M = np.zeros((10, 10))
    M[:6, :6], M[:6, 6:8] = A, B
    M[6:8, 6:8], M[6:8, 8:] = -np.eye(2) / lag, np.eye(2) / lag
    after = expm(M * dt)[:8]
    after[:, :6] += after[:, 8:] @ (high - low) / 2e-6
    found = monodromy(
        PAPER_VEHICLE, lambda o: tracking_forces(o, PAPER_VEHICLE, law, ARRAYS), speed, turn_rate, dt, lag
    )
    expected = math.log(np.abs(np.linalg.eigvals(after[:, :8])).max()) / dt
    assert held_abscissa(PAPER_VEHICLE, law, speed, turn_rate, dt, lag) == pytest.approx(expected, abs=1e-3)
    np.testing.assert_allclose(found[:6, :6], after[:6, :6], atol=0.01)


@pytest.mark.parametrize(
    ("gains", "speed", "turn_rate", "dt", "lag"), [("cruise", 1.0, 0.12, 0.1, 0.6), ("paper", 0.2, 0.04, 0.2, 0.36)]
)
def test_errors_in_an_episode_decay_as_the_held_loop_does(gains, speed, turn_rate, dt, lag):
    """From actuators at rest; two rows of a recurrence are the slowest pair of eigenvalues."""
    scenario = Scenario(path=Circle(speed, turn_rate), actuators=Actuators(lag=lag), control_dt=dt, steps=700)
    [episode] = run_episodes(Backstepping(gains=GAINS[gains]), scenario, 1)
    e_y = episode.observations[300:, 1]
    recurrence = np.linalg.lstsq(np.column_stack((e_y[1:-1], e_y[:-2])), e_y[2:], rcond=None)[0]
    decay = np.log(np.abs(np.roots([1, *-recurrence]))) / dt
    np.testing.assert_allclose(decay, held_abscissa(PAPER_VEHICLE, GAINS[gains], speed, turn_rate, dt, lag), rtol=3e-3)


def test_the_page_says_where_the_held_loop_is_unstable():
    slow, cruise = (
        np.array([*held_growth(gains, of).values()]) for gains, of in (("paper", "slow"), ("cruise", "cruise"))
    )
    assert max(slow[:, :4].max(), cruise[:, :4].max()) < 0  # lags of the storms, up to 0.36 s
    assert slow[:2, 4].max() < 0 < slow[2, 4]  # 0.6 s
    assert cruise[:, 4].max() < 0
    assert slow[:, 5].min() > 0  # 1 s
    assert cruise[:2, 5].max() < 0 < cruise[2, 5]
    assert min(slow[:, 6].min(), cruise[:, 6].min()) > 0  # 2 s
