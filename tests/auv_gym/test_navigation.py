"""Dead reckoning between position fixes: compared with its equations and formulas of its drift."""

import cmath
import dataclasses
import math

import numpy as np
import pytest

from auv_gym import decode_observation
from auv_gym.effects.navigation import DeadReckoning, FixFilter, RandomReckoning, Reckoning, heading_errors
from auv_gym.effects.sensors import Sensors
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.physics.namespaces import ARRAYS
from auv_gym.planning.paths import Circle, Line
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.simulation import SAMPLE, SAMPLE_ROWS, start, step
from baselines.control.privileged.truth import Truth, samples
from research.validation.navigation import INSTRUMENTS

OFTEN = RandomReckoning(
    interval=(1.0, 3.0), scale=(-0.1, 0.1), misalignment=(-0.1, 0.1), drift=(-0.01, 0.01), walk=0.01
)
ROUGH = dataclasses.replace(  # all errors, large enough for an effect within a few seconds
    PRESETS["cruise-storm"],
    name="rough",
    steps=150,
    sensors=Sensors(0.5, 0.1, 0.2, 0.01, 0.2, (-0.1, 0.1), 0.1, 0.0, 10.0, (1.0, 4.0), OFTEN),
)


def navigation_errors(scenario, episodes):
    """Return the distance [m] between estimated and true position on the reference, shape (K + 1, N)."""
    truth = Truth.of(scenario, episodes)
    p, errors, rest = truth.parameters, np.empty((len(truth.samples), len(episodes))), np.zeros(len(episodes))
    plant, _ = start(tuple(truth.samples[0, :6]), tuple(truth.samples[0]), p, ARRAYS)
    places = p.parts.places.last
    for k, sample in enumerate(truth.samples):
        on_reference = tuple(sample[:6]), (rest, rest)
        if k:
            plant, *_ = step(plant, (rest, rest), tuple(sample), p, ARRAYS, lambda *_, there=on_reference: there)
        errors[k] = np.hypot(plant.memory[places["x"]] - plant.x, plant.memory[places["y"]] - plant.y)
    return errors


def world(observation, reference):
    """Return the measured position as a complex number."""
    o = decode_observation(observation)
    return complex(o.e_x, o.e_y) * complex(o.cos_psi, o.sin_psi) + complex(reference.x, reference.y)


def test_the_measured_position_is_dead_reckoned_and_corrected():
    """Compared with complex numbers, for the true positions and the samples of sensors and fixes."""
    env, rng = UnderactuatedAUVTrackEnv(ROUGH), np.random.default_rng(0)
    episode = dataclasses.replace(ROUGH.draw(rng), outages=((5.0, 9.0),))
    inputs, dt = samples(ROUGH, [episode])[:, :, 0], ROUGH.control_dt
    observation, _ = env.reset(options={"episode": episode})
    before, estimate, gains = complex(*env.state[:2]), None, []
    log = (1 + episode.reckoning.scale) * cmath.exp(1j * episode.reckoning.misalignment)
    for k, row in enumerate(inputs):
        position, psi = complex(*env.state[:2]), env.state[2]
        fix, n = position + complex(row[SAMPLE.n_x], row[SAMPLE.n_y]), complex(row[SAMPLE.n_u], row[SAMPLE.n_v])
        own = DeadReckoning.Inputs(*row[SAMPLE_ROWS:][ROUGH.parts.places.inputs[DeadReckoning]])
        turn, gain = cmath.exp(1j * (row[SAMPLE.n_psi] + own.heading)), own.fix
        reckoned = (
            fix if estimate is None else estimate + turn * (log * (position - before) + n * cmath.exp(1j * psi) * dt)
        )
        estimate, before = reckoned + gain * (fix - reckoned), position
        assert world(observation, env.reference) == pytest.approx(estimate, abs=1e-9), k
        gains.append(gain)
        V = complex(*env.state[3:5]) * log + n
        o = decode_observation(observation)
        assert complex(o.u_e + env.reference.u, o.v_e + env.reference.v) == pytest.approx(V, abs=1e-9)
        if k < ROUGH.steps:
            observation, *_ = env.step(rng.uniform(-0.5, 0.5, 2))
    times = dt * np.flatnonzero(gains)
    expected = [t for t in episode.reckoning.fixes if not 5.0 <= math.ceil(t / dt - 1e-9) * dt < 9.0 - 1e-9]
    np.testing.assert_allclose(times[1:], np.ceil(np.array(expected) / dt - 1e-9) * dt, atol=1e-9)
    assert gains[0] == 1.0
    assert all(0 < gain < 1 for gain in gains if gain not in (0.0, 1.0))


