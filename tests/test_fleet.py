"""Published vehicles: their numbers from the sources' own, what becomes of a scenario, and plans that they follow."""

import inspect
import math
import os
import random
import re
from dataclasses import fields, replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from matrix_form import matrix_form

from auv_gym import PRESETS, Scenario, list_vehicles
from auv_gym.actuators import LEAST_SHARE, Actuators
from auv_gym.disturbances import RandomCurrent, RandomWaves
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.feasibility import InfeasibleReferenceError
from auv_gym.fleet import FOLDER, PAPER, POWERS, Craft, craft, fleet
from auv_gym.paths import PATHS
from auv_gym.planner import plan
from auv_gym.presets import as_scenario
from auv_gym.scenario import RandomPath, Start, as_vehicle
from auv_gym.sensors import Sensors
from auv_gym.task import decode_observation
from auv_gym.vehicle import PAPER_VEHICLE, Vehicle

FLEET = pytest.mark.parametrize("name", fleet())


def lamb(a, b):
    """Added mass of a spheroid in water, as shares of its mass along and across, and of its moment of inertia."""
    e = math.sqrt(1 - (b / a) ** 2)
    alpha = 2 * (1 - e**2) / e**3 * (math.atanh(e) - e)
    beta = 1 / e**2 - (1 - e**2) / e**3 * math.atanh(e)
    turn = e**4 * (beta - alpha) / ((2 - e**2) * (2 * e**2 - (2 - e**2) * (beta - alpha)))
    return alpha / (2 - alpha), beta / (2 - beta), turn


def lauv():
    fins = 2 * 0.5 * 1028 * 0.0064 * 3.0 * 0.4 * math.radians(30)
    spin = 18 * (3 * 0.075**2 + 1.08**2) / 12
    hull = {"m11": 18 + 1, "m22": 18 + 16, "m33": spin + 1.3, "d11": 2.4, "d22": 23, "d33": 9.7}
    return {
        **hull,
        "X_uu": 2.4,
        "Y_vv": 80,
        "N_rr": 9.1,
        "fin": fins,
        "F_u_max": 2.4 * 2 + 2.4 * 4,
        "F_r_max": 4 * fins,
    }


def remus100():
    a, b, rho = 0.8, 0.095, 1026
    m, (k1, k2, k3) = 4 / 3 * math.pi * rho * a * b * b, lamb(a, b)
    m11, m22, m33 = m * (1 + k1), m * (1 + k2), m * (a * a + b * b) / 5 * (1 + k3)
    n, D, J = 1525 / 60, 0.14, 0.944 * 2.5 / (0.14 * 1525 / 60)
    thrust = 0.9 * rho * D**4 * n * n * (0.4566 + (0.1798 - 0.4566) / 0.6632 * J)
    fin = 0.5 * rho * 0.0133 * 0.5 * a * math.radians(15)
    hull = {"m11": m11, "m22": m22, "m33": m33, "d11": m11 / 20, "d22": m22 / 20, "d33": m33, "Y_ur": m11 - m}
    drag = {"X_uu": 0.5 * rho * 0.42 * math.pi * b * b, "N_uv": m22 - m11}
    return {**hull, **drag, "fin": fin, "F_u_max": thrust, "F_r_max": fin * 2.5**2}


def eca_a9():
    fin = 4 * 7.2 * math.sqrt(0.5) * 0.70777 * math.radians(20)
    hull = {
        "m11": 69.7 + 4,
        "m22": 69.7 + 95,
        "m33": 35 + 32,
        "d11": 0.8,
        "d22": 16.2,
        "d33": 3.2,
        "X_uu": 8,
        "Y_uv": 162,
    }
    lift = {"Y_ur": 150, "N_uv": -34, "N_ur": 32}
    return {**hull, **lift, "fin": fin, "F_u_max": 8 * 2.5**2, "F_r_max": fin * 2.5**2}


def nps_auv2():
    m, (r2, r3, r4, r5) = 53400 / 9.81, (0.5 * 1025 * 5.3**n for n in (2, 3, 4, 5))
    m11, m22 = m + 7.6e-3 * r3, m + 5.5e-2 * r3
    cross = 0.5 * 1025 * 0.5 * 0.53
    drag = {
        "X_uu": 0.00385 * r2,
        "Y_vv": cross * 5.3,
        "N_rr": cross * 5.3**4 / 32,
        "Y_uv": 0.1 * r2,
        "N_ur": 1.6e-2 * r4,
    }
    mixed = {"Y_ur": 3e-2 * r3 - (m - m11), "N_uv": -7.4e-3 * r3 + (m22 - m11)}
    fast, fin = 0.012 * 1500 / 60 * 2 * math.pi, 1.3e-2 * r3 * math.radians(20)
    limits = {"fin": fin, "F_u_max": 0.00385 * r2 * fast**2, "F_r_max": fin * fast**2}
    return {"m11": m11, "m22": m22, "m33": 13587 + 3.4e-3 * r5, **drag, **mixed, **limits}


