"""Vehicle parameters: the paper's, and the refusal of every wrong one by name, value and what is allowed."""

import math
import re
from dataclasses import fields, replace

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_gym.effects.mismatch import RandomMismatch
from auv_gym.physics.dynamics import rates
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle

NAMES = [field.name for field in fields(Vehicle) if field.name != "speed"]
DAMPED = replace(PAPER_VEHICLE, Y_vv=100.0, N_rr=50.0)


def test_paper_vehicle():
    assert PAPER_VEHICLE.coefficients == (215.0, 265.0, 80.0, 70.0, 100.0, 50.0, *[0.0] * 7)
    assert (*PAPER_VEHICLE.coefficients._fields, *PAPER_VEHICLE.cross_terms._fields) == tuple(NAMES)
    assert (PAPER_VEHICLE.length, PAPER_VEHICLE.speed) == (math.sqrt(80 / 215), 1.5)
    assert PAPER_VEHICLE.time == PAPER_VEHICLE.length / 1.5


@pytest.mark.parametrize("speed", [math.nan, math.inf, True, "1", 0.0, -1.0, 17.0])
def test_what_is_no_design_speed_is_refused(speed):
    with pytest.raises(ValueError, match=rf"vehicle speed is {speed!r}; it must be a number in \[0.01, 16\]"):
        replace(PAPER_VEHICLE, speed=speed)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, True, "1", None, 1j], ids=repr)
@pytest.mark.parametrize("name", NAMES)
def test_what_is_no_finite_number_is_refused(name, value):
    with pytest.raises(ValueError, match=rf"{name} is {re.escape(repr(value))}; it must be a finite number"):
        replace(PAPER_VEHICLE, **{name: value})


@pytest.mark.parametrize("value", [-1.0, 0, 0.0])
@pytest.mark.parametrize("name", NAMES[:6])
def test_inertia_and_linear_drag_are_positive(name, value):
    advice = "" if name[0] == "m" else ".*write the magnitude" if value < 0 else ".*can be linearised"
    with pytest.raises(ValueError, match=rf"{name} is {value}; inertia and linear drag must be positive{advice}"):
        replace(PAPER_VEHICLE, **{name: value})


@pytest.mark.parametrize("name", [*NAMES[6:10], "N_ur"])
def test_drag_is_a_magnitude(name):
    assert getattr(replace(PAPER_VEHICLE, **{name: 0}), name) == 0
    with pytest.raises(ValueError, match=rf"{name} is -0.5; drag is a magnitude, 0 or more"):
        replace(PAPER_VEHICLE, **{name: -0.5})


@pytest.mark.parametrize(
    "terms",
    [
        {"Y_rv": -400.0},
        {"Y_vr": 300.0, "N_vv": 300.0},
        {"Y_rr": -300.0, "N_rv": -300.0},
        {"Y_vr": 0.1, "Y_vv": 0.0},
        {"N_rv": -0.1, "N_rr": 0.0},
    ],
    ids=str,
)
def test_quadratic_damping_that_gives_power_is_refused(terms):
    with pytest.raises(ValueError, match="the quadratic damping of sway and yaw is not dissipative"):
        replace(DAMPED, **terms)


@given(st.lists(st.floats(-150, 150), min_size=6, max_size=6))
def test_quadratic_damping_that_is_accepted_takes_power(terms):
    try:
        vehicle = replace(DAMPED, **dict(zip(NAMES[-9:-3], terms, strict=True)))
    except ValueError:
        vehicle = DAMPED
    v, r = np.random.default_rng(0).standard_normal((2, 2000))
    still = replace(vehicle, d22=1e-9, d33=1e-9).acting
    _, _, _, v_dot, r_dot = rates(0.0, 0.0, v, r, (0.0, 0.0, 0.0), still, ns=np)
    assert (vehicle.m22 * v * v_dot + vehicle.m33 * r * r_dot <= 1e-6).all()


@pytest.mark.parametrize("m22", [215, 214.9])
def test_more_mass_in_sway_than_in_surge(m22):
    with pytest.raises(ValueError, match=rf"m22 = {m22} kg is not above m11 = 215.0 kg"):
        replace(PAPER_VEHICLE, m22=m22)


def test_what_simulators_leave_out_is_answered_with_what_to_do():
    """Purely quadratic drag, no added mass, and the largest ship."""
    with pytest.raises(ValueError, match=r"d22 is 0.0; .* purely quadratic can be linearised at a speed v"):
        replace(PAPER_VEHICLE, d22=0.0)
    with pytest.raises(ValueError, match=r"m22 = 215.0 kg is not above .* leave added mass out, such as Gazebo"):
        replace(PAPER_VEHICLE, m22=215.0)
    tanker = Vehicle(m11=3.3e8, m22=5.6e8, m33=2.9e12, d11=1e6, d22=1e7, d33=1e11, speed=8.0)
    assert tanker.length > 50


def test_the_vehicle_with_quadratic_drag_can_be_named_and_planned_for():
    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario="cruise-storm", vehicle="paper-2007")
    env.reset(seed=0)
    assert env.unwrapped.scenario.name == "cruise-storm@paper-2007"
    vehicle = env.unwrapped.scenario.vehicle
    assert (vehicle.X_uu, vehicle.Y_vv, vehicle.N_rr) == RandomMismatch().quadratic_drag
    assert vehicle.coefficients[:6] == PAPER_VEHICLE.coefficients[:6]
