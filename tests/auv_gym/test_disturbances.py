"""Current, waves, mismatch and exogenous inputs: statistics, independence of blocks and of other sub-environments."""

import math
import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from auv_gym.effects.current import Current, RandomCurrent
from auv_gym.effects.mismatch import RandomMismatch
from auv_gym.effects.sensors import Sensors
from auv_gym.effects.waves import RandomWaves
from auv_gym.physics.intervals import draw
from auv_gym.physics.stiffness import fastest_rate
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.planning.paths import Line
from auv_gym.planning.planner import plan
from auv_gym.scenarios.exogenous import ExogenousInputs
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import vehicle_model, vehicle_names

N_ENVS, BLOCK, DT = 400, 64, 0.1
NOISE, BIAS = (0.05, 0.05, 0.02, 0.01, 0.01, 0.004), (0.5, 0.5, -0.1, 0.2, 0.2, 0.03)
SENSORS = Sensors(*(NOISE[k] for k in (0, 2, 3, 5)), *(BIAS[k] for k in (0, 2, 3, 5)), low_pass=None)
SEA = Scenario(
    path=Line(0.8, heading=1.0),
    current=RandomCurrent(speed=0.2, direction=0.5, gust=0.15, gust_time=4.0, smoothing=1.0, relative=False),
    waves=RandomWaves(0.35, 0.2, 0.12),
    sensors=SENSORS,
    control_dt=DT,
)
TABLE = plan(SEA.path, SEA.vehicle, DT * np.arange(1001)).table
units = st.floats(0, 1, exclude_max=True)


def episodes(scenario, count, seed=0):
    rng = np.random.default_rng(seed)
    return [scenario.draw(rng) for _ in range(count)]


def loaded(scenario, drawn):
    inputs = ExogenousInputs(len(drawn), BLOCK, scenario.parts)
    for i, episode in enumerate(drawn):
        inputs.load(i, scenario, episode, TABLE)
    return inputs


def read(scenario, drawn, blocks):
    """Return the samples of N episodes, shape (T, SAMPLE, N), read in blocks of these sizes."""
    inputs = loaded(scenario, drawn)
    return np.concatenate([inputs.read(range(len(drawn)), n) for n in blocks])


@pytest.fixture(scope="module")
def sea():
    return read(SEA, episodes(SEA, N_ENVS), [BLOCK] * 15)


def test_reference_is_the_plan_and_its_end_is_repeated(sea):
    np.testing.assert_array_equal(sea[:, :8, 0], TABLE[: len(sea)])
    inputs = loaded(SEA, episodes(SEA, 1))
    rows = np.concatenate([inputs.read([0], BLOCK)[:, :8, 0] for _ in range(17)])
    np.testing.assert_array_equal(rows[len(TABLE) :], np.tile(TABLE[-1], (len(rows) - len(TABLE), 1)))


def test_noise_is_white_with_its_standard_deviation_and_bias(sea):
    noise = sea[:, 13:19]
    np.testing.assert_allclose(noise.mean(axis=(0, 2)), BIAS, rtol=0, atol=0.01 * max(NOISE))
    np.testing.assert_allclose(noise.std(axis=(0, 2)), NOISE, rtol=0.01)
    white = (noise - noise.mean(axis=(0, 2), keepdims=True)) / np.reshape(NOISE, (6, 1))
    assert np.abs((white[1:] * white[:-1]).mean(axis=(0, 2))).max() < 0.01
    assert np.abs(np.corrcoef(white.transpose(1, 0, 2).reshape(6, -1)) - np.eye(6)).max() < 0.01


