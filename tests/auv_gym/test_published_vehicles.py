"""Published vehicles: comparison with their sources, adapted scenarios, and plans."""

import inspect
import math
import random
import re
from dataclasses import fields, replace

import gymnasium as gym
import numpy as np
import pytest
from matrix_form import matrix_form
from scipy.integrate import solve_ivp
from vehicle_sources import SOURCES

from auv_gym import PRESETS, Scenario, decode_observation, list_vehicles
from auv_gym.effects.actuators import LEAST_SHARE, Actuators
from auv_gym.effects.current import RandomCurrent
from auv_gym.effects.navigation import RandomReckoning
from auv_gym.effects.sensors import Sensors
from auv_gym.effects.waves import RandomWaves
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.units import Units
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.planning.feasibility import InfeasibleReferenceError
from auv_gym.planning.paths import PATHS
from auv_gym.planning.planner import plan
from auv_gym.scenarios.fitting import FIN_OFFSETS, FIN_SURGE, FIN_WAVES, Sea, adapted, changed, in_vehicle_units
from auv_gym.scenarios.presets import CASES, as_scenario
from auv_gym.scenarios.scenario import RandomPath, Start
from auv_gym.scenarios.vehicles import PAPER, VEHICLES_FOLDER, VehicleModel, as_vehicle, vehicle_model, vehicle_names
from auv_gym.scenarios.vehicles.scaling import SCENARIO_POWERS

VEHICLE_NAMES = pytest.mark.parametrize("name", vehicle_names())


@VEHICLE_NAMES
def test_numbers_equal_those_of_the_source(name):
    mine, theirs = vehicle_model(name), SOURCES[name]()
    have = {**vars(mine.vehicle), **vars(mine.actuators)}
    assert {key: have[key] for key in theirs} == pytest.approx(theirs, rel=5e-3)
    assert mine.name == name
    assert all((mine.about, mine.source, mine.left_out, mine.assumed))


@VEHICLE_NAMES
def test_drag_over_thrust_is_at_most_that_of_the_paper(name):
    """At cruise, so the margin of thrust for a current or model error is at least that of the paper."""
    mine = vehicle_model(name)
    share, of_the_paper = (c.drag(c.vehicle.speed)[0] * c.vehicle.speed / c.actuators.F_u_max for c in (mine, PAPER))
    assert share < 1.01 * of_the_paper


@VEHICLE_NAMES
def test_planned_forces_keep_the_vehicle_on_its_path(name):
    """In still water, by Runge-Kutta steps of the matrix form about the origin, with the side force of a rudder."""
    mine = vehicle_model(name)
    h, turn_rate = 0.02 * mine.vehicle.time, 0.3 * (mine.turn_rate or 0.12 * PAPER.vehicle.time / mine.vehicle.time)
    path = PATHS["sine"].drawn(mine.vehicle.speed, turn_rate, random.Random(1).random)
    R = plan(
        path, mine.vehicle, h / 2 * np.arange(401), (mine.actuators.F_u_max, mine.actuators.F_r_max), mine.actuators.fin
    )
    table, v = R.table, mine.vehicle

    def point(state, ahead):
        x, y, psi, u, sway, r = state
        return np.array((x + ahead * np.cos(psi), y + ahead * np.sin(psi), psi, u, sway + ahead * r, r))

    def rates(state, k):
        return matrix_form(state, (R.F_u[k], -R.F_r[k] * v.eps * v.m22 / v.m33, R.F_r[k]), v)

    state = point(table[0, :6], -v.eps)

    for k in range(0, 400, 2):
        a = rates(state, k)
        b = rates(state + h / 2 * a, k + 1)
        c = rates(state + h / 2 * b, k + 1)
        state = state + h / 6 * (a + 2 * (b + c) + rates(state + h * c, k + 2))
    assert np.abs(point(state, v.eps)[:2] - table[400, :2]).max() < 1e-6 * v.length


