"""Unmodelled effects: delayed commands, early saturation, outages of position fixes, a sheared current."""

import dataclasses
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from auv_gym import decode_observation
from auv_gym.effects.actuators import LONGEST_DELAY, Actuators
from auv_gym.effects.current import RandomCurrent
from auv_gym.effects.sensors import Sensors
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.planning.paths import Line
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario

STEPS = 30
WHOLE = Scenario(path=Line(0.8, heading=0.3), steps=STEPS)


def actions(n=STEPS, seed=0):
    return np.random.default_rng(seed).uniform(-1, 1, (n, 2)).astype(np.float32)


def states(scenario, commands):
    """Return the states at all control instants and the last observation."""
    env = UnderactuatedAUVTrackEnv(scenario)
    observation, _ = env.reset(seed=1)
    rows = [env.state]
    for command in commands:
        observation, *_ = env.step(command)
        rows.append(env.state)
    return np.array(rows), decode_observation(observation)


@pytest.mark.parametrize("delay", range(LONGEST_DELAY + 1))
def test_delayed_commands_act_as_the_same_commands_sent_later(delay):
    commands = actions()
    delayed, seen = states(dataclasses.replace(WHOLE, actuators=Actuators(lag=0.3, delay=float(delay))), commands)
    shifted = np.vstack((np.zeros((delay, 2), np.float32), commands))[:STEPS]
    expected, _ = states(dataclasses.replace(WHOLE, actuators=Actuators(lag=0.3)), shifted)
    np.testing.assert_array_equal(delayed, expected)
    assert (seen.a_u, seen.a_r) == tuple(commands[-1].tolist())  # the command that was sent


def test_early_saturation_limits_the_force_and_is_not_observed():
    commands = actions()
    weak, seen = states(dataclasses.replace(WHOLE, actuators=Actuators(reach=0.4)), commands)
    clipped, expected = states(WHOLE, np.clip(commands, np.float64(-0.4), np.float64(0.4)))
    np.testing.assert_allclose(weak, clipped, rtol=1e-12, atol=1e-12)
    assert (seen.F_u_max, seen.F_r_max) == (expected.F_u_max, expected.F_r_max)
    assert (seen.a_u, seen.a_r) == tuple(commands[-1].tolist())


def test_without_a_fix_the_measured_position_is_constant():
    scenario = dataclasses.replace(WHOLE, sensors=Sensors(position=0.1, outages=20.0, outage_time=(0.5, 1.0)))
    episode = dataclasses.replace(scenario.draw(np.random.default_rng(0)), outages=((0.55, 1.25), (2.0, 2.2)))
    env, whole = UnderactuatedAUVTrackEnv(scenario), UnderactuatedAUVTrackEnv(scenario)
    positions = []
    for one, run in ((env, episode), (whole, dataclasses.replace(episode, outages=()))):
        o, _ = one.reset(options={"episode": run})
        rows = []
        for command in actions():
            o, *_ = one.step(command)
            d = decode_observation(o)
            e = d.e_x * d.cos_psi - d.e_y * d.sin_psi, d.e_x * d.sin_psi + d.e_y * d.cos_psi
            rows.append((e[0] + one.reference.x, e[1] + one.reference.y))
        positions.append(np.array(rows))
    held, measured = positions
    expected = measured.copy()
    for k in range(STEPS):
        time = 0.1 * (k + 1)
        if 0.55 <= time < 1.25 or 2.0 - 1e-9 <= time < 2.2 - 1e-9:
            expected[k] = expected[k - 1]
    np.testing.assert_allclose(held, expected, atol=1e-9)
    assert np.ptp(measured[5:11, 0]) > 0.1


def test_rate_and_duration_of_outages():
    sensors, rng = Sensors(outages=3.0, outage_time=(1.0, 2.0)), np.random.default_rng(2)
    drawn_ = [sensors.draw_outages(rng, 120.0) for _ in range(400)]
    counts = np.array([len(outages) for outages in drawn_])
    lengths = np.array([end - begin for outages in drawn_ for begin, end in outages])
    assert counts.mean() == pytest.approx(6.0, abs=4 * math.sqrt(6 / 400))
    assert counts.var() == pytest.approx(6.0, rel=0.3)
    assert lengths.mean() == pytest.approx(1.5, abs=0.05)
    assert 1.0 <= lengths.min() < lengths.max() <= 2.0


