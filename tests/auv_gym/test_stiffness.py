"""Integration steps that are too long for a vehicle are refused before the integration diverges."""

from dataclasses import replace

import numpy as np
import pytest

from auv_gym.effects.mismatch import RandomMismatch
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.physics.dynamics import rates
from auv_gym.physics.stiffness import AT_REST, MAX_STIFFNESS, fastest_rate
from auv_gym.physics.vehicle import PAPER_VEHICLE, Coefficients, CrossTerms, Vehicle
from auv_gym.scenarios.presets import PRESETS, as_scenario
from auv_gym.scenarios.vehicles import vehicle_names

STIFF = Vehicle(m11=30.0, m22=60.0, m33=4.0, d11=20.0, d22=60.0, d33=60.0)
CALM = PRESETS["slow-calm"]


def test_stiff_vehicle_needs_substeps():
    with pytest.raises(ValueError, match=r"is 0.2 s; it must be at most 0.133 s .* raise substeps"):
        replace(CALM, vehicle=STIFF)
    env = UnderactuatedAUVTrackEnv(replace(CALM, vehicle=STIFF, substeps=2))
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(50):
        env.step(rng.uniform(-0.1, 0.1, 2))
        assert np.abs(env.state[3:]).max() < 5


@pytest.mark.parametrize(
    ("changes", "limits", "cause"),
    [
        ({"d33": 2900.0}, {}, r"d33/m33 is 36.2 1/s: are its units kg, m, s\?"),
        ({"m11": 0.2, "m22": 0.3, "m33": 0.08}, {}, r"d33/m33 is 625 1/s: are its units kg, m, s\?"),
        ({}, {"F_u_max": 4e5}, r"4e\+05 N act on 215 kg, 50 N m on 80 kg m\^2: are these limits right\?"),
    ],
    ids=str,
)
def test_what_makes_a_vehicle_stiff_is_named(changes, limits, cause):
    actuators = replace(CALM.actuators, **limits)
    with pytest.raises(ValueError, match=f"so raise substeps or lower control_dt; {cause}"):
        replace(CALM, vehicle=replace(PAPER_VEHICLE, **changes), actuators=actuators)


def test_the_stiffest_vehicle_of_a_mismatch_is_checked():
    with pytest.raises(ValueError, match="raise substeps"):
        replace(CALM, mismatch=RandomMismatch(m33=(0.01, 1.0)))
    with pytest.raises(ValueError, match="raise substeps"):
        replace(CALM, mismatch=RandomMismatch(quadratic=(0.0, 10.0)))
    replace(CALM, mismatch=RandomMismatch(quadratic=(0.0, 10.0)), substeps=10)


@pytest.mark.parametrize("name", ["paper", *vehicle_names()])
@pytest.mark.parametrize("mass", [(0.8, 1.2), (0.5, 2.0)], ids=str)
def test_extremes_are_at_least_as_stiff_as_all_draws(name, mass):
    scenario = PRESETS["cruise-storm"] if name == "paper" else as_scenario(f"cruise-storm@{name}")
    mismatch, vehicle, act = replace(scenario.mismatch, mass=mass), scenario.vehicle, scenario.actuators
    rng, load = np.random.default_rng(0), (act.F_u_max, 0.0, act.F_r_max)
    bound = fastest_rate(mismatch.extremes(vehicle), load).max()
    drawn = [mismatch.draw(rng.random, vehicle).all_coefficients for _ in range(300)]
    rates = fastest_rate(tuple(np.array(drawn).T), load)
    assert (rates <= bound * (1 + 1e-12)).all()
    assert rates.max() > 0.5 * bound


def test_the_extremes_of_a_mismatch_without_intervals_are_the_one_draw():
    factors = {"mass": 0.9, "ratio": 1.1, "m33": 0.8, "d11": 1.2, "d22": 0.7, "d33": 1.3, "quadratic": 0.4}
    mismatch, more = RandomMismatch(**factors), {"Y_uv": 40.0, "Y_ur": 5.0, "N_uv": 5.0, "N_ur": 20.0, "Y_vr": 3.0}
    vehicle = replace(PAPER_VEHICLE, X_uu=40.0, Y_vv=150.0, N_rr=60.0, **more)
    drawn = mismatch.draw(np.random.default_rng(0).random, vehicle).all_coefficients
    np.testing.assert_allclose(mismatch.extremes(vehicle), np.repeat(np.array([drawn]).T, 64, axis=1), rtol=1e-14)


def test_fast_starts_and_other_vehicles_are_checked_before_anything_changes():
    env = UnderactuatedAUVTrackEnv(replace(CALM, mismatch=RandomMismatch(quadratic=1.0)))
    before = env.reset(seed=3)[0]
    with pytest.raises(ValueError, match="raise substeps"):
        env.reset(options={"initial_velocity": (0.0, 1e3, 0.0)})
    env = UnderactuatedAUVTrackEnv(CALM)
    episode = CALM.draw(np.random.default_rng(0))
    with pytest.raises(ValueError, match="raise substeps"):
        env.reset(options={"episode": replace(episode, vehicle=STIFF)})
    assert (env.reset(seed=3)[0] == before).sum() >= 6