def test_gust_has_its_mean_deviation_and_correlation_time(sea):
    """A process of time constant T, filtered with s, has covariance (T e^(-t/T) - s e^(-t/s)) T / (T^2 - s^2)."""
    T, s, sigma = 4.0, 1.0, 0.15
    gust = sea[100:, 8:10] - np.reshape([0.2 * math.cos(0.5), 0.2 * math.sin(0.5)], (2, 1))
    assert np.abs(gust.mean(axis=(0, 2))).max() < 0.01
    for lag in (0, 10, 40, 80):
        t = lag * DT
        expected = sigma**2 * T * (T * math.exp(-t / T) - s * math.exp(-t / s)) / (T**2 - s**2)
        got = (gust[lag:] * gust[: len(gust) - lag]).mean(axis=(0, 2))
        np.testing.assert_allclose(got, expected, rtol=0, atol=0.04 * sigma**2)
    assert abs((gust[:, 0] * gust[:, 1]).mean()) < 0.04 * sigma**2
    starts = sea[0, 8:10] - np.reshape([0.2 * math.cos(0.5), 0.2 * math.sin(0.5)], (2, 1))
    assert starts.std() == pytest.approx(sigma, rel=0.1)


def test_gust_is_driven_by_independent_white_noise(sea):
    """Inversion of the filter and of the process gives independent standard normals from the first step on."""
    smooth = sea[:, 8:10] - np.reshape([0.2 * math.cos(0.5), 0.2 * math.sin(0.5)], (2, 1))
    a, b = math.exp(-DT / 4.0), math.exp(-DT / 1.0)
    process = np.concatenate((smooth[:1], (smooth[1:] - b * smooth[:-1]) / (1 - b)))
    w = np.concatenate((process[:1], (process[1:] - a * process[:-1]) / math.sqrt(1 - a * a))) / 0.15
    assert w.mean() == pytest.approx(0, abs=0.01)
    assert w.std() == pytest.approx(1, abs=0.01)
    assert np.abs(w[:5].std(axis=(1, 2)) - 1).max() < 0.15
    assert abs((w[1:] * w[:-1]).mean()) < 0.01
    assert abs((w[0] * w[1]).mean()) < 0.15
    noise = (sea[:, 13:19] - np.reshape(BIAS, (6, 1))) / np.reshape(NOISE, (6, 1))
    assert np.abs(np.einsum("tal,tbl->ab", w, noise)).max() / w[:, 0].size < 0.01


def test_waves_are_sums_of_sines_with_their_root_mean_square(sea):
    expected = np.array([0.35 * 70, 0.2 * 100, 0.12 * 50]) * 0.8
    np.testing.assert_allclose(np.sqrt((sea[:, 10:13] ** 2).mean(axis=(0, 2))), expected, rtol=0.02)
    (episode,) = episodes(SEA, 1)
    waves, t = episode.waves, DT * np.arange(len(sea))
    edges = np.linspace(0.5, 1.1, 7)
    assert all(low <= f < high for low, f, high in zip(edges, waves.frequencies, edges[1:], strict=False))
    for axis, (rms, phases) in enumerate(zip((waves.surge, waves.sway, waves.yaw), waves.phases, strict=True)):
        force = sum(math.sqrt(2 / 6) * rms * np.sin(f * t + p) for f, p in zip(waves.frequencies, phases, strict=True))
        np.testing.assert_allclose(sea[:, 10 + axis, 0], force, rtol=0, atol=1e-11)


@pytest.mark.parametrize("cap", [0.0, 0.3, 0.75])
def test_current_never_exceeds_its_cap(cap):
    capped = replace(SEA, current=replace(SEA.current, cap=cap))
    drawn = episodes(capped, 50)
    speed = np.hypot(*read(capped, drawn, [BLOCK] * 3)[:, 8:10].transpose(1, 0, 2))
    free = np.hypot(*read(SEA, drawn_without_cap(drawn), [BLOCK] * 3)[:, 8:10].transpose(1, 0, 2))
    np.testing.assert_allclose(speed, np.minimum(free, cap * 0.8), rtol=1e-12, atol=1e-15)


def drawn_without_cap(drawn):
    return [replace(episode, current=replace(episode.current, cap=math.inf)) for episode in drawn]


@pytest.mark.parametrize("blocks", [[7, 57, 1, 63], [1] * 128, [20] * 6 + [8]], ids=["uneven", "single", "twenty"])
@pytest.mark.parametrize("scenario", [SEA, PRESETS["cruise-storm"], PRESETS["slow-gauss-markov"]], ids=lambda s: s.name)
def test_samples_do_not_depend_on_the_blocks(scenario, blocks):
    drawn = episodes(scenario, 3)
    whole = read(scenario, drawn, [BLOCK, BLOCK])
    np.testing.assert_allclose(read(scenario, drawn, blocks), whole, rtol=0, atol=1e-12)