def test_a_vehicle_in_a_sheared_current_satisfies_its_differential_equation():
    sheared = dataclasses.replace(
        WHOLE,
        control_dt=0.01,
        steps=2000,
        current=RandomCurrent(speed=0.2, shear=0.4, wavelength=4.0),
        actuators=Actuators(),
    )
    episode = sheared.draw(np.random.default_rng(4))
    env, action, limits = UnderactuatedAUVTrackEnv(sheared), np.array([0.2, 0.02]), np.array([400.0, 200.0])
    env.reset(options={"episode": episode})
    a_x, a_y, k_x, k_y, phase = episode.current.shear
    assert a_x * k_x + a_y * k_y == pytest.approx(0.0, abs=1e-12)  # zero divergence
    assert 2 * math.pi / math.hypot(k_x, k_y) == pytest.approx(4.0)

    def water(x, y):
        swing = math.sin(k_x * x + k_y * y + phase)
        return episode.current.V_x + a_x * swing, episode.current.V_y + a_y * swing

    m11, m22, m33, d11, d22, d33 = episode.vehicle.coefficients[:6]
    F_u, F_r = action * limits

    def rates(t, z):
        x, y, psi, u, v, r = z
        V_x, V_y = water(x, y)
        c, s = math.cos(psi), math.sin(psi)
        return (
            u * c - v * s + V_x,
            u * s + v * c + V_y,
            r,
            (m22 * v * r - d11 * u + F_u) / m11,
            (-m11 * u * r - d22 * v) / m22,
            ((m11 - m22) * u * v - d33 * r + F_r) / m33,
        )

    z0 = list(episode.initial_state(env.reference))
    exact = solve_ivp(rates, (0, 20.0), z0, rtol=1e-10, atol=1e-10).y[:, -1]
    for _ in range(2000):
        env.step(action)
    np.testing.assert_allclose(env.state[:3], exact[:3], atol=5e-3)
    np.testing.assert_allclose(env.current, water(*env.state[:2]), atol=1e-12)
    assert np.hypot(*(env.state[:2] - z0[:2])) > 3


def test_a_turning_current_turns():
    scenario = dataclasses.replace(WHOLE, current=RandomCurrent(speed=0.3, direction=0.2, turn=0.5, relative=False))
    env = UnderactuatedAUVTrackEnv(scenario)
    env.reset(seed=0)
    for k in range(1, STEPS):
        env.step(np.zeros(2))
        angle = 0.2 + 0.5 * 0.1 * k
        np.testing.assert_allclose(env.current, (0.3 * math.cos(angle), 0.3 * math.sin(angle)), atol=1e-12)


def test_faults_change_no_other_draw():
    plain = PRESETS["cruise-storm"]
    bad = dataclasses.replace(
        plain,
        actuators=dataclasses.replace(plain.actuators, effectiveness=(0.3, 0.9), reach=(0.3, 0.6), delay=(1.0, 3.0)),
        sensors=dataclasses.replace(plain.sensors, outages=5.0),
    )
    a, b = (s.draw(np.random.default_rng(5)) for s in (plain, bad))
    assert b.delay in (1, 2, 3)
    assert all(0.3 <= share <= 0.6 for share in b.reach)
    assert all(0.3 <= share <= 0.9 for share in b.effectiveness)
    assert dataclasses.replace(b, effectiveness=(1, 1), reach=(1, 1), delay=0, outages=()) == a


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"delay": 1}, "the episode has a delay"),
        ({"reach": (0.5, 1.0)}, "the episode has actuators that saturate early"),
        ({"outages": ((1.0, 2.0),)}, "the episode has outages of the position fix"),
    ],
)
def test_episodes_of_another_kind_of_scenario_are_refused(change, message):
    env = UnderactuatedAUVTrackEnv(WHOLE)
    episode = dataclasses.replace(WHOLE.draw(np.random.default_rng(0)), **change)
    with pytest.raises(ValueError, match=message):
        env.reset(options={"episode": episode})