@pytest.mark.parametrize("name", ["lauv", "nps-auv2", "remus100"])
def test_waves_act_on_the_origin_and_rudders_with_their_side_force(name):
    """Compared with DOP853 on the matrix form about the origin, where only the rudder's torque has a side force."""
    scenario = replace(changed(PRESETS["cruise-waves"], name), control_dt=0.02 * vehicle_model(name).vehicle.time)
    v, dt = scenario.vehicle, scenario.control_dt
    env = UnderactuatedAUVTrackVectorEnv(1, scenario)
    env.reset(seed=2)

    def ahead(state):
        _, _, psi, _, _, r = state
        return v.eps * np.array((np.cos(psi), np.sin(psi), 0, 0, r, 0))

    state, rng, turned = env.state[0] - ahead(env.state[0]), np.random.default_rng(0), 0.0
    for _ in range(150):
        env.step(rng.uniform(-1, 1, (1, 2)).astype(np.float32))
        (F_u, F_r), (X, Y, N) = env.force[0], env.load[0]
        turned = max(turned, abs(N))
        tau = F_u + X, Y - F_r * v.eps * v.m22 / v.m33, F_r + N
        run = solve_ivp(lambda _, z, f=tau: matrix_form(z, f, v), (0, dt), state, "DOP853", rtol=1e-10, atol=1e-12)
        state = run.y[:, -1]
    np.testing.assert_allclose(env.state[0], state + ahead(state), atol=1e-6 * v.length)
    assert turned > 0.01 * scenario.actuators.F_r_max


def is_finned(name):
    return vehicle_model(name).actuators.fin > 0


@pytest.mark.parametrize("case", ["waves", "storm"])
@pytest.mark.parametrize("name", [name for name in vehicle_names() if is_finned(name)])
def test_waves_are_limited_to_a_share_of_the_torque_of_fins(name, case):
    """Each episode by its path speed, with the same factor on all axes; without the limit it is the harder sea."""
    limited = as_scenario(f"cruise-{case}@{name}")
    harder = replace(limited, waves=replace(limited.waves, most_yaw=math.inf), substeps=64)
    act, shares = limited.actuators, []
    for seed in range(50):
        one, other = (scenario.draw(np.random.default_rng(seed)) for scenario in (limited, harder))
        U = one.path.speed
        shares.append(one.waves.yaw / min(act.fin * U**2, act.F_r_max))
        factors = [getattr(one.waves, axis) / getattr(other.waves, axis) for axis in ("surge", "sway", "yaw")]
        assert max(factors) - min(factors) < 1e-12
        assert max(factors) == 1.0 or shares[-1] == pytest.approx(FIN_WAVES)
        assert other.waves.yaw == pytest.approx(limited.waves.yaw * limited.vehicle.d33 * U)
    assert max(shares) <= FIN_WAVES * (1 + 1e-12)


@pytest.mark.parametrize("name", vehicle_names())
def test_a_vehicle_with_fins_starts_at_a_speed_at_which_they_act(name):
    L = Units.of(vehicle_model(name).vehicle).length
    for preset in ("cruise-calm", "cruise-storm", "paper-circle"):
        theirs, mine = PRESETS[preset].start, as_scenario(f"{preset}@{name}").start
        least = FIN_SURGE if is_finned(name) else -math.inf
        factor = FIN_OFFSETS if is_finned(name) else 1.0
        for entry, scale in (("x_e", L), ("y_e", L), ("psi_e", 1.0)):
            np.testing.assert_allclose(getattr(mine, entry), np.multiply(getattr(theirs, entry), scale * factor))
        np.testing.assert_allclose(mine.surge, np.maximum(theirs.surge, least))


@pytest.mark.parametrize("name", PRESETS)
def test_for_the_vehicle_of_the_paper_a_scenario_does_not_change(name):
    assert adapted(PAPER, PRESETS[name]) == PRESETS[name]


