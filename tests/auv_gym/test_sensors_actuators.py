"""Actuators compared with their differential equation, the low-pass with SciPy, and errors of both."""

import dataclasses
import math
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.signal import cont2discrete, lfilter
from scipy.stats import chi2, kstest

from auv_gym import decode_observation
from auv_gym.effects.actuators import Actuators, Response, respond
from auv_gym.effects.navigation import RandomReckoning
from auv_gym.effects.sensors import Sensors, low_pass
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.namespaces import ARRAYS, FLOATS
from auv_gym.physics.units import Units
from auv_gym.planning.paths import Line
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario, Start
from auv_gym.scenarios.vehicles import VEHICLES_FOLDER, VehicleModel

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


def test_levels_of_the_noise_are_drawn_with_a_uniform_logarithm():
    """In the episodes of one and of many vehicles alike, independent of each other, and seen in the measurements."""
    levels = {"position": (0.01, 1.0), "heading": (0.002, 0.02), "velocity": 0.05}
    noisy, plain = (
        Scenario(path=Line(1.0), sensors=Sensors(**fields), start=Start(0.0, 0.0, 0.0)) for fields in (levels, {})
    )
    episodes = [noisy.draw(np.random.default_rng(seed)) for seed in range(2000)]
    x, y, psi, u, v, r = np.array([episode.noise for episode in episodes]).T
    assert (x == y).all()
    assert set(u) == set(v) == {0.05}
    assert set(r) == {0.0}
    for drawn, (low, high) in ((x, levels["position"]), (psi, levels["heading"])):
        assert kstest(np.log(drawn / low) / math.log(high / low), "uniform").pvalue > 0.01
    assert abs(np.corrcoef(np.log(x), np.log(psi))[0, 1]) < 0.06
    others = [replace(episode, noise=None) for episode in episodes[:5]]
    assert others == [plain.draw(np.random.default_rng(seed)) for seed in range(5)]  # nothing else is drawn differently

    env = gym.make_vec("auv_gym:UnderactuatedAUVTrack-v0", 64, vectorization_mode="vector_entry_point", scenario=noisy)
    first, _ = env.reset(seed=11)
    seen = [first] + [env.step(np.zeros((64, 2), dtype=np.float32))[0] for _ in range(200)]
    terms = decode_observation(np.array(seen).reshape(-1, 18))
    speeds, headings = (np.diff(term.reshape(-1, 64), 2, axis=0).std(axis=0) for term in (terms.u_e, terms.psi_e))
    np.testing.assert_allclose(speeds / math.sqrt(6), 0.05, rtol=0.35)
    assert headings.max() > 4 * headings.min()
    alone = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario=noisy)
    np.testing.assert_array_equal(alone.reset(seed=13)[0], first[2])
    with pytest.raises(
        ValueError, match=r"position is \(0.0, 1.0\); its logarithm is uniform, so low must be positive"
    ):
        Sensors(position=(0.0, 1.0))


def position_errors(sensors, n_envs=1, steps=300):
    """Return the errors of the measured position [m] in the world: steps + 1 instants, vehicles, axes."""
    seen = []
    for each in (sensors, Sensors()):  # the same motion without errors
        still = Scenario(path=Line(1.0, heading=0.4), sensors=each, steps=1000)
        env = UnderactuatedAUVTrackVectorEnv(n_envs, still)
        rows, actions = [env.reset(seed=5)[0]], np.zeros((n_envs, 2), dtype=np.float32)
        rows += [env.step(actions)[0] for _ in range(steps)]
        o = decode_observation(np.reshape(rows, (-1, 18)))
        seen.append((o.e_x + 1j * o.e_y) * (o.cos_psi + 1j * o.sin_psi))
    errors = seen[0] - seen[1]
    return np.stack((errors.real, errors.imag), axis=-1).reshape(steps + 1, n_envs, 2)


def test_correlated_noise_is_white_noise_after_a_filter():
    """By SciPy, from its stationary distribution on; a bias is not filtered."""
    time, bias = 2.0, 0.3
    white = position_errors(Sensors(position=0.1))
    found = position_errors(Sensors(position=0.1, position_bias=bias, correlation=time))
    a = math.exp(-0.1 / time)
    rest, _ = lfilter([math.sqrt(1 - a * a)], [1.0, -a], white[1:], axis=0, zi=a * white[:1])
    np.testing.assert_allclose(found - bias, np.concatenate((white[:1], rest)), rtol=0, atol=1e-5)


