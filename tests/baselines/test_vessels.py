"""Identification of a vessel with propeller and rudder: an independent plant, held-out runs, and measured ones."""

import math
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import chi2

from auv_gym.physics.dynamics import rk4_step
from auv_gym.physics.namespaces import FLOATS
from auv_gym.scenarios.vehicles import VehicleModel
from baselines.identification import Log, identify
from baselines.identification.columns import Format
from baselines.identification.command import PROGRAM, main
from baselines.identification.fit import IDENTIFIED, ZERO
from baselines.identification.log import joined
from baselines.identification.model import names_of
from baselines.identification.prediction import held_out
from baselines.identification.report import held_out_text
from baselines.tools.command_line import run

pytestmark = pytest.mark.slow  # fits of long logs
TRUE = {
    "m11": 250.0, "m22": 420.0, "m33": 200.0, "d11": 1.0, "d22": 12.0, "d33": 6.0, "X_uu": 8.0, "Y_vv": 150.0,
    "N_rr": 120.0, "Y_uv": 40.0, "Y_ur": 120.0, "N_uv": 100.0, "N_ur": 60.0, "X_vr": -60.0, "N_vv": 40.0, "T_nn": 0.014,
    "T_nu": 0.08, "side": 14.0, "arm": 1.4, "drag": 6.0, "wash": 0.05, "X_air": 0.07, "Y_air": 0.2, "N_turn": 0.08,
}  # fmt: skip
MASSES = {name: TRUE[name] for name in ("m11", "m22", "m33", "arm")}
NOISE = np.array([0.02, 0.02, 0.004, 0.004, 0.004, 0.0015])


def rates(z, n, angle, wind):
    """Return the rates of a vessel's state, with equations of their own."""
    g = TRUE
    _, _, psi, u, v, r = z
    c, s = math.cos(psi), math.sin(psi)
    T = g["T_nn"] * n * n - g["T_nu"] * n * u
    inflow = u * u + g["wash"] * T
    rudder = g["side"] * inflow * math.sin(angle)
    air_u, air_v = u - c * wind[0] - s * wind[1], v + s * wind[0] - c * wind[1]
    air = math.hypot(air_u, air_v)
    X = T - g["drag"] * inflow * math.sin(angle) ** 2 - g["X_air"] * air * air_u - g["X_vr"] * v * r
    Y = -rudder - g["Y_air"] * air * air_v - g["Y_uv"] * u * v + g["Y_ur"] * u * r
    N = g["arm"] * rudder - g["N_turn"] * air_u * air_v + (g["N_uv"] * u - g["N_vv"] * abs(v)) * v - g["N_ur"] * u * r
    return [
        u * c - v * s,
        u * s + v * c,
        r,
        (X + g["m22"] * v * r - (g["d11"] + g["X_uu"] * abs(u)) * u) / g["m11"],
        (Y - g["m11"] * u * r - (g["d22"] + g["Y_vv"] * abs(v)) * v) / g["m22"],
        (N + (g["m11"] - g["m22"]) * u * v - (g["d33"] + g["N_rr"] * abs(r)) * r) / g["m33"],
    ]


def sailed(seed, n, amplitude, band, duration=150.0, dt=0.5):
    """Return the log of a zig-zag in wind, or with a wide band of a turn; halfway the propeller turns faster."""
    rng = np.random.default_rng(seed)
    wind = 1.5 * np.array([math.cos(seed), math.sin(seed)])
    t, z, side = np.arange(0.0, duration, dt), np.array([0.0, 0.0, 0.3 * seed, 0.2, 0.0, 0.0]), 1.0
    measured, commands = np.empty((len(t), 6)), np.empty((len(t), 2))
    for k, time in enumerate(t):
        side = -side if side * (z[2] - 0.3 * seed) > math.radians(band) else side
        commands[k] = n * (1.3 if time > duration / 2 else 1.0), side * math.radians(amplitude) if time > 10 else 0.0
        measured[k] = z + rng.standard_normal(6) * NOISE
        arguments = (*commands[k].tolist(), wind)
        z = solve_ivp(lambda _, z, *a: rates(z, *a), (0, dt), z, "DOP853", args=arguments, rtol=1e-7, atol=1e-8).y[
            :, -1
        ]
    return Log(t, measured, commands, "revolutions", np.tile(wind, (len(t), 1)))


def still(log):
    """Return that there is no current in a log."""
    return {name: 0.0 for name in names_of(log) if name.startswith("V_")}


@pytest.fixture(scope="module")
def log():
    return joined([sailed(0, 10, 20, 15), sailed(1, 7, 30, 30), sailed(2, 10, 12, 10), sailed(3, 9, 25, 1000)])


@pytest.fixture(scope="module")
def fitted(log):
    terms = ("X_uu", "Y_vv", "N_rr", "Y_uv", "Y_ur", "N_uv", "N_ur", "X_vr", "N_vv")
    return identify(log, terms, known=MASSES | still(log))


def test_a_vessel_in_wind_is_found(fitted):
    assert not fitted.misfit
    shown = [e for e in fitted.estimates if e.verdict in (IDENTIFIED, ZERO)]
    assert len(shown) > 25
    off = np.array([fitted[name].value - TRUE.get(name, 0.0) for name in fitted.free])
    assert off @ np.linalg.solve(fitted.covariance, off) < chi2.ppf(0.999, len(off))  # all intervals together
    for e in shown:
        assert abs(e.value - TRUE.get(e.name, 0.0)) <= 0.25 * abs(TRUE.get(e.name, 0.0)) + 0.1, e
    np.testing.assert_allclose(fitted.noise, NOISE, rtol=0.1)