@pytest.mark.parametrize(
    "sensors",
    [{"outages": 3.0, "low_pass": 2.0, "correlation": (1.0, 4.0)}, {"reckoning": RandomReckoning((5.0, 9.0))}],
    ids=str,
)
def test_the_vehicle_of_the_paper_in_other_units(sensors):
    """A vehicle twice as long, three times as slow and five times as heavy has the same dimensionless motion."""
    L, T, M = 2.0, 3.0, 5.0
    v, act = PAPER_VEHICLE, PAPER.actuators
    inertia = {"m11": v.m11 * M, "m22": v.m22 * M, "m33": v.m33 * M * L * L}
    drag = {"d11": v.d11 * M / T, "d22": v.d22 * M / T, "d33": v.d33 * M * L * L / T}
    limits = Actuators(act.F_u_max * M * L / T**2, act.F_r_max * M * L**2 / T**2)
    twin = replace(
        PAPER,
        name="twin",
        vehicle=Vehicle(**inertia, **drag, speed=1.5 * L / T),
        actuators=limits,
        turn_rate=0.04,
        lag=0.6,
    )
    storm = replace(PRESETS["cruise-storm"], sensors=replace(PRESETS["cruise-storm"].sensors, **sensors))
    scenarios = storm, changed(storm, twin)
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


def test_each_entry_with_a_unit_is_scaled():
    """The units are in the comments of the fields; relative speeds and forces have none."""
    powers = {"m": (1, 0), "s": (0, 1), "m/s": (1, -1), "rad/s": (0, -1), "Hz": (0, -1), "1/min": (0, -1)}
    powers |= {"rad/sqrt(s)": (0, -0.5), "rad": None, "kg": (0, 0, 1)}
    classes = {"start": Start, "sensors": Sensors, "reckoning": RandomReckoning}
    for part, cls in {**classes, "current": RandomCurrent, "waves": RandomWaves}.items():
        units = dict(re.findall(r"^    (\w+): .*?# \[(.+?)\]", inspect.getsource(cls), re.MULTILINE))
        found = {name: powers[unit] for name, unit in units.items() if powers[unit]}
        assert found.items() <= SCENARIO_POWERS[part].items()
        assert set(SCENARIO_POWERS[part]) <= {field.name for field in fields(cls)}
    assert "speed" in {field.name for field in fields(RandomPath)}


FINNED = replace(PRESETS["cruise-calm"], actuators=Actuators(F_r_max=200.0, fin=100.0, astern=0.25))


def test_torque_of_fins_is_quadratic_in_the_speed_and_observed():
    env = UnderactuatedAUVTrackEnv(FINNED)
    for u, torque in ((0.0, 0.0), (0.5, 25.0), (-1.0, 100.0), (2.0, 200.0)):
        o = decode_observation(env.reset(seed=0, options={"initial_velocity": (u, 0.0, 0.0)})[0])
        assert o.F_r_max == pytest.approx(max(torque, LEAST_SHARE * 200.0))
        env.step(np.array([-1.0, 0.5], dtype=np.float32))
        np.testing.assert_allclose(env.force, (-100.0, 0.5 * torque))


def test_a_plan_beyond_the_torque_of_fins_is_refused():
    path, times = PATHS["circle"](0.5, 0.2), 0.1 * np.arange(100)
    R = plan(path, PAPER_VEHICLE, times)
    needed = abs(R.F_r[0]) / R.u[0] ** 2
    plan(path, PAPER_VEHICLE, times, (400.0, 200.0), 1.001 * needed)
    with pytest.raises(InfeasibleReferenceError, match=r"F_r = .* is beyond its limit of"):
        plan(path, PAPER_VEHICLE, times, (400.0, 200.0), 0.999 * needed)


def test_ships_have_wider_bounds_and_the_same_scales():
    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario="cruise-storm", vehicle="supply")
    observation, _ = env.reset(seed=0)
    bound_factor = env.unwrapped.scenario.bound_factor
    assert bound_factor == 2 ** round(math.log2(bound_factor))
    assert decode_observation(observation).F_u_max == pytest.approx(590000.0)
    assert env.observation_space.contains(observation)
    assert env.observation_space.high[0] == 64.0 * bound_factor
    assert env.observation_space.high[3] == 32.0