@pytest.mark.parametrize(("scale", "angle"), [(0.01, 0.0), (0.0, 0.02), (-0.02, -0.01)])
def test_on_a_straight_line_the_error_grows_with_the_distance(scale, angle):
    """The ratio is |(1 + scale) exp(i angle) - 1|, with half of the angle in the log and half in the gyro."""
    sensors = Sensors(reckoning=RandomReckoning(1e4, scale, angle / 2, 0.0, 0.0), heading_bias=angle / 2)
    scenario = Scenario(path=Line(1.0), sensors=sensors, steps=500)
    errors = navigation_errors(scenario, [scenario.draw(np.random.default_rng(0))])[:, 0]
    share = abs((1 + scale) * cmath.exp(1j * angle) - 1)
    np.testing.assert_allclose(errors, share * 0.1 * np.arange(501), atol=1e-9)


def test_on_a_circle_the_error_is_periodic():
    sensors = Sensors(reckoning=RandomReckoning(1e4, 0.02, 0.0, 0.0, 0.0))
    scenario = Scenario(path=Circle(0.5, 0.05), sensors=sensors, steps=round(20 * math.pi / 0.05))
    errors = navigation_errors(scenario, [scenario.draw(np.random.default_rng(0))])[:, 0]
    assert errors.max() == pytest.approx(0.02 * 20.0, rel=1e-3)
    assert errors[-1] < 1e-3


def test_the_heading_error_is_a_drift_and_a_random_walk():
    """Its mean is drift * t, its variance walk^2 * t, and its increments are independent."""
    rng, dt, n = np.random.default_rng(1), 0.2, 501
    errors = np.array([heading_errors(0.002, 0.03, dt, n, rng) for _ in range(4000)])
    assert (errors[:, 0] == 0).all()
    for k in (50, 200, 500):
        assert errors[:, k].mean() == pytest.approx(0.002 * k * dt, abs=4 * 0.03 * math.sqrt(k * dt / 4000))
        assert errors[:, k].var() == pytest.approx(0.03**2 * k * dt, rel=0.1)
    halves = errors[:, 250], errors[:, 500] - errors[:, 250]
    assert abs(np.corrcoef(*halves)[0, 1]) < 0.06


def test_noise_of_the_log_is_a_random_walk_of_the_position():
    """The variance is velocity^2 * dt * t on each axis."""
    sensors = Sensors(velocity=0.05, reckoning=RandomReckoning(1e4, 0.0, 0.0, 0.0, 0.0))
    scenario = Scenario(path=Circle(0.5, 0.05), sensors=sensors, steps=400)
    rng = np.random.default_rng(2)
    squares = (navigation_errors(scenario, [scenario.draw(rng) for _ in range(800)]) ** 2).mean(axis=1)
    for k in (100, 400):
        assert squares[k] == pytest.approx(2 * 0.05**2 * 0.1 * 0.1 * k, rel=0.15)


def test_rate_of_fixes():
    reckoning, rng = RandomReckoning(), np.random.default_rng(3)
    drawn = [reckoning.draw(rng, 300.0) for _ in range(300)]
    gaps = np.concatenate([np.diff((0.0, *d.fixes)) for d in drawn])
    assert 10.0 <= gaps.min() < gaps.max() <= 30.0
    assert max(d.fixes[-1] for d in drawn) <= 300.0
    assert np.mean([len(d.fixes) for d in drawn]) == pytest.approx(300 / 20 - 0.46, abs=0.15)  # renewal theory
    for name in ("scale", "misalignment", "drift"):
        values, (_, high) = [getattr(d, name) for d in drawn], getattr(reckoning, name)
        assert np.mean(np.square(values)) == pytest.approx(high**2 / 3, rel=0.2)