def test_correlated_noise_has_its_autocovariance():
    """It is stationary: the variance is the same at all instants, also at the first one."""
    n, time, deviation = 400, 1.5, 0.1
    errors = position_errors(Sensors(position=deviation, correlation=time), n) / deviation
    for lag in (0, 1, 10, 30, 60):
        found = (errors[lag:] * errors[: len(errors) - lag]).mean(axis=(0, 1))
        np.testing.assert_allclose(found, math.exp(-0.1 * lag / time), rtol=0, atol=0.06)
    assert np.abs((errors[..., 0] * errors[..., 1]).mean()) < 0.06
    spread = n * (errors**2).mean(axis=1)  # chi-squared with n degrees of freedom
    low, high = chi2.ppf((1e-6, 1 - 1e-6), n)
    assert ((low < spread) & (spread < high)).all()


def test_a_correlation_time_is_drawn_once_an_episode(tmp_path):
    """In the episodes of one and of many vehicles alike, with drawn levels; no other number is drawn differently."""
    sensors = Sensors(position=(0.01, 1.0), heading=0.01, position_bias=(-1.0, 1.0), correlation=(2.0, 6.0))
    noisy = Scenario(path=Line(1.0), sensors=sensors)
    plain = replace(noisy, sensors=replace(sensors, correlation=0.0))
    episodes = [noisy.draw(np.random.default_rng(seed)) for seed in range(1000)]
    assert kstest([(episode.correlation - 2.0) / 4.0 for episode in episodes], "uniform").pvalue > 0.01
    others = [replace(episode, correlation=0.0) for episode in episodes[:5]]
    assert others == [plain.draw(np.random.default_rng(seed)) for seed in range(5)]
    env, alone = UnderactuatedAUVTrackVectorEnv(4, noisy), UnderactuatedAUVTrackEnv(noisy)
    first, one = env.reset(seed=11)[0][2], alone.reset(seed=13)[0]
    for _ in range(50):
        np.testing.assert_array_equal(first, one)
        action = np.full((4, 2), 0.3, dtype=np.float32)
        first, one = env.step(action)[0][2], alone.step(action[0])[0]
    for suffix in ("toml", "json"):
        noisy.save(tmp_path / f"one.{suffix}")
        assert Scenario.load(tmp_path / f"one.{suffix}") == noisy
    assert "correlation" not in plain.to_dict()["sensors"]
    time = Units.of(VehicleModel.load(VEHICLES_FOLDER / "lauv.toml").vehicle).time
    assert changed(noisy, "lauv").sensors.correlation == pytest.approx((2.0 * time, 6.0 * time))
    with pytest.raises(ValueError, match="the episode has a correlated noise of the position"):
        UnderactuatedAUVTrackEnv(plain).reset(options={"episode": episodes[0]})
    with pytest.raises(ValueError, match=r"correlation is 2\.0, but the fixes of dead reckoning have white noise; set"):
        Sensors(correlation=2.0, reckoning=RandomReckoning())


def test_a_vehicle_with_instruments_has_their_noise_where_a_scenario_is_noisy(tmp_path):
    """In place of the noise that is scaled by its length; a level that is not given, or is zero, stays so."""
    file = tmp_path / "mine.toml"
    lauv = (VEHICLES_FOLDER / "lauv.toml").read_text(encoding="utf-8")
    file.write_text(f"{lauv}\n[sensors]\nposition = [0.02, 0.5]\nvelocity = 0.03\n", encoding="utf-8")
    storm, scaled = (changed(PRESETS["cruise-storm"], name) for name in (str(file), "lauv"))
    assert (storm.sensors.position, storm.sensors.velocity) == ((0.02, 0.5), 0.03)
    assert replace(storm.sensors, position=scaled.sensors.position, velocity=scaled.sensors.velocity) == scaled.sensors
    assert changed(PRESETS["cruise-calm"], str(file)).sensors.noise == (0.0,) * 6
    assert Scenario.from_dict(storm.to_dict()) == storm
    units = Units.of(storm.vehicle)
    paper = VehicleModel.load(file).in_paper_units.sensors
    assert paper.position == pytest.approx((0.02 / units.length, 0.5 / units.length))
