"""Vehicles with cross terms: the yaw rate of the plan, and paths and episodes that are refused."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from matrix_form import matrix_form

from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.planning.crossed import motion
from auv_gym.planning.feasibility import InfeasibleReferenceError
from auv_gym.planning.paths import Circle, Legs
from auv_gym.planning.planner import plan
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import vehicle_model

CROSSED = replace(
    PAPER_VEHICLE, Y_vv=100.0, N_rr=50.0, X_vr=10.0, Y_rv=60.0, Y_vr=20.0, Y_rr=10.0, N_vv=15.0, N_vr=80.0
)


STEERED = replace(CROSSED, d23=15.0, d32=-5.0, eps=0.4)


@pytest.mark.parametrize("vehicle", [CROSSED, STEERED])
@given(v_p=st.floats(0.2, 2.0), omega=st.floats(-0.3, 0.3), v_p_dot=st.floats(-0.1, 0.1), w=st.floats(-0.5, 0.5))
def test_at_the_yaw_rate_of_the_plan_no_sway_force_is_missing(vehicle, v_p, omega, v_p_dot, w):
    along = np.array([[v_p], [0.3], [omega], [v_p_dot], [0.0], [0.0]])
    planned, there = motion(along, np.array([w]), np.array(vehicle.acting))
    assume(there[0])
    r, F_u, F_r, cosine = *planned[3:6, 0], math.sqrt(1 - w * w)
    state = [0.0, 0.0, 0.3, v_p * cosine, v_p * w - vehicle.eps * r, r]  # of the origin
    side = -F_r * vehicle.eps * vehicle.m22 / vehicle.m33
    _, _, _, _, v_dot, r_dot = matrix_form(state, (F_u, side, F_r), vehicle)
    v_dot += vehicle.eps * r_dot  # of the tracked point
    assert v_dot == pytest.approx(v_p_dot * w + v_p * cosine * (omega - r), abs=1e-9)


def test_a_path_that_no_yaw_rate_follows_is_refused():
    strong = replace(CROSSED, Y_vv=300.0, N_rr=300.0, Y_rr=150.0)
    with pytest.raises(InfeasibleReferenceError, match=r"no yaw rate balances|the sideslip exceeds"):
        plan(Circle(1.0, 0.6), strong, 0.1 * np.arange(100))


def test_an_episode_of_a_vehicle_with_cross_flow_needs_a_scenario_that_has_one():
    episode = replace(PRESETS["cruise-calm"].draw(np.random.default_rng(0)), vehicle=CROSSED)
    with pytest.raises(ValueError, match="the episode has a vehicle with cross terms"):
        PRESETS["cruise-calm"].parameters(episode)
    assert Scenario.from_dict(replace(PRESETS["cruise-calm"], vehicle=CROSSED).to_dict()).vehicle == CROSSED


def test_a_long_straight_leg_after_a_turn_is_feasible():
    """All accelerations vanish there; a tolerance that is relative to them would refuse the plan after minutes."""
    vehicle = vehicle_model("lauv").vehicle
    path = Legs(((0, 0), (50, 0), (50, 700)), vehicle.speed, 20.0)
    table = plan(path, vehicle, np.arange(0.0, path.end, 0.2)).table
    np.testing.assert_allclose(table[-1, 2:6], (np.pi / 2, vehicle.speed, 0.0, 0.0), atol=1e-9)
