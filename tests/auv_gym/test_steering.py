"""Propeller and rudder: mirrored, turned, and against the same formulas in angles."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_gym.physics.steering import Stern, stern_load, thrust

STERN = Stern(0.02, 0.1, side=60.0, arm=3.5, drag=20.0, wash=0.02, wake=0.5, straight=0.4, uneven=0.0, neutral=0.0)
numbers = st.floats(-1.0, 1.0)


@given(numbers, numbers, numbers, numbers, st.floats(-50, 50))
def test_what_is_mirrored_gives_mirrored_forces(angle, u, v, r, T):
    X, Y, N = stern_load(T, angle, u, v, r, STERN)
    assert stern_load(T, -angle, u, -v, -r, STERN) == pytest.approx((X, -Y, -N))


@given(st.floats(-0.6, 0.6), st.floats(0.2, 2.0), numbers, numbers, st.floats(0, 50))
def test_side_force_is_that_of_a_rudder_in_an_inflow(angle, u, v, r, T):
    """F = side U_R^2 sin(delta) less what the inflow's own angle takes away, U_R its speed; the moment by its arm."""
    w = v - STERN.arm * r
    speed = math.sqrt(u * u + STERN.wash * T + STERN.wake * u * abs(w))
    drift = math.atan2(STERN.straight * w, speed)
    force = STERN.side * speed**2 * (math.sin(angle) - math.tan(drift))
    X, Y, N = stern_load(T, angle, u, v, r, STERN)
    assert (Y, N) == (pytest.approx(-force, abs=1e-4), pytest.approx(STERN.arm * force, abs=1e-3))
    assert X == pytest.approx(T - STERN.drag * (speed * math.sin(angle)) ** 2)


def test_one_propeller_turns_one_way():
    stern = STERN._replace(uneven=0.1, neutral=0.02)
    assert stern_load(10.0, 0.02, 1.0, 0.0, 0.0, stern)[1:] == pytest.approx((0.0, 0.0))
    port, starboard = (stern_load(10.0, 0.02, 1.0, v, 0.0, stern._replace(straight=0.0)) for v in (-0.2, 0.2))
    assert port == starboard
    assert port[1] > 0


@given(st.floats(-20, 20), st.floats(-2, 2))
def test_thrust_grows_with_revolutions_and_falls_with_speed(n, u):
    T = thrust(n, u, STERN)
    assert T == pytest.approx(STERN.T_nn * n * abs(n) - STERN.T_nu * abs(n) * u)