def otter():
    ahead, astern, m, payload = 24.4 * 9.81, 13.6 * 9.81, 55, 25
    x = (m * 0.2 + payload * 0.05) / (m + payload)
    spin = m * 0.5**2 + m * x * x + payload * 0.05**2
    m22, m33 = m + payload + 1.5 * m, spin + (m + payload) * x * x + 1.7 * spin
    drag = {"d11": ahead / (6 * 0.5144), "d22": m22, "d33": m33, "N_rr": 10 * m33 + 61}
    limits = {"F_u_max": ahead, "F_r_max": 0.395 * (ahead + astern) / 2, "astern": astern / ahead}
    return {"m11": m + payload + 0.1 * m, "m22": m22, "m33": m33, **drag, **limits}


def cybership2():
    hull = {"m11": 23.8 + 2, "m22": 23.8 + 10, "m33": 1.76 + 1, "d11": 0.72253, "d22": 0.88965, "d33": 1.9}
    drag = {"X_uu": 1.32742, "Y_vv": 36.47287, "N_rr": 0.75}
    return {**hull, **drag, "F_u_max": 8, "F_r_max": 2.5, "astern": 0.5}


def gunnerus():
    m = 574127.69
    hull = {"m11": m + 26599.24721721, "m22": m + 132619.44, "m33": 41237080 + 13320142}
    drag = {"d11": 1117.59831, "d22": 22288.64, "d33": 1949686.56, "X_uu": 1671.60006965, "Y_vv": 23611.351393}
    return {**hull, **drag, "N_rr": 365427334, "F_u_max": 154273, "F_r_max": 0.6 * 154273 * 15.5600097}


def supply():
    m, L = 6000e3, 76.2
    rate = m * math.sqrt(9.81 / L)
    hull = {"m11": 1.1274 * m, "m22": 1.8902 * m, "m33": 0.1278 * m * L * L}
    return {**hull, "d11": 0.0358 * rate, "d22": 0.1183 * rate, "d33": 0.0308 * rate * L * L}


SOURCES = {
    f.__name__.replace("_", "-"): f for f in (lauv, remus100, eca_a9, nps_auv2, otter, cybership2, gunnerus, supply)
}


@FLEET
def test_numbers_are_those_of_the_source(name):
    mine, theirs = craft(name), SOURCES[name]()
    have = {**vars(mine.vehicle), **vars(mine.actuators)}
    assert {key: have[key] for key in theirs} == pytest.approx(theirs, rel=5e-3)
    assert mine.name == name
    assert all((mine.about, mine.source, mine.left_out, mine.ours))


@FLEET
def test_drag_takes_as_much_of_the_thrust_as_it_does_of_the_papers_vehicle_at_most(name):
    """At cruise, so that current and a wrong model leave as much of it."""
    mine = craft(name)
    share, of_the_paper = (c.drag(c.speed)[0] * c.speed / c.actuators.F_u_max for c in (mine, PAPER))
    assert share < 1.01 * of_the_paper


@FLEET
def test_planned_forces_alone_keep_the_vehicle_on_its_path(name):
    """From the planned state in still water, in the matrix form, by Runge-Kutta steps of h: nothing is left over."""
    mine = craft(name)
    h, turn_rate = 0.02 * mine.time, 0.3 * (mine.turn_rate or 0.12 * PAPER.time / mine.time)
    path = PATHS["sine"].drawn(mine.speed, turn_rate, random.Random(1).random)
    R = plan(
        path, mine.vehicle, h / 2 * np.arange(401), (mine.actuators.F_u_max, mine.actuators.F_r_max), mine.actuators.fin
    )
    table = R.table
    state = table[0, :6]

    def rates(state, k):
        return matrix_form(state, (R.F_u[k], 0.0, R.F_r[k]), mine.vehicle)

    for k in range(0, 400, 2):
        a = rates(state, k)
        b = rates(state + h / 2 * a, k + 1)
        c = rates(state + h / 2 * b, k + 1)
        state = state + h / 6 * (a + 2 * (b + c) + rates(state + h * c, k + 2))
    assert np.abs(state[:2] - table[400, :2]).max() < 1e-6 * mine.length