def test_cross_terms_of_zero_raise_the_bound_by_a_factor_of_two_at_most():
    vehicle = Coefficients(*np.random.default_rng(1).uniform(10, 20, (13, 5)))
    zero = CrossTerms(*np.zeros((len(CrossTerms._fields), 5)))
    with_them, without = (fastest_rate(row, (9.0, 0.0, 9.0)) for row in ((*vehicle, *zero), vehicle))
    assert (with_them >= without).all()
    assert (with_them <= 2 * without).all()


@pytest.mark.parametrize("name", ["Y_rv", "Y_vr", "N_rv", "N_vr"])
def test_damping_by_cross_flow_is_a_derivative_of_the_equations(name):
    vehicle = 200.0, 260.0, 80.0, 70.0, 100.0, 50.0, *np.zeros(7)
    vehicle += CrossTerms(*np.zeros(12))._replace(**{name: 3000.0})
    v, r, h = 2.0, 0.7, 1e-6
    ahead, astern, left, right = (
        rates(0.0, 0.0, *at, AT_REST, vehicle)[3:] for at in ((v + h, r), (v - h, r), (v, r + h), (v, r - h))
    )
    decay = max((astern[0] - ahead[0]) / (2 * h), (right[1] - left[1]) / (2 * h))
    assert decay <= fastest_rate(vehicle, AT_REST, (0.0, v, r)) < 1.1 * decay


@pytest.mark.slow
@pytest.mark.parametrize("crossed", [False, True])
def test_no_vehicle_within_the_bound_diverges(crossed):
    """Random vehicles with alternating full thrust: speeds are less than a few times the steady ones."""
    from auv_gym.physics.dynamics import rk4_step

    rng, n = np.random.default_rng(0), 20_000
    low = np.array([5, 5, 1, 1, 1, 1, 0.1, 0.1, 0.1, 5, 2, 0.02])
    high = np.array([500, 500, 300, 500, 500, 500, 500, 500, 500, 800, 400, 0.5])
    m11, _, *rest = np.exp(rng.uniform(np.log(low), np.log(high), (n, 12))).T
    *middle, F_u, F_r, dt = rest
    size, arm = np.exp(rng.uniform(np.log(0.1), np.log(500), n)), rng.uniform(0.0, 1.0, n)
    lift = size, size * arm, size * arm, size * arm**2  # of one fin, which dissipates energy
    bare = Coefficients(m11, m11 * rng.uniform(1.02, 3, n), *middle, *lift)
    coefficients = (*bare, *(_strips(bare, rng) if crossed else ()))
    chosen = fastest_rate(coefficients, (F_u, 0 * F_u, F_r)) * dt < MAX_STIFFNESS
    coefficients, F_u, F_r, dt = [c[chosen] for c in coefficients], F_u[chosen], F_r[chosen], dt[chosen]
    assert chosen.sum() > 3000
    d11, d33 = coefficients[3], coefficients[5]
    state = tuple(np.zeros(chosen.sum()) for _ in range(6))
    for k in range(400):
        if k % 5 == 0:
            a_u, a_r = rng.choice([-1, 0, 1], (2, chosen.sum()))
        state = rk4_step(state, (a_u * F_u, 0.0, a_r * F_r), coefficients, dt, ns=np)
        assert np.isfinite(state[3:]).all()
    power = F_u**2 / d11 + F_r**2 / d33
    assert (np.abs(state[3]) < 5 * np.sqrt(power / d11)).all()


def _strips(c, rng):
    """Return cross terms of random size and sign that take no more than the damping of sway and yaw gives."""
    size = np.cbrt(c.N_rr / c.Y_vv)
    odd_v, odd_r, Y_rv, N_vr = rng.uniform(-1, 1, (4, len(size))) * c.Y_vv * [size, size**2, size, size**2]
    share = rng.uniform(0.0, 1.0, (2, len(size)))
    surge = rng.uniform(0, 0.3, len(size)) * c.d22 / 5.0, rng.uniform(-0.5, 0.5, len(size)) * c.m22, 0.2 * c.m11 * size
    linear = rng.uniform(-0.9, 0.9, (2, len(size))) * np.sqrt(c.d22 * c.d33)
    quadratic = Y_rv, share[0] * odd_v, share[1] * odd_r, (1 - share[0]) * odd_v, (1 - share[1]) * odd_r, N_vr
    return CrossTerms(*surge, *quadratic, *linear, rng.uniform(0.0, 1.5, len(size)) * np.sqrt(c.m33 / c.m22))
