"""Gains: forces for a fixed sequence of observations, their change with 5 % of any gain, gains of other vehicles."""

from dataclasses import replace

import numpy as np
import pytest

from auv_gym.physics.namespaces import ARRAYS
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.presets import SPEED_RANGES, as_scenario
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import PAPER, VEHICLES_FOLDER, vehicle_model
from auv_gym.task.observation import SIZE, Observation
from baselines import make_policy
from baselines.control.backstepping import GAINS, LAW_GAINS, tracking_forces
from baselines.control.los_pid import PIDGains
from baselines.control.nmpc.controller import PREVIEW
from baselines.gains import loading
from baselines.gains.loading import RATIOS, recorded_gains, vehicle_ratios
from baselines.tuning.objective import TUNABLES

U, DT = np.array([0.2, 1.0]), np.array([0.2, 0.1])
"""Reference speed [m/s] and control period [s] of two vehicles, one in each speed range."""
STEPS = 25


def observation(k):
    """Return the observation of both vehicles at an instant."""
    t = k * DT
    return Observation._make(np.zeros((SIZE, 2)))._replace(
        e_x=0.3 * U * np.sin(1.1 * t + 0.3),
        e_y=0.4 * U * np.cos(0.9 * t),
        psi_e=0.2 * np.sin(0.7 * t + 0.1),
        u_e=0.1 * U * np.cos(1.3 * t),
        v_e=0.1 * U * np.sin(0.8 * t),
        r_e=0.05 * np.cos(0.6 * t),
        u_R=U,
        v_R=-0.02 * U,
        r_R=0.03 + 0.0 * t,
        F_uR=70 * U,
        F_rR=3.0 + 0.0 * t,
        cos_psi=np.cos(0.4 + 0.05 * t),
        sin_psi=np.sin(0.4 + 0.05 * t),
        F_u_max=np.array([100.0, 400.0]),
        F_r_max=np.array([50.0, 200.0]),
        a_u=0.2 * np.sin(0.9 * t),
        a_r=0.2 * np.cos(0.7 * t),
        dt=DT,
    )


AHEAD = np.stack(
    [np.array([u * dt * n, 0.01 * u * (dt * n) ** 2]) for u, dt in zip(U, DT, strict=True) for n in PREVIEW]
)
AHEAD = AHEAD.reshape(len(U), 2 * len(PREVIEW))


def forces_over_time(controller):
    """Return F_u [N], F_r [N m] of both vehicles over time, shape (STEPS, 2, 2)."""
    memory, forces = controller.start(len(U)), []
    for k in range(STEPS):
        F_u, F_r, memory = controller.forces(observation(k), memory, AHEAD)
        forces.append(np.array((F_u, F_r)).T)
    return np.array(forces)


def recorded(name):
    """Return the gains of a controller's files, by speed range."""
    return {speed_range: recorded_gains()["tuned"][name][speed_range]["gains"] for speed_range in SPEED_RANGES}


LAWS = {
    "paper": ((-12.544307, -12.8735392), (-46.3783192, -38.4178732)),
    "cruise": ((-15.4273125, -20.1967014), (-58.2404933, -28.9480124)),
    "robust": ((9.00856999, -20.3757357), (42.9162302, -28.7018569)),
    "normalised-paper": ((-12.544307, -9.25800924), (-46.3783192, -5.13587548)),
    "normalised": ((8.11762147, -16.3472311), (40.1745077, -11.6975119)),
}
CONTROLLERS = {
    "integral-normalised": ((16.5950526, 24.0386648), (109.821746, -9.55845578)),
    "los-pid": ((10.8225171, 57.7834092), (237.303348, -279.163713)),
    "lqi": ((19.0484226, 50.1481833), (-18.591584, -134.849013)),
    "ilos": ((12.2144148, 64.6888711), (176.006856, -378.51837)),
    "ekf": ((-11.9042923, 99.2465609), (-176.626054, -141.851121)),
    "nmpc": ((-36.6964603, 50), (22.6562016, -200)),
    "nmpc-adverse": ((-45.2292372, 50), (61.1125913, 200)),
}
"""F_u [N], F_r [N m] of the slow and of the fast vehicle."""
TOLERANCE = {"nmpc": 2e-5}
"""Relative tolerance, 1e-6 for all others. The number of a solver's steps can differ between machines."""


def differs(found, expected, tolerance):
    return np.abs(np.array(found) / expected - 1).max() > tolerance


@pytest.mark.parametrize("name", GAINS)
def test_gains_of_the_law(name):
    def forces(gains):
        return np.array(tracking_forces(observation(3), PAPER_VEHICLE, gains, ARRAYS)).T

    gains = GAINS[name]
    np.testing.assert_allclose(forces(gains), LAWS[name], rtol=1e-6)
    for key in (*LAW_GAINS, "reference_speed"):
        if value := getattr(gains, key):
            assert differs(forces(replace(gains, **{key: 1.05 * value})), LAWS[name], 1e-6), key