@pytest.mark.parametrize("name", ["mine.toml", "Mine.TOML"])
def test_vehicle_by_name_and_file(tmp_path, name):
    assert list_vehicles() == ["paper", "paper-2007", *vehicle_names()]
    assert as_vehicle("lauv") == vehicle_model("lauv").vehicle
    file, lauv = tmp_path / name, (VEHICLES_FOLDER / "lauv.toml").read_text(encoding="utf-8")
    file.write_text(lauv.replace('name = "lauv"', 'name = "mine"'), encoding="utf-8")
    mine = changed(PRESETS["cruise-storm"], str(file))
    assert mine == changed(PRESETS["cruise-storm"], file) == as_scenario(f"cruise-storm@{file}")
    assert mine == replace(as_scenario("cruise-storm@lauv"), name="cruise-storm@mine")
    assert Scenario.from_dict(mine.to_dict()) == mine
    assert VehicleModel.load(file).vehicle == vehicle_model("lauv").vehicle
    file.write_text(lauv.replace("m33 = 3.075", "m33 = 4.0"), encoding="utf-8")  # in the same session
    assert as_vehicle(str(file)) == vehicle_model(str(file)).vehicle == replace(mine.vehicle, m33=4.0)


@pytest.mark.parametrize(
    ("scenario", "message"),
    [
        ("space-calm@otter", "otter is a surface vessel: scenarios in space are for vehicles that dive"),
        ("cruise-storm@nautilus", "unknown vehicle 'nautilus'; .* one of paper, paper-2007, cybership2, .*lauv"),
        ("slow-storm@lauv", "speeds from 0.056 m/s, but the fins of this vehicle need at least 0.25 m/s"),
        ("storm@lauv", "unknown scenario 'storm@lauv'"),
    ],
)
def test_unknown_vehicles_and_scenarios_are_refused(scenario, message):
    with pytest.raises(ValueError, match=message):
        as_scenario(scenario)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('name = "lauv"', "", "vehicle file lacks the entry 'name'"),
        ("speed = 0.84", "", r"the table \[vehicle\] lacks the entry 'speed'; .* the fastest cruise speed \[m/s\]"),
        ("F_u_max = 14.4", "", r"the table \[actuators\] lacks the entry 'F_u_max'; .* limits F_u_max \[N\]"),
        (
            "speed = 0.84",
            "speed = 3 #",
            "3 m/s needs 28.8 N, but F_u_max is 14.4 N, which holds 2 m/s; lower the speed",
        ),
        (
            "[actuators]",
            "[actuators]\nlag = 0.3",
            r"vehicle actuators lag is 0.3; allowed are F_u_max, .*: write lag before \[vehicle\]",
        ),
        (
            "[actuators]",
            "[actuators]\nF_u_rate = 9.0",
            "vehicle actuators F_u_rate is 9.0; .*: F_u_rate is an entry of scenarios",
        ),
        (
            "[actuators]",
            "[sensors]\n[actuators]",
            "is empty; give at least one of position, heading, velocity, yaw_rate",
        ),
        (
            "[actuators]",
            "[sensors]\noutages = 1.0\n[actuators]",
            "sensors has no entry 'outages'; allowed are position, ",
        ),
        ("[actuators]", "[sensors]\nheading = -0.1\n[actuators]", "sensors heading is -0.1; it must be a number in"),
    ],
)
def test_wrong_file_is_refused(tmp_path, old, new, message):
    lauv = (VEHICLES_FOLDER / "lauv.toml").read_text(encoding="utf-8")
    (tmp_path / "wrong.toml").write_text(lauv.replace(old, new), encoding="utf-8")
    with pytest.raises(ValueError, match=rf"wrong.toml: .*{message}"):
        changed(PRESETS["cruise-calm"], str(tmp_path / "wrong.toml"))


