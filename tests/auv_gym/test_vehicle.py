"""Vehicle parameters: the paper's, and the refusal of every wrong one by name, value and what is allowed."""

import math
import re
from dataclasses import fields, replace

import pytest

from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle

NAMES = [field.name for field in fields(Vehicle) if field.name != "speed"]


def test_paper_vehicle():
    assert PAPER_VEHICLE.coefficients == (215.0, 265.0, 80.0, 70.0, 100.0, 50.0, *[0.0] * 7)
    assert PAPER_VEHICLE.coefficients._fields == tuple(NAMES)
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
    with pytest.raises(ValueError, match=rf"{name} is {value}; inertia and linear drag must be positive"):
        replace(PAPER_VEHICLE, **{name: value})


@pytest.mark.parametrize("name", [*NAMES[6:10], "N_ur"])
def test_drag_is_a_magnitude(name):
    assert getattr(replace(PAPER_VEHICLE, **{name: 0}), name) == 0
    with pytest.raises(ValueError, match=rf"{name} is -0.5; drag is a magnitude, 0 or more"):
        replace(PAPER_VEHICLE, **{name: -0.5})


@pytest.mark.parametrize("m22", [215, 214.9])
def test_more_mass_in_sway_than_in_surge(m22):
    with pytest.raises(ValueError, match=rf"m22 = {m22} kg is not above m11 = 215.0 kg"):
        replace(PAPER_VEHICLE, m22=m22)