def test_held_out_runs_are_predicted_within_the_bands(fitted):
    result = held_out(fitted, joined([sailed(5, 9, 18, 20), sailed(6, 9, -30, 1000)]))
    model, nomoto, steady = (np.array(result.rms[name]) for name in ("model", "Nomoto", "constant velocity"))
    assert (model < 0.5 * nomoto).all()
    assert nomoto[0] < steady[0]
    assert math.degrees(model[0]) < 1.0
    assert (result.inside.mean(axis=0) > 0.85).all()
    figures = {m.name: m for m in result.manoeuvres}
    assert figures["turning diameter"].predicted == pytest.approx(figures["turning diameter"].measured, rel=0.03)
    assert figures["first overshoot"].predicted == pytest.approx(figures["first overshoot"].measured, abs=0.5)
    assert "| model |" in held_out_text(result, "log")


def test_what_a_rudder_does_not_show_must_be_known(log):
    with pytest.raises(ValueError, match="does not show m11, m22, m33, arm: give them as known"):
        identify(log)
    with pytest.raises(ValueError, match="'F_u_max' is not a parameter of this log"):
        identify(log, known={"F_u_max": 1.0})


def test_the_command_predicts_held_out_runs(log, fitted, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("baselines.identification.command.identify", lambda *_: fitted)
    for k, rows in enumerate(log.runs):
        Log(log.t[rows], log.measured[rows], log.commands[rows], log.kind, log.wind[rows]).save(f"{k}.csv")
    known = [f"{name}={value}" for name, value in MASSES.items()]
    sailed(7, 15, 20, 15).save("fast.csv")
    arguments = ["0.csv", "1.csv", "--known", *known, "--still-water", "--holdout", "2.csv", "fast.csv", "--out", "out"]
    assert run(main, PROGRAM, arguments) == 0
    printed = capsys.readouterr().out
    assert "| Nomoto |" in printed
    assert "Run 2: revolutions is 15 to 19.5 1/s, in the fit 7 to 13: this prediction is an extrapolation." in printed
    assert "Run 1: " not in printed
    text = Path("out/report.md").read_text(encoding="utf-8")
    assert text.startswith("# The vehicle in 0.csv, 1.csv")
    assert "## Held-out runs" in text
    assert Path("out/held-out.png").exists()
    turned_by_the_shaft(VehicleModel.load("out/vehicle.toml"))
    assert run(main, PROGRAM, ["0.csv", "--known", "m11"]) == 2
    assert "--known m11 must be NAME=VALUE" in capsys.readouterr().err


def turned_by_the_shaft(model):
    """Check that the written vehicle, with its shaft, turns as the plant does: its tracked point, in still water."""
    v, shaft, h = model.vehicle, model.shaft, 0.05
    plant, state = np.array([0.0, 0.0, 0.0, 0.7, 0.0, 0.0]), (v.eps, 0.0, 0.0, 0.7, 0.0, 0.0)
    assert v.eps == pytest.approx(TRUE["m33"] / TRUE["m22"] / TRUE["arm"], rel=1e-4)
    calm = {**TRUE, "X_air": 0.0, "Y_air": 0.0, "N_turn": 0.0}
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(globals(), "TRUE", calm)
        for _ in range(400):
            plant = plant + h * np.array(
                rates(plant + 0.5 * h * np.array(rates(plant, 9.0, 0.3, (0, 0))), 9.0, 0.3, (0, 0))
            )
            _, _, _, u, sway, r = state
            F_u, F_r = shaft.forces((9.0 / shaft.n_max, 0.3 / shaft.angle_max), u, sway - v.eps * r, r, FLOATS)
            state = rk4_step(state, (F_u, 0.0, F_r), v.acting, h)
    x, y, psi, *_ = plant
    assert psi > 1.0
    assert state[2] == pytest.approx(psi, rel=0.02)
    assert math.hypot(state[0] - x - v.eps * math.cos(psi), state[1] - y - v.eps * math.sin(psi)) < 0.15


LOGS = os.environ.get("AUV_GYM_LOGS")


@pytest.mark.slow
@pytest.mark.skipif(not LOGS, reason="AUV_GYM_LOGS does not name a folder of measured runs")
def test_a_measured_zig_zag_is_predicted_from_others():
    form = Format.named("kvlcc2")
    logs = {file.stem: Log.load(file, form) for file in sorted((Path(LOGS) / "kvlcc2-hsva").glob("Z_*.dat"))}
    log = joined([run for name, run in logs.items() if name != "Z_20_05"])
    fitted = identify(log, known={"m11": 3436.0, "m22": 6050.0, "m33": 15900.0, "arm": 3.5} | still(log))
    assert fitted.misfit
    result = held_out(fitted, logs["Z_20_05"])
    assert math.degrees(result.rms["model"][0]) < 3.0
    overshoot = next(m for m in result.manoeuvres if m.name == "first overshoot")
    assert overshoot.predicted == pytest.approx(overshoot.measured, abs=1.5)