def test_sub_environments_are_independent():
    """Compares one alone, several in another order, and one that is loaded while the others run."""
    drawn = [*episodes(SEA, 3), *episodes(PRESETS["slow-storm"], 2, seed=7)]
    together = read(SEA, drawn, [BLOCK, BLOCK])
    for i, episode in enumerate(drawn):
        np.testing.assert_allclose(read(SEA, [episode], [BLOCK, BLOCK])[..., 0], together[..., i], atol=1e-12)
    inputs = loaded(SEA, drawn[::-1])
    first = inputs.read([4, 0], BLOCK)
    inputs.load(1, SEA, drawn[0], TABLE)
    second = inputs.read([1, 0], BLOCK)
    np.testing.assert_allclose(first, together[:BLOCK, :, [0, 4]], rtol=0, atol=1e-12)
    np.testing.assert_allclose(second[..., 0], together[:BLOCK, :, 0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(second[..., 1], together[BLOCK:, :, 4], rtol=0, atol=1e-12)


def test_the_seed_determines_all_numbers():
    first, again, other = (read(SEA, episodes(SEA, 2, seed), [BLOCK]) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first[:, 10:19] != other[:, 10:19]).all()
    assert (first[:, 10:19, 0] != first[:, 10:19, 1]).all()


def test_samples_in_calm_water_are_zero_also_beside_and_after_a_storm():
    calm, (storm,) = Scenario(path=SEA.path), episodes(SEA, 1)
    (quiet,) = episodes(calm, 1)
    inputs = ExogenousInputs(2, BLOCK, SEA.parts)
    inputs.load(0, SEA, storm, TABLE)
    inputs.load(1, calm, quiet, TABLE)
    assert not inputs.read([0, 1], BLOCK)[:, 8:19, 1].any()
    inputs.load(0, calm, quiet, TABLE)
    assert not inputs.read([0, 1], BLOCK)[:, 8:19].any()


@given(units, units, st.floats(0.1, 2.0))
def test_a_relative_current_scales_with_the_speed_of_the_path(first, second, speed):
    for relative, unit in ((True, speed), (False, 1.0)):
        current = RandomCurrent((0.1, 0.5), gust=0.2, relative=relative).draw(iter((first, second)).__next__, speed)
        assert math.hypot(current.V_x, current.V_y) == pytest.approx(unit * (0.1 + 0.4 * first))
        assert math.remainder(math.atan2(current.V_y, current.V_x) - math.tau * second + math.pi, math.tau) == (
            pytest.approx(0, abs=1e-9)
        )
        assert current == replace(Current(gust=0.2 * unit), V_x=current.V_x, V_y=current.V_y)


@given(
    st.lists(units, min_size=7, max_size=7),
    st.tuples(st.floats(1, 300), st.floats(1.05, 4)),
    st.floats(0.1, 1.0),
    st.floats(0, 3),
)
def test_mismatch_is_a_vehicle_with_more_mass_in_sway(numbers, masses, spread, quadratic):
    vehicle = Vehicle(masses[0], masses[0] * masses[1], 80.0, 70.0, 100.0, 50.0, Y_vv=5.0)
    low = 1.02 / masses[1]
    mismatch = RandomMismatch((spread, 1.5), (low, low + 1), *[(spread, 1.5)] * 4, (0.0, quadratic), (1.0, 2.0, 3.0))
    mismatch.check(vehicle)
    true = mismatch.draw(iter(numbers).__next__, vehicle)
    assert true.m22 > 1.01 * true.m11
    factors = [low + (high - low) * u for (low, high), u in zip([(spread, 1.5)] * 7, numbers, strict=True)]
    assert true.m11 == pytest.approx(vehicle.m11 * factors[0])
    assert true.m22 / true.m11 == pytest.approx(masses[1] * (low + numbers[1]))
    assert (true.m33, true.d11, true.d22, true.d33) == pytest.approx(
        [x * f for x, f in zip((80.0, 70.0, 100.0, 50.0), factors[2:6], strict=True)]
    )
    q = quadratic * numbers[6]
    assert (true.X_uu, true.Y_vv, true.N_rr) == pytest.approx((q, 5 * factors[4] + 2 * q, 3 * q))


@pytest.mark.parametrize("name", vehicle_names())
def test_added_mass_in_lift_and_surge_loss_scales_with_the_masses(name):
    """What is left of the sums of masses and these terms keeps its share of the masses, zero included."""
    known = vehicle_model(name).vehicle
    mismatch, rng = RandomMismatch((0.5, 2.0), (0.9, 1.3), d11=(0.5, 2.0), d22=(0.5, 2.0)).cut(known), random.Random(0)
    for _ in range(50):
        true = mismatch.draw(rng.random, known)
        for mass, term in (("m11", "Y_ur"), ("m22", "X_vr")):
            growth = getattr(true, mass) / getattr(known, mass)
            assert getattr(true, term) == pytest.approx(growth * getattr(known, term))
        munk, was = true.m22 - true.m11, known.m22 - known.m11
        assert (munk - true.N_uv) / munk == pytest.approx((was - known.N_uv) / was)
    if name == "remus100":
        assert known.m22 - known.m11 == pytest.approx(known.N_uv)


@given(st.lists(st.floats(0.1, 3.0), min_size=3, max_size=3), st.floats(0, 30))
def test_limited_waves_drawn_as_rows_are_those_drawn_one_by_one(speeds, most):
    waves = RandomWaves(0.3, 0.2, 0.12, most_yaw=most)
    rows = waves.draw(lambda: np.full(3, 0.5), np.array(speeds), PAPER_VEHICLE)
    for k, speed in enumerate(speeds):
        one = waves.draw(lambda: 0.5, speed, PAPER_VEHICLE)
        assert (one.surge, one.sway, one.yaw) == (rows.surge[k], rows.sway[k], rows.yaw[k])
        assert one.yaw == pytest.approx(min(0.12 * 50.0 * speed, most * speed**2))


def test_a_mismatch_of_zero_is_the_vehicle():
    assert RandomMismatch().draw(random.Random(0).random, PAPER_VEHICLE) == PAPER_VEHICLE


@given(st.floats(-5, 5), st.floats(0, 5), units)
def test_a_draw_uses_one_number_and_is_in_its_interval(low, width, number):
    numbers = iter((number, 0.5))
    assert low <= draw((low, low + width), numbers.__next__) <= low + width
    assert draw(low, numbers.__next__) == low
    assert next(numbers, None) is None


def test_mismatch_with_too_small_mass_in_sway_is_refused():
    with pytest.raises(ValueError, match=r"mismatch ratio may fall to 0.8; .* at least 0.8194"):
        Scenario(mismatch=RandomMismatch(ratio=(0.8, 1.2)))


def test_every_draw_about_a_vehicle_with_cross_flow_takes_power():
    crossed = replace(PAPER_VEHICLE, Y_vv=100.0, N_rr=50.0, X_vv=10.0, Y_rv=-30.0, N_vv=30.0, N_vr=-20.0)
    mismatch, rng = RandomMismatch(d11=(0.5, 2.0), d22=(0.3, 3.0), d33=(0.3, 3.0)), np.random.default_rng(0)
    drawn = [mismatch.draw(rng.random, crossed) for _ in range(200)]
    loss = [v.X_vv for v in drawn]
    assert max(loss) > 15
    assert min(loss) < 7
    for vehicle in drawn:
        Vehicle(*vehicle.coefficients, **vehicle.cross_terms._asdict())  # is not refused
    bound = fastest_rate(mismatch.extremes(crossed), (250.0, 0.0, 100.0)).max()
    rates = fastest_rate(tuple(np.array([v.acting for v in drawn]).T), (250.0, 0.0, 100.0))
    assert (rates <= bound * (1 + 1e-12)).all()
