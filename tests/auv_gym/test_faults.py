"""Faults of actuators and measurements: their draws, and their effect on the simulation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from auv_gym import decode_observation
from auv_gym.effects.faults import FAULT_KINDS, Fault, RandomFaults, fault_rows
from auv_gym.effects.navigation import RandomReckoning
from auv_gym.effects.sensors import Sensors
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.physics.units import Units
from auv_gym.planning.paths import Line
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario, Start
from auv_gym.scenarios.vehicles import vehicle_model

STORM = PRESETS["cruise-storm"]
BEGIN, END = 20, 40  # control steps
CALM = replace(PRESETS["cruise-calm"], faults=RandomFaults(("yaw dead",)))


def run(scenario, *faults, steps=60, seed=3):
    """Return the observations and the actuator forces of an episode with given faults, steered by fixed commands."""
    env = UnderactuatedAUVTrackEnv(scenario)
    episode = scenario.draw(np.random.default_rng(seed))
    observation, _ = env.reset(seed=0, options={"episode": replace(episode, faults=faults)})
    seen, forces, rng = [observation], [], np.random.default_rng(0)
    for _ in range(steps):
        observation, *_ = env.step(rng.uniform(-0.5, 0.5, 2).astype(np.float32))
        seen.append(observation)
        forces.append(env.unwrapped.force)
    return decode_observation(np.array(seen)), np.array(forces)


def fault(kind, jump=(0.0, 0.0)):
    return Fault(kind, 0.1 * BEGIN - 0.05, 0.1 * END - 0.05, jump)


def measurements(o):
    psi = np.unwrap(np.arctan2(o.sin_psi, o.cos_psi))
    x_e, y_e = o.e_x * o.cos_psi - o.e_y * o.sin_psi, o.e_x * o.sin_psi + o.e_y * o.cos_psi
    return np.array([x_e, y_e, psi, o.u_R + o.u_e, o.v_R + o.v_e, o.r_R + o.r_e])


@pytest.mark.parametrize(("kind", "row"), [("surge", 0), ("yaw", 1)])
@pytest.mark.parametrize("how", ["stuck", "dead", "one way"])
def test_an_actuator_fails_only_during_its_fault(kind, row, how):
    _, whole = run(CALM)
    _, forces = run(CALM, fault(f"{kind} {how}"))
    during = slice(BEGIN - 1, END - 1)  # the force of step k acts in the period that ends at instant k + 1
    np.testing.assert_allclose(forces[: BEGIN - 1], whole[: BEGIN - 1], rtol=1e-12)
    np.testing.assert_allclose(forces[END - 1 :], whole[END - 1 :], rtol=1e-12)  # the actuators have no lag
    np.testing.assert_allclose(forces[during, 1 - row], whole[during, 1 - row], rtol=1e-12)
    expected = {
        "stuck": np.full(END - BEGIN, whole[BEGIN - 2, row]),
        "dead": np.zeros(END - BEGIN),
        "one way": np.maximum(whole[during, row], 0.0),
    }
    np.testing.assert_allclose(forces[during, row], expected[how], atol=1e-9)


@pytest.mark.parametrize("fixes", ["always", "outages", "reckoning"])
def test_a_frozen_position_stays_in_every_kind_of_navigation(fixes):
    """A known position: the measured one is the reference plus the measured error."""
    some = {"outages": 1e-6} if fixes == "outages" else {"reckoning": RandomReckoning()} if fixes == "reckoning" else {}
    scenario = replace(STORM, faults=RandomFaults(("all frozen",)), sensors=replace(STORM.sensors, **some))
    env = UnderactuatedAUVTrackEnv(scenario)
    episode = replace(scenario.draw(np.random.default_rng(3)), faults=(fault("all frozen"),))
    observation, _ = env.reset(options={"episode": episode})
    positions = []
    for _ in range(END + 5):
        o, R = decode_observation(observation), env.reference
        positions.append(complex(R.x, R.y) + complex(o.e_x, o.e_y) * complex(o.cos_psi, o.sin_psi))
        observation, *_ = env.step(np.array([0.5, 0.1]))
    assert np.abs(np.diff(positions[BEGIN - 1 : END])).max() < 1e-9
    assert abs(positions[END] - positions[END - 1]) > 0.1


@pytest.mark.parametrize(
    ("kind", "rows"),
    [("all frozen", [2, 3, 4, 5]), ("heading frozen", [2]), ("velocity frozen", [3, 4]), ("yaw rate frozen", [5])],
)
def test_a_frozen_measurement_keeps_its_last_value(kind, rows):
    scenario = replace(STORM, faults=RandomFaults((kind,)))
    whole, seen = (measurements(run(scenario, *faults)[0]) for faults in ((), (fault(kind),)))
    np.testing.assert_allclose(
        seen[rows, BEGIN:END], np.repeat(seen[rows, BEGIN - 1 : BEGIN], END - BEGIN, axis=1), atol=1e-6
    )
    others = [k for k in range(2, 6) if k not in rows]
    np.testing.assert_allclose(seen[others], whole[others], atol=1e-5)
    np.testing.assert_allclose(seen[rows, END:], whole[rows, END:], atol=1e-5)
    if kind == "all frozen":  # the measured position stays, so the error changes as the reference moves
        assert np.hypot(*np.diff(seen[:2, BEGIN:END], axis=1)).min() > 0.0


def test_missing_velocities_read_zero():
    o, _ = run(replace(STORM, faults=RandomFaults(("velocity missing",))), fault("velocity missing"))
    u, v = measurements(o)[3:5, BEGIN:END]
    np.testing.assert_allclose((u, v), 0.0, atol=1e-6)


def test_a_jump_moves_the_measured_position():
    scenario = replace(STORM, faults=RandomFaults(("position jump",)))
    whole, seen = (measurements(run(scenario, *f)[0]) for f in ((), (fault("position jump", (2.0, -1.0)),)))
    moved = (seen - whole)[:2]
    np.testing.assert_allclose(moved[:, BEGIN:END], np.array([[2.0], [-1.0]]) * np.ones(END - BEGIN), atol=1e-5)
    np.testing.assert_allclose(np.delete(moved, np.s_[BEGIN:END], axis=1), 0.0, atol=1e-5)


def test_an_offset_is_added_to_the_measured_velocities():
    scenario = replace(STORM, faults=RandomFaults(("velocity offset",)))
    whole, seen = (measurements(run(scenario, *f)[0]) for f in ((), (fault("velocity offset", (0.1, -0.05)),)))
    added = np.zeros((6, 61))
    added[3:5, BEGIN:END] = [[0.1], [-0.05]]
    np.testing.assert_allclose(seen - whole, added, atol=1e-5)


def test_an_offset_of_the_log_adds_up_in_dead_reckoning():
    """Without a fix the estimated position drifts by the offset, in the direction of the measured heading."""
    still = replace(PRESETS["cruise-calm"], path=Line(1.0, heading=0.3), start=Start(psi_e=0.0))
    log = RandomReckoning(60.0, 0.0, 0.0, 0.0, 0.0)
    scenario = replace(still, faults=RandomFaults(("velocity offset",)), sensors=Sensors(reckoning=log))
    whole, seen = (measurements(run(scenario, *f)[0]) for f in ((), (fault("velocity offset", (0.1, -0.05)),)))
    psi = whole[2, BEGIN:END]
    drift = 0.1 * (0.1 - 0.05j) * np.exp(1j * psi)  # in a control period
    x, y = (seen - whole)[:2]
    np.testing.assert_allclose((x + 1j * y)[BEGIN:END], np.cumsum(drift), atol=1e-5)
    np.testing.assert_allclose((x + 1j * y)[END:], drift.sum(), atol=1e-5)


def test_the_only_fault_begins_in_its_interval():
    random, rng = RandomFaults(("velocity frozen", "velocity offset"), begin=(20.0, 30.0)), np.random.default_rng(0)
    drawn = [random.draw(rng, 100.0) for _ in range(1000)]
    assert {len(faults) for faults in drawn} == {1}
    assert kstest([(f.begin - 20.0) / 10.0 for (f,) in drawn], "uniform").pvalue > 0.01
    assert {f.kind for (f,) in drawn} == set(random.kinds)
    sizes = [np.hypot(*f.jump) / 0.1 for (f,) in drawn if f.kind == "velocity offset"]
    assert kstest(sizes, "uniform").pvalue > 0.01
    (only,) = replace(random, begin=50.0, time=20.0).draw(rng, 100.0)
    assert (only.begin, only.end) == (50.0, 70.0)


def test_faults_are_scaled_to_a_vehicle_and_kept_in_files(tmp_path):
    """An offset has the dimension of a speed, and a begin that of a time."""
    faults = RandomFaults(("velocity offset",), offset=(0.1, 0.2), begin=(3.0, 6.0))
    scenario = replace(STORM, faults=faults)
    units, scaled = Units.of(vehicle_model("lauv").vehicle), changed(scenario, "lauv")
    speed = units.length / units.time
    assert scaled.faults.offset == pytest.approx((0.1 * speed, 0.2 * speed))
    assert scaled.faults.begin == pytest.approx((3.0 * units.time, 6.0 * units.time))
    for suffix in ("toml", "json"):
        scenario.save(tmp_path / f"one.{suffix}")
        assert Scenario.load(tmp_path / f"one.{suffix}") == scenario
    assert replace(STORM, faults=RandomFaults(("yaw dead",))).to_dict()["faults"] == {"kinds": ["yaw dead"]}


def test_random_faults_have_their_rate_times_and_kinds():
    random, rng = RandomFaults(FAULT_KINDS, rate=3.0, time=(2.0, 5.0), jump=(1.0, 2.0)), np.random.default_rng(0)
    drawn = [random.draw(rng, 60.0) for _ in range(400)]
    assert np.mean([len(faults) for faults in drawn]) == pytest.approx(3.0, abs=0.3)
    every = [f for faults in drawn for f in faults]
    assert {f.kind for f in every} == set(FAULT_KINDS)
    for f in every:
        assert 2.0 <= f.end - f.begin <= 5.0
        low, high = {"position jump": (1.0, 2.0), "velocity offset": (0.0, 0.1)}.get(f.kind, (0.0, 0.0))
        assert low <= np.hypot(*f.jump) <= high


def test_a_fault_ends_when_the_next_one_begins():
    rows = fault_rows([Fault("yaw dead", 0.0, 5.0), Fault("surge dead", 2.0, 3.0)], 1.0, 8)
    yaw, surge = FAULT_KINDS.index("yaw dead") + 1, FAULT_KINDS.index("surge dead") + 1
    assert rows[0].tolist() == [0, yaw, surge, 0, 0, 0, 0, 0]


def test_an_episode_with_faults_needs_a_scenario_with_faults():
    episode = replace(STORM.draw(np.random.default_rng(0)), faults=(fault("yaw dead"),))
    with pytest.raises(ValueError, match="the episode has faults"):
        UnderactuatedAUVTrackEnv(STORM).reset(options={"episode": episode})
    with pytest.raises(ValueError, match="the episode has a velocity offset"):
        run(CALM, fault("velocity offset"))
