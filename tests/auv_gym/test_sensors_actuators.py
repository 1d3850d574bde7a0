"""Actuators compared with their differential equation, the low-pass with SciPy, and errors of both."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete, lfilter

from auv_gym.effects.actuators import Actuators, Response, respond
from auv_gym.effects.sensors import Sensors, low_pass
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.physics.namespaces import ARRAYS, FLOATS
from auv_gym.scenarios.scenario import Scenario

INF = math.inf
forces = st.tuples(st.floats(-400, 400), st.floats(-200, 200))


@pytest.mark.parametrize("lag", [0.01, 0.12, 0.6, 30.0])
def test_response_is_the_first_order_lag(lag):
    force, command, dt = (-120.0, 30.0), (250.0, -80.0), 0.1

    def rates(t, z):  # of the force and of its integral over time
        return np.concatenate(((np.array(command) - z[:2]) / lag, z[:2]))

    exact = solve_ivp(rates, (0, dt), (*force, 0, 0), method="DOP853", rtol=1e-12, atol=1e-12).y[:, -1]
    mean, end = respond(force, command, Response.of(lag, INF, INF, dt), FLOATS)
    np.testing.assert_allclose((*end, *np.array(mean) * dt), exact, rtol=1e-9)


@given(forces, forces)
def test_without_lag_a_command_acts_immediately(force, command):
    mean, end = respond(force, command, Response.of(0.0, INF, INF, 0.1), FLOATS)
    assert mean == end == pytest.approx(command, abs=1e-12)


@given(forces, forces, st.floats(0, 2), st.floats(1, 1e4), st.floats(1, 1e4))
def test_forces_are_between_start_and_command_and_within_the_rate_limit(force, command, lag, fast, slow):
    dt = 0.2
    mean, end = respond(force, command, Response.of(lag, fast, slow, dt), FLOATS)
    for before, wanted, middle, after, rate in zip(force, command, mean, end, (fast, slow), strict=True):
        assert abs(after - before) <= rate * dt * (1 + 1e-9)
        assert min(before, wanted) - 1e-9 <= min(middle, after) <= max(middle, after) <= max(before, wanted) + 1e-9


def test_forces_change_at_the_rate_limit():
    force, response = (0.0, 0.0), Response.of(0.0, 100.0, 50.0, 0.1)
    for _ in range(7):
        _, force = respond(force, (65.0, -40.0), response, FLOATS)
    assert force == pytest.approx((65.0, -35.0))


@pytest.mark.parametrize("cut_off", [0.05, 0.5, 4.0])
def test_low_pass_is_the_first_order_filter_with_zero_order_hold(cut_off):
    dt, rng = 0.1, np.random.default_rng(1)
    gain = Sensors(low_pass=cut_off).filter_gain(dt)
    w = 2 * math.pi * cut_off
    numerator, denominator, _ = cont2discrete(([w], [1.0, w]), dt, method="zoh")
    measured = rng.normal(scale=0.3, size=(200, 6))
    measured[0] = 0.0
    expected = lfilter(numerator[0, 1:], denominator, measured, axis=0)  # without the delay of one step of the hold
    filtered = [(0.0,) * 6]
    for row in measured[1:].tolist():
        filtered.append(low_pass(filtered[-1], row, gain, FLOATS))
    np.testing.assert_allclose(filtered, expected, rtol=0, atol=1e-12)


def test_without_low_pass_measurements_do_not_change():
    assert Sensors().filter_gain(0.1) == 1.0
    assert low_pass((1.0,) * 6, (2.0,) * 6, 1.0, FLOATS) == (2.0,) * 6


@pytest.mark.parametrize("ns", [FLOATS, ARRAYS], ids=["floats", "arrays"])
@pytest.mark.parametrize(
    ("before", "measured", "after"), [(3.0, -3.0, 3.0707963), (-3.1, 3.1, -3.1207963), (0.2, 0.6, 0.3)]
)
def test_heading_is_filtered_along_the_shorter_arc(before, measured, after, ns):
    heading = low_pass((0, 0, before, 0, 0, 0), (0, 0, measured, 0, 0, 0), 0.25, ns)[2]
    assert heading == pytest.approx(after, abs=1e-7)
    assert -math.pi <= heading < math.pi


def test_effectiveness_reduces_the_force_and_is_not_observed():
    """At effectiveness 0.5 an action gives half of the force; observed limits and previous action do not change."""
    whole = Scenario(steps=20)
    weak = dataclasses.replace(whole, actuators=Actuators(effectiveness=0.5))
    (a, first), (b, second) = ((env, env.reset(seed=1)[0]) for env in map(UnderactuatedAUVTrackEnv, (whole, weak)))
    np.testing.assert_array_equal(first, second)
    for _ in range(20):
        seen, *_ = a.step(np.array([0.2, -0.1]))
        also, *_ = b.step(np.array([0.4, -0.2]))
    np.testing.assert_allclose(a.state, b.state, rtol=1e-12)
    np.testing.assert_allclose(a.force, b.force, rtol=1e-12)
    np.testing.assert_array_equal(seen[13:15], also[13:15])
    np.testing.assert_array_equal(also[15:17], [0.4, -0.2])
