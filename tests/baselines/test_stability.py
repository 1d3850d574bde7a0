"""Local stability: linearised error dynamics against differences, and known eigenvalues of the paper's law."""

from dataclasses import replace

import numpy as np
import pytest

from auv_gym.physics.dynamics import rates
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from baselines.control.backstepping import GAINS
from baselines.control.linearisation import error_dynamics
from baselines.control.stability import closed_loop_eigenvalues, first_instability


@pytest.mark.parametrize("cross", [{}, {"Y_rv": 40.0, "N_vr": 30.0, "X_rr": 5.0, "d23": 20.0, "eps": 0.4}])
def test_error_dynamics_with_quadratic_drag_and_lift(cross):
    """Against differences of (2) and of the errors' kinematics in the body frame."""
    vehicle = Vehicle(m11=215.0, m22=265.0, m33=80.0, d11=70.0, d22=100.0, d33=50.0, X_uu=30.0, Y_vv=80.0, N_rr=20.0)
    vehicle = replace(vehicle, Y_uv=60.0, Y_ur=40.0, N_uv=25.0, N_ur=30.0, **cross)
    u_R, v_R, r_R = 0.8, -0.3, 0.2

    def error_rates(e, force=(0.0, 0.0)):
        e_x, e_y, psi_e, u_e, v_e, r_e = e
        u, v, r = u_R + u_e, v_R + v_e, r_R + r_e
        c, s = np.cos(psi_e), np.sin(psi_e)
        _, _, *accelerations = rates(0.0, u, v, r, (force[0], 0.0, force[1]), vehicle.acting)
        return np.array((u - c * u_R - s * v_R + r * e_y, v - c * v_R + s * u_R - r * e_x, r_e, *accelerations))

    A, B = error_dynamics(vehicle, u_R, v_R, r_R)
    h, still = 1e-6, np.zeros(6)
    slopes = [(error_rates(h * d) - error_rates(-h * d)) / (2 * h) for d in np.eye(6)]
    np.testing.assert_allclose(A, np.array(slopes).T, atol=1e-8)
    np.testing.assert_allclose(
        B, np.array([error_rates(still, d) - error_rates(still) for d in np.eye(2)]).T, atol=1e-12
    )


def test_at_the_speed_of_the_first_instability_the_largest_real_part_is_zero():
    speed = first_instability(PAPER_VEHICLE, GAINS["paper"], 0.3, 0.8)
    assert speed == pytest.approx(0.497, abs=5e-4)
    assert closed_loop_eigenvalues(PAPER_VEHICLE, GAINS["paper"], speed, 0.0)[0].real == pytest.approx(0, abs=1e-6)