@FLEET
def test_its_storm_can_be_sailed_in_by_steps_that_are_short_enough(name):
    """Full commands to and fro: no speed leaves what thrust and drag allow."""
    mine, env = craft(name), UnderactuatedAUVTrackEnv(f"cruise-storm@{name}")
    env.reset(seed=0)
    rng, limit = np.random.default_rng(0), 3 * mine.actuators.F_u_max
    for _ in range(40):
        *_, over, _, _ = env.step(rng.choice([-1.0, 1.0], 2))
        u, v, r = np.abs(env.state[3:])
        assert mine.drag(0.5 * u)[0] * u < limit + mine.drag(mine.speed)[0] * mine.speed
        assert v < 5 * mine.speed
        assert r * mine.length < 5 * mine.speed
        if over:
            break


@pytest.mark.parametrize("name", PRESETS)
def test_for_the_papers_vehicle_a_scenario_stays_what_it_is(name):
    assert PAPER.adapted(PRESETS[name]) == PRESETS[name]


def test_the_papers_vehicle_in_other_units_does_the_same():
    """A vehicle twice as long, three times as slow and five times as heavy: the same without dimensions."""
    L, T, M = 2.0, 3.0, 5.0
    v, act = PAPER_VEHICLE, PAPER.actuators
    inertia = {"m11": v.m11 * M, "m22": v.m22 * M, "m33": v.m33 * M * L * L}
    drag = {"d11": v.d11 * M / T, "d22": v.d22 * M / T, "d33": v.d33 * M * L * L / T}
    limits = Actuators(act.F_u_max * M * L / T**2, act.F_r_max * M * L**2 / T**2)
    twin = replace(
        PAPER,
        name="twin",
        vehicle=Vehicle(**inertia, **drag),
        actuators=limits,
        speed=1.5 * L / T,
        turn_rate=0.04,
        lag=0.6,
    )
    storm = replace(
        PRESETS["cruise-storm"], sensors=replace(PRESETS["cruise-storm"].sensors, outages=3.0, low_pass=2.0)
    )
    scenarios = storm, storm.changed(twin)
    assert scenarios[1].control_dt == pytest.approx(T * storm.control_dt)
    envs = [UnderactuatedAUVTrackEnv(s) for s in scenarios]
    for env in envs:
        env.reset(seed=4)
    rng = np.random.default_rng(0)
    units = np.array([L, L, 1, L / T, L / T, 1 / T])
    for _ in range(150):
        action = rng.uniform(-1, 1, 2).astype(np.float32)
        (o, reward, *_), (other, again, *_) = (env.step(action) for env in envs)
        assert again == pytest.approx(reward, abs=1e-7)
        np.testing.assert_allclose(envs[1].state / units, envs[0].state, atol=1e-7)
        one, two = decode_observation(o), decode_observation(other)
        assert two.F_rR / limits.F_r_max == pytest.approx(one.F_rR / act.F_r_max, abs=1e-7)
        assert (two.e_x / L, two.v_e * T / L, two.r_e * T) == pytest.approx((one.e_x, one.v_e, one.r_e), abs=1e-7)


def test_every_entry_with_a_unit_is_scaled_by_it():
    """The units stand behind the fields; speeds and forces that are shares of something have none."""
    powers = {"m": (1, 0), "s": (0, 1), "m/s": (1, -1), "rad/s": (0, -1), "Hz": (0, -1), "1/min": (0, -1), "rad": None}
    for part, cls in {"start": Start, "sensors": Sensors, "current": RandomCurrent, "waves": RandomWaves}.items():
        units = dict(re.findall(r"^    (\w+): .*?# \[(.+?)\]", inspect.getsource(cls), re.MULTILINE))
        found = {name: powers[unit] for name, unit in units.items() if powers[unit]}
        assert found.items() <= POWERS[part].items()
        assert set(POWERS[part]) <= {field.name for field in fields(cls)}
    assert "speed" in {field.name for field in fields(RandomPath)}


FINNED = replace(PRESETS["cruise-calm"], actuators=Actuators(F_r_max=200.0, fin=100.0, astern=0.25))


def test_fins_give_torque_with_the_square_of_the_speed_and_say_so():
    env = UnderactuatedAUVTrackEnv(FINNED)
    for u, torque in ((0.0, 0.0), (0.5, 25.0), (-1.0, 100.0), (2.0, 200.0)):
        o = decode_observation(env.reset(seed=0, options={"initial_velocity": (u, 0.0, 0.0)})[0])
        assert o.F_r_max == pytest.approx(max(torque, LEAST_SHARE * 200.0))
        env.step(np.array([-1.0, 0.5], dtype=np.float32))
        np.testing.assert_allclose(env.force, (-100.0, 0.5 * torque))