DISTANCES, TIMES = (20.0, 11.0, 28.0, 15.0, 60.0, 12.0), (20.0, 11.0, 28.0, 15.0, 60.0, 12.0)


def test_the_variance_of_the_filter_is_that_of_its_error():
    """The variance P before each fix, K = P / (P + fix^2), is that of 200,000 simulated errors."""
    fix, drift, bias, noise = 1.5, 2e-4, 1e-5, 1e-3
    gains, rng = FixFilter(fix, drift, bias, noise).gains(DISTANCES, TIMES), np.random.default_rng(4)
    constant, error = rng.standard_normal(200_000), fix * rng.standard_normal(200_000)
    for distance, time, K in zip(DISTANCES, TIMES, gains, strict=True):
        error += math.hypot(math.sqrt(drift) * distance, math.sqrt(bias) * time) * constant
        error += math.sqrt(noise * time) * rng.standard_normal(200_000)
        assert error.var() == pytest.approx(K / (1 - K) * fix**2, rel=0.02)
        after = [(error + k * (fix * rng.standard_normal(200_000) - error)).var() for k in (0.8 * K, K, 1.2 * K)]
        assert after[1] < min(after[0], after[2])  # the gain is optimal
        error += K * (fix * rng.standard_normal(200_000) - error)


def test_gains_in_the_limits():
    assert FixFilter(2.0, 0.0, 0.0, 0.0).gains(DISTANCES, TIMES) == pytest.approx(
        [1 / k for k in range(2, 8)]
    )  # a mean
    assert FixFilter(0.0, 0.0, 0.0, 0.0).gains(DISTANCES, TIMES) == [1.0] * 6  # fixes without an error
    assert FixFilter(1e-9, 1e-4, 0.0, 0.0).gains(DISTANCES, TIMES) == pytest.approx([1.0] * 6)


def test_parameters_of_the_filter_for_the_sensors():
    sensors = dataclasses.replace(INSTRUMENTS, reckoning=RandomReckoning(20.0, 0.03, 0.0, 0.0, 0.0), heading_bias=0.04)
    assert sensors.fix_filter(sensors.noise, 0.1, 100.0) == FixFilter(
        1.5, pytest.approx(0.05**2 / 2), pytest.approx(0.005**2 / 3), pytest.approx(0.01**2 * 0.1)
    )
    drifting = RandomReckoning(20.0, 0.0, 0.0, (0.0, 3e-4), 1e-3)
    assert drifting.mean_square_drift(0.0, 100.0) == pytest.approx((9e-8 / 3 * 100**2 / 3 + 1e-6 * 50) / 2)


def test_dead_reckoning_changes_nothing_else_of_an_episode():
    plain = dataclasses.replace(ROUGH, sensors=dataclasses.replace(ROUGH.sensors, reckoning=None))
    mine, theirs = (s.draw(np.random.default_rng(6)) for s in (ROUGH, plain))
    assert dataclasses.replace(mine, reckoning=None) == theirs
    inputs = samples(ROUGH, [mine]), samples(plain, [theirs])
    np.testing.assert_array_equal(inputs[0][:, :SAMPLE_ROWS], inputs[1][:, :SAMPLE_ROWS])


def test_messages_of_mistakes():
    with pytest.raises(ValueError, match="reckoning has no entry 'fixes'; allowed are interval, scale"):
        Scenario.from_dict({"sensors": {"reckoning": {"fixes": 3}}})
    episode = dataclasses.replace(Scenario().draw(np.random.default_rng(0)), reckoning=Reckoning())
    with pytest.raises(ValueError, match="the episode has a dead reckoning, but scenario 'custom' has none"):
        Scenario().parameters(episode)
