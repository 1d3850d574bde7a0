"""Validation: a Doppler log with known errors, a vessel that is predicted, the recorded results, the command."""

import os
from pathlib import Path

import numpy as np
import pytest

from auv_gym.effects.actuators import Actuators
from auv_gym.effects.sensors import Sensors
from auv_gym.physics.vehicle import PAPER_VEHICLE
from baselines.control.linearisation import error_dynamics
from baselines.identification import identify
from baselines.identification.trials import example
from research.validation import navigation, predictions, vessels
from research.validation.predictions import context, figures, heading

LOGS = os.environ.get("AUV_GYM_LOGS")
measured = pytest.mark.skipif(not LOGS, reason="AUV_GYM_LOGS does not name a folder of measured runs")
SCALE, ANGLE, AHEAD, DELAY, NOISE = 0.02, 0.03, -1.5, 0.7, 0.01


@pytest.fixture
def sea(tmp_path):
    """Return a folder with a section whose Doppler log is wrong in a known way, on a track of known velocity."""
    folder = tmp_path / navigation.SNAPIR
    folder.mkdir()
    t = np.arange(0.0, 400.0)

    def body(t):
        return 1.8 + 0.2 * np.sin(0.05 * t), 0.1 * np.sin(0.08 * t), 0.05 * np.sin(0.03 * t) + 0.02

    psi = -0.05 / 0.03 * np.cos(0.03 * t) + 0.02 * t
    u, v, _ = body(t)
    north, east = u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)
    zero = np.zeros_like(t)
    truth = np.column_stack((t, zero, zero, zero, north, east, zero, zero, zero, (psi + np.pi) % (2 * np.pi) - np.pi))
    heads = "Time [s],Longitude [rad],Latitude [rad],Altitude [m],V North [m/s],V East [m/s],V Down [m/s]"
    heads += ",Roll [rad],Pitch [rad],Yaw [rad]"
    np.savetxt(folder / "GT_1.csv", truth, delimiter=",", header=heads, comments="")
    u, v, r = body(t - DELAY)
    noise = NOISE * np.random.default_rng(0).standard_normal((2, len(t)))
    ahead, across = (1 + SCALE) * u - ANGLE * v, (1 + SCALE) * v + ANGLE * u + AHEAD * r
    log = np.column_stack((t, ahead + noise[0], across + noise[1], zero))
    heads = "Time [s],DVL X [m/s],DVL Y [m/s],DVL Z [m/s]"
    np.savetxt(folder / "DVL_1.csv", log, delimiter=",", header=heads, comments="")
    return tmp_path


def test_errors_of_a_doppler_log_are_found(sea):
    record = navigation.navigation_errors(sea)
    (section,) = record["sections"]
    assert section["scale"] == pytest.approx(SCALE, abs=0.001)
    assert section["misalignment"] == pytest.approx(ANGLE, abs=0.001)
    assert section["ahead_m"] == pytest.approx(AHEAD, abs=0.05)
    assert section["delay_s"] == pytest.approx(DELAY, abs=0.1)
    assert section["noise"] == pytest.approx(NOISE, rel=0.1)
    assert abs(section["related"]) < 0.15
    assert section["drift_m"] > section["suite_drift_m"]
    assert section["suite_whole_drift_m"] > section["suite_drift_m"]
    t = np.linspace(0.0, 100.0, 101)
    track = {"t": t, "u": 0 * t, "v": 0 * t, "psi": 0 * t + 0.5}
    assert navigation._drift(track, 0.03 + 0 * t, 0.04 + 0 * t) == pytest.approx(5.0)  # [m] of the added velocities
    with pytest.raises(OSError, match="has no files GT_"):
        navigation.navigation_errors(sea / "none")
    with pytest.raises(OSError, match=r"kvlcc2-hsva has 0 files Z_\*.dat; it must have 7 or more"):
        vessels.cross_validated("kvlcc2-hsva", sea)


@pytest.mark.slow
def test_every_run_is_predicted_once_by_a_model_of_the_others(monkeypatch):
    sensors = Sensors(position=0.05, heading=0.015, velocity=0.02, yaw_rate=0.005)
    logs = {name: example(PAPER_VEHICLE, Actuators(lag=0.4), sensors, k) for k, name in enumerate("abc")}
    found, fitted = identify(logs["a"], ()), []
    monkeypatch.setattr(vessels, "runs_of", lambda *_: logs)
    monkeypatch.setattr(vessels, "fitted_vessel", lambda _, own: (fitted.append(own), found)[1])
    monkeypatch.setattr(vessels, "VESSELS", {"boat": vessels.Vessel("*", "none", 1.0, 1.0, 3)})
    record = vessels.cross_validated("boat", Path())
    assert fitted == [[logs["b"], logs["c"]], [logs["a"], logs["c"]], [logs["a"], logs["b"]]]
    assert record["by_run"].keys() == logs.keys()
    assert record["misfit"] == 0
    for name, row in record["rms"].items():
        assert row["points"] == sum(own["points"] for own in record["by_run"].values()), name
    u = float(np.median(logs["a"].measured[:, 3]))
    lateral = np.linalg.eigvals(error_dynamics(found.vehicle(), u, 0.0, 0.0)[0][4:, 4:])
    assert record["straight_growth_1_s"] == pytest.approx([lateral.real.max()] * 3, rel=1e-6)
    for run, row in record["by_run"].items():
        assert row["beyond"] == [], run
        assert row["median_heading_deg"] < row["Nomoto"]["median_heading_deg"]
    model, steady = (record["rms"][name]["heading_deg"] for name in ("model", "constant velocity"))
    assert model < 0.1 * steady
    assert record["growth_deg"]["model"][0] < record["growth_deg"]["constant velocity"][3]


def test_the_page_counts_what_is_recorded():
    shown, tanker = context(), predictions.STUDY.values()["kvlcc2-hsva",]
    by_run = tanker["by_run"].values()
    points = sum(row["points"] for row in by_run)
    assert points == tanker["rms"]["model"]["points"]
    assert heading(by_run) == pytest.approx(tanker["rms"]["model"]["heading_deg"])
    assert shown["met"] == sum(row[-1] == "yes" for row in shown["goals"])
    assert len(figures()) == len(vessels.VESSELS)


@measured
def test_the_recorded_navigation_errors_are_those_of_the_logs():
    mine, recorded = navigation.navigation_errors(Path(LOGS)), predictions.STUDY.values()["snapir",]
    assert mine["suite"] == pytest.approx(recorded["suite"])
    for section, known in zip(mine["sections"], recorded["sections"], strict=True):
        assert section == pytest.approx(known, rel=1e-6)