def test_plan_that_fins_cannot_steer_is_refused():
    path, times = PATHS["circle"](0.5, 0.2), 0.1 * np.arange(100)
    R = plan(path, PAPER_VEHICLE, times)
    needed = abs(R.F_r[0]) / R.u[0] ** 2
    plan(path, PAPER_VEHICLE, times, (400.0, 200.0), 1.001 * needed)
    with pytest.raises(InfeasibleReferenceError, match=r"F_r = .* is beyond its limit of"):
        plan(path, PAPER_VEHICLE, times, (400.0, 200.0), 0.999 * needed)


def test_ships_have_wider_bounds_and_the_same_scales():
    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario="cruise-storm", vehicle="supply")
    observation, _ = env.reset(seed=0)
    span = env.unwrapped.scenario.span
    assert span == 2 ** round(math.log2(span))
    assert decode_observation(observation).F_u_max == pytest.approx(590000.0)
    assert env.observation_space.contains(observation)
    assert env.observation_space.high[0] == 64.0 * span
    assert env.observation_space.high[3] == 32.0


def test_vehicle_by_name_and_file(tmp_path):
    assert list_vehicles() == ["paper", *fleet()]
    assert as_vehicle("lauv") == craft("lauv").vehicle
    file = tmp_path / "mine.toml"
    file.write_text(
        (FOLDER / "lauv.toml").read_text(encoding="utf-8").replace('name = "lauv"', 'name = "mine"'), encoding="utf-8"
    )
    mine = PRESETS["cruise-storm"].changed(str(file))
    assert mine == replace(as_scenario("cruise-storm@lauv"), name="cruise-storm@mine")
    assert Scenario.from_dict(mine.to_dict()) == mine
    assert Craft.load(Path(file)).vehicle == craft("lauv").vehicle


@pytest.mark.parametrize(
    ("scenario", "says"),
    [
        ("cruise-storm@nautilus", "unknown vehicle 'nautilus'; .* one of paper, cybership2, .*lauv"),
        ("slow-storm@lauv", "asks for 0.056 m/s of this vehicle, whose fins steer it from 0.25 m/s on"),
        ("storm@lauv", "unknown scenario 'storm@lauv'"),
    ],
)
def test_what_there_is_not_is_refused(scenario, says):
    with pytest.raises(ValueError, match=says):
        as_scenario(scenario)


def test_wrong_file_is_refused(tmp_path):
    (tmp_path / "wrong.toml").write_text("speed = 1.0\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"wrong.toml: vehicle file lacks the entry 'name'"):
        PRESETS["cruise-calm"].changed(str(tmp_path / "wrong.toml"))


PAGE = Path(__file__).parents[1] / "docs/vehicles.md"


def row(mine):
    v, act, U = mine.vehicle, mine.actuators, mine.speed
    torque = min(act.F_r_max, act.fin * U * U) if act.fin else act.F_r_max
    lag = 0.2 * mine.time / PAPER.time if mine.lag is None else mine.lag
    _, sway, yaw = mine.drag(U)
    numbers = (
        mine.length,
        U,
        act.F_u_max,
        torque,
        lag,
        v.m22 / v.m11,
        sway / v.m22,
        yaw / v.m33,
        torque / v.m11 / U**2,
    )
    return [f"`{mine.name}`", mine.about, *(f"{number:.3g}" for number in numbers)]


def fleet_tables():
    every = [PAPER, *map(craft, fleet())]
    names = [
        "name",
        "what",
        "L [m]",
        "speed [m/s]",
        "thrust [N]",
        "torque [N m]",
        "lag [s]",
        "m22/m11",
        "sway drag",
        "yaw drag",
    ]
    names.append("yaw torque")
    first = [names, ["---"] * len(names), *map(row, every)]
    known = [[f"`{c.name}`", c.source, c.left_out, c.ours] for c in every[1:]]
    second = [["name", "source", "left out", "ours"], ["---"] * 4, *known]
    return "\n\n".join("\n".join(f"| {' | '.join(cells)} |" for cells in table) for table in (first, second))


def test_page_shows_the_fleet():
    text = PAGE.read_text(encoding="utf-8")
    start, end = re.search(r"<!-- the fleet.*-->\n", text).end(), text.index("<!-- end of the fleet -->")
    if os.environ.get("REFRESH_DOCS"):
        PAGE.write_text(f"{text[:start]}\n{fleet_tables()}\n\n{text[end:]}", encoding="utf-8")
    else:
        assert text[start:end].strip() == fleet_tables()