@pytest.mark.parametrize("vehicle", ["otter", "lauv", "paper", vehicle_model("otter")], ids=str)
def test_a_scenario_is_adapted_only_once(vehicle):
    mine = as_scenario("cruise-calm@otter")
    with pytest.raises(ValueError, match="'cruise-calm@otter' has its own vehicle, so it cannot be adapted to another"):
        changed(mine, vehicle)
    heavy = replace(mine.vehicle, m33=50.0)
    assert changed(mine, heavy).lost_distance == changed(mine, control_dt=0.1).lost_distance == mine.lost_distance


@pytest.mark.parametrize("name", ["lauv", "gunnerus"])
@pytest.mark.parametrize(
    "sensors",
    [{"outages": 3.0, "low_pass": 2.0, "correlation": (1.0, 4.0)}, {"reckoning": RandomReckoning((5.0, 9.0))}],
    ids=str,
)
def test_a_scenario_in_the_units_of_its_vehicle(name, sensors):
    """The same actions give the same states in lengths and times of the vehicle."""
    storm = PRESETS["cruise-storm"]
    there = changed(replace(storm, sensors=replace(storm.sensors, **sensors)), vehicle_model(name))
    here, units = in_vehicle_units(there), Units.of(vehicle_model(name).vehicle)
    L, T = units.length, units.time
    assert Units.of(here.vehicle) == Units()
    envs = [UnderactuatedAUVTrackEnv(scenario) for scenario in (here, there)]
    for env in envs:
        env.reset(seed=4)
    rng, own = np.random.default_rng(0), np.array([L, L, 1, L / T, L / T, 1 / T])
    for _ in range(150):
        action = rng.uniform(-0.3, 0.9, 2).astype(np.float32)
        rewards = [env.step(action)[1] for env in envs]
        assert rewards[0] == pytest.approx(rewards[1], abs=1e-6)
        np.testing.assert_allclose(envs[1].state / own, envs[0].state, atol=1e-6)


def test_a_scenario_of_the_vehicle_of_the_paper_does_not_change():
    for name in ("cruise-storm", "paper-circle"):
        assert in_vehicle_units(PRESETS[name]) is PRESETS[name]
    with pytest.raises(ValueError, match=r"'paper-circle@lauv' has a fixed path, .*; give it random paths"):
        in_vehicle_units(changed(PRESETS["paper-circle"], "lauv"))


@pytest.mark.parametrize("case", CASES)
def test_a_sea_replaces_current_and_waves(case):
    scenario = changed(PRESETS[f"cruise-{case}"], "lauv")
    assert Sea().of(scenario) is scenario
    still = Sea((0.0, 0.0), 0.0).of(scenario)
    assert (still.current, still.waves, still.name) == (None, None, f"cruise-{case}-sea@lauv")
    rough = Sea((0.4, 0.5), 2.0).of(scenario)
    for seed in range(20):
        mine, before = (s.draw(np.random.default_rng(seed)) for s in (rough, scenario))
        assert 0.4 <= np.hypot(mine.current.V_x, mine.current.V_y) <= 0.5
        if mine.waves is not None:
            assert mine.waves.sway == pytest.approx(2 * before.waves.sway)
    assert replace(rough, name="same", current=None, waves=None) == replace(
        scenario, name="same", current=None, waves=None
    )
    assert (rough.waves is None) == (scenario.waves is None)
    usual = scenario.current or RandomCurrent()
    assert rough.current.gust == pytest.approx(usual.gust * np.mean(scenario.path.speed))
    assert replace(rough, model=None).known == scenario.vehicle
    assert rough.known == scenario.known


@pytest.mark.parametrize(("entries", "message"), [({"current": (0.3, 0.1)}, "current speed"), ({"waves": -1}, "waves")])
def test_a_wrong_sea_is_refused(entries, message):
    with pytest.raises(ValueError, match=message):
        Sea(**entries)
