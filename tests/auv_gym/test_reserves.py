"""What a plan leaves of the limits in a current: compared with drag on a line, and with motion in that current."""

import math
from dataclasses import replace

import numpy as np
import pytest
from matrix_form import matrix_form
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from auv_gym.effects.current import Current, RandomCurrent
from auv_gym.physics.vehicle import PAPER_2007, Vehicle
from auv_gym.planning.paths import Circle, FigureEight, Line, Path
from auv_gym.planning.planner import plan
from auv_gym.planning.reserves import ThroughWater, reserves
from auv_gym.scenarios.presets import PRESETS, as_scenario

LIMITS = 400.0, 200.0
FINNED = Vehicle(215.0, 265.0, 80.0, 10.0, 90.0, 10.0, Y_uv=80.0, Y_ur=10.0, N_uv=30.0, N_ur=60.0)
OTTER = as_scenario("cruise-calm@otter").vehicle
TIMES = 0.05 * np.arange(1201)


@pytest.mark.parametrize("current", [(0.0, 0.0), (-0.3, 0.0), (0.5, 0.0), (0.2, -0.4)])
def test_on_a_line_surge_takes_the_drag_at_the_speed_through_water(current):
    path, v = Line(0.8), PAPER_2007
    w = math.hypot(0.8 - current[0], current[1])
    surge, yaw = reserves(path, v, TIMES, LIMITS, current=current)
    assert surge == pytest.approx(1 - (v.d11 + v.X_uu * w) * w / LIMITS[0])
    assert yaw == pytest.approx(1.0)


@pytest.mark.parametrize("vehicle", [PAPER_2007, FINNED, OTTER], ids=["paper", "fins", "otter"])
@pytest.mark.parametrize("path", [Circle(0.7, 0.06), FigureEight(15.0, 0.03)], ids=["circle", "eight"])
def test_the_forces_keep_the_vehicle_on_its_path_in_the_current(vehicle, path):
    """In open loop, by DOP853 on the matrix form; the largest of these forces leave the reserves."""
    current, end = (0.2, -0.15), 10.0
    R = plan(ThroughWater(path, current), vehicle, TIMES)
    F_u, F_r = CubicSpline(R.t, R.F_u), CubicSpline(R.t, R.F_r)
    start = np.array([*path.derivatives(TIMES[:1])[0, :, 0], R.psi[0], R.u[0], R.v[0], R.r[0]])
    run = solve_ivp(
        lambda t, z: matrix_form(z, (F_u(t), 0.0, F_r(t)), vehicle, current), (0, end), start, "DOP853", rtol=1e-9
    )
    place = path.derivatives(np.array([end]))[0, :, 0]
    np.testing.assert_allclose(run.y[:2, -1], place, atol=1e-3)
    fin, (surge, yaw) = 250.0, reserves(path, vehicle, TIMES, LIMITS, 250.0, current)
    assert surge == pytest.approx(1 - np.abs(R.F_u).max() / LIMITS[0])
    assert yaw == pytest.approx((1 - np.abs(R.F_r) / np.minimum(fin * R.u**2, LIMITS[1])).min())


def test_a_path_through_water_is_a_path():
    path = ThroughWater(Circle(0.7, 0.06), (0.2, -0.1))
    assert isinstance(path, Path)
    t, h = np.linspace(0, 9, 7), 1e-4
    one, other, there = (path.derivatives(t + s) for s in (-h, h, 0.0))
    np.testing.assert_allclose((other - one)[:3] / (2 * h), there[1:], atol=1e-7)


def test_in_a_current_as_fast_as_the_path_no_motion_follows_it():
    assert reserves(Line(0.5), PAPER_2007, TIMES, LIMITS, current=(0.5, 0.0)) == (-math.inf, -math.inf)


def test_reserves_of_an_episode_are_those_in_its_mean_current_within_its_cap():
    scenario = replace(PRESETS["cruise-calm"], path=Line(0.8), current=RandomCurrent())
    episode, drag = scenario.draw(np.random.default_rng(0)), scenario.vehicle.d11
    for current, w in ((Current(), 0.8), (Current(-0.6), 1.4), (Current(-0.6, cap=0.5), 1.2)):
        surge, _ = scenario.reserves(replace(episode, current=current))
        assert surge == pytest.approx(1 - drag * w / scenario.actuators.F_u_max)
    with pytest.raises(
        ValueError, match="reserves are for motion in the plane; scenario 'space-storm' is one in space"
    ):
        as_scenario("space-storm").reserves(episode)