@pytest.mark.parametrize("name", CONTROLLERS)
def test_gains_of_the_files(name):
    tolerance = TOLERANCE.get(name, 1e-6)
    np.testing.assert_allclose(forces_over_time(make_policy(name).controller)[-1], CONTROLLERS[name], rtol=tolerance)


@pytest.mark.slow
@pytest.mark.parametrize("name", CONTROLLERS)
def test_every_gain_of_the_files_has_an_effect(name):
    """Except `calm`: the sequence is too short for the filter for calm water to prevail."""
    before = forces_over_time(make_policy(name).controller)
    for row, (speed_range, gains) in enumerate(recorded(name).items()):
        for key, value in gains.items():
            after = forces_over_time(make_policy(name, gains={**gains, key: 1.05 * value}).controller)
            changed = differs(after[:, row], before[:, row], TOLERANCE.get(name, 1e-6))
            assert changed or key == "calm", (speed_range, key)


def test_the_ratios_of_a_vehicle_are_bounded_and_zero_for_the_papers_vehicle():
    assert vehicle_ratios(PAPER) == [0.0] * 2 * len(RATIOS)
    actuators = replace(PAPER.actuators, F_u_max=800.0, fin=20.0)  # full fins give 20 * 1.5^2 = 45 N m
    stronger = replace(PAPER, actuators=actuators, lag=0.1, vehicle=replace(PAPER_VEHICLE, d22=1000.0))
    above, below = np.reshape(vehicle_ratios(stronger), (2, len(RATIOS)))
    np.testing.assert_allclose(np.exp(above), (2.0, 1.0, 1.0, 4.0, 1.0, 1.0))
    np.testing.assert_allclose(np.exp(below), (1.0, 0.25, 0.5, 1.0, 1.0, 1.0))  # 45 of 200 N m count as a quarter


def test_gains_follow_the_ratios_at_cruise_if_the_actuators_are_known(monkeypatch):
    entry = {"heading": [0.5, 1.0, *[0.0] * 10], "turn": [0.0] * 8 + [-2.0, 0.0, 0.0, 0.0]}
    record = recorded_gains() | {"exponents": {"los-pid": {"exponents": entry}}}
    monkeypatch.setattr(loading, "recorded_gains", lambda: record)
    plain = loading.load_gains("los-pid", "cruise", PIDGains._fields)
    stronger = replace(PAPER, actuators=replace(PAPER.actuators, F_u_max=1600.0, F_r_max=300.0), lag=0.1)
    adapted = loading.adapted_gains("los-pid", "cruise", PIDGains._fields, stronger)
    factors = {name: adapted[name] / gain for name, gain in plain.items()}
    expected = dict.fromkeys(plain, 1.0) | {"heading": 4**0.5 * 1.5, "turn": 0.5**-2}
    assert factors == pytest.approx(expected)
    assert loading.adapted_gains("los-pid", "cruise", PIDGains._fields, stronger.vehicle) == plain
    slow = loading.load_gains("los-pid", "slow", PIDGains._fields)
    assert loading.adapted_gains("los-pid", "slow", PIDGains._fields, stronger) == slow


def test_every_exponent_is_of_a_gain():
    for name, record in recorded_gains()["exponents"].items():
        entry = record["exponents"]
        assert tuple(entry) == tuple(TUNABLES[name].names)
        assert {len(powers) for powers in entry.values()} == {2 * len(RATIOS)}


def test_the_actuators_of_a_published_vehicle_and_of_a_file_are_known(tmp_path):
    def heading(vehicle):
        return make_policy("los-pid", vehicle=vehicle).policy.controller.cruise.gains.heading

    lauv = vehicle_model("lauv")
    file = tmp_path / "mine.toml"
    file.write_text((VEHICLES_FOLDER / "lauv.toml").read_text())
    assert len({heading(known) for known in ("lauv", lauv, lauv.vehicle, str(file))}) == 1
    other = replace(lauv.vehicle, d11=1.01 * lauv.vehicle.d11)
    assert heading(other) == loading.load_gains("los-pid", "cruise", PIDGains._fields)["heading"] != heading(lauv)


def test_a_scenario_for_a_vehicle_file_knows_the_actuators_and_its_record_does_not(tmp_path):
    file = tmp_path / "mine.toml"
    file.write_text((VEHICLES_FOLDER / "lauv.toml").read_text().replace("d11 = ", "d11 = 1"))
    scenario = as_scenario(f"cruise-storm@{file}")
    assert scenario.known == vehicle_model(str(file))
    assert replace(scenario, vehicle=PAPER_VEHICLE).known == PAPER_VEHICLE
    again = Scenario.from_dict(scenario.to_dict())
    assert again == scenario
    assert again.known == scenario.vehicle
    with pytest.raises(ValueError, match="model lacks the entry 'name'"):
        Scenario.from_dict({"model": {}})
