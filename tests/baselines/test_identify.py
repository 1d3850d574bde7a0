"""Identification: a plant with equations of its own, what a log does not show, wrong input, figures, the command."""

import math
import re
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.stats import kstest

from auv_gym.effects.actuators import Actuators
from auv_gym.effects.sensors import Sensors
from auv_gym.physics.errors import to_body, to_world
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.fitting import changed, in_vehicle_units
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import as_vehicle
from baselines.identification import Log, command, files, identify
from baselines.identification.axes import ContradictionError
from baselines.identification.command import PROGRAM, main
from baselines.identification.fit import IDENTIFIED, LEFT_OUT, UNREACHED, ZERO
from baselines.identification.least_squares import Residuals
from baselines.identification.linear_fit import regressors
from baselines.identification.log import joined
from baselines.identification.model import COEFFICIENTS, CROSS_TERMS, FITTED_PARAMETERS, LogModel, WindDrag, wind_load
from baselines.identification.prediction import HeldOut, Windows, constant_velocity, extrapolations, nomoto
from baselines.identification.report import held_out_text
from baselines.identification.trials import EXAMPLE_ACTUATORS, EXAMPLE_CURRENT, Simulated, Trial, example, recorded
from baselines.identification.uncertainty import covariance, whiteness
from baselines.tools.command_line import run

ROOT = Path(__file__).parents[2]
NOISE = Sensors(position=0.05, heading=0.015, velocity=0.02, yaw_rate=0.005)
HULL_TRUE = {"m11": 180.0, "m22": 260.0, "m33": 95.0, "d11": 45.0, "d22": 120.0, "d33": 60.0}
DRAG_TRUE = {"X_uu": 25.0, "Y_vv": 90.0, "N_rr": 30.0}
LAG, LIMITS = 0.3, (380.0, 190.0)
TRUE = dict.fromkeys(COEFFICIENTS, 0.0) | HULL_TRUE | DRAG_TRUE | {"F_u_max": 380.0, "F_r_max": 190.0, "lag": LAG}
TRUE |= dict(zip(("V_x", "V_y"), EXAMPLE_CURRENT, strict=True))


class Independent:
    """The vehicle as the paper prints it, with continuous lag, by another integrator."""

    def __init__(self):
        self.force = np.zeros(2)

    def __call__(self, state, command, dt):
        h, d, wanted = HULL_TRUE, DRAG_TRUE, np.clip(command, -np.array(LIMITS), np.array(LIMITS))

        def slope(_, z):
            _, _, psi, u, v, r, X, N = z
            drag_u, drag_v = (h["d11"] + d["X_uu"] * abs(u)) * u, (h["d22"] + d["Y_vv"] * abs(v)) * v
            drag_r = (h["d33"] + d["N_rr"] * abs(r)) * r
            return [
                u * math.cos(psi) - v * math.sin(psi) + EXAMPLE_CURRENT[0],
                u * math.sin(psi) + v * math.cos(psi) + EXAMPLE_CURRENT[1],
                r,
                (X + h["m22"] * v * r - drag_u) / h["m11"],
                (-h["m11"] * u * r - drag_v) / h["m22"],
                (N + (h["m11"] - h["m22"]) * u * v - drag_r) / h["m33"],
                (wanted[0] - X) / LAG,
                (wanted[1] - N) / LAG,
            ]

        end = solve_ivp(slope, (0.0, dt), [*state, *self.force], "DOP853", rtol=1e-7, atol=1e-8).y[:, -1]
        self.force = end[6:]
        return tuple(end[:6].tolist())


@pytest.fixture(scope="module")
def log():
    return recorded(Independent(), Trial(*LIMITS), NOISE, np.random.default_rng(5), EXAMPLE_CURRENT)


@pytest.fixture(scope="module")
def fitted(log):
    return identify(log)


@pytest.fixture(scope="module")
def straight():
    """Return a log of surge steps alone: nothing turns."""
    t = np.arange(0.0, 40.0, 0.1)
    commands = np.column_stack((np.where(t % 20 < 10, 80.0, 20.0), np.zeros_like(t)))
    u, x, rows = 0.0, 0.0, []
    noise = np.random.default_rng(0).standard_normal((len(t), 6)) * np.array(NOISE.noise)
    for k in range(len(t)):
        rows.append(np.array((x, 0.0, 0.0, u, 0.0, 0.0)) + noise[k])
        for _ in range(20):
            x, u = x + 0.005 * u, u + 0.005 * (commands[k, 0] - 70.0 * u) / 215.0
    return Log(t, np.array(rows), commands)


@pytest.fixture(scope="module")
def ahead(straight):
    return identify(straight)


def test_a_minute_of_noise_shows_every_parameter_of_an_independent_plant(fitted):
    assert not fitted.misfit
    shown = [e for e in fitted.estimates if e.verdict != LEFT_OUT]
    assert [e.name for e in fitted.estimates if e not in shown] == list(CROSS_TERMS)
    for e in shown:
        near = abs(e.value - TRUE[e.name]) <= 0.05 * abs(TRUE[e.name])
        assert near or e.low <= TRUE[e.name] <= e.high, e
        assert e.verdict == IDENTIFIED or (e.verdict == ZERO and TRUE[e.name] == 0), e
    inside = [e.low <= TRUE[e.name] <= e.high for e in shown]
    assert sum(inside) >= len(inside) - 3
    np.testing.assert_allclose(fitted.noise, NOISE.noise, rtol=0.15)
    assert fitted["m11"].high - fitted["m11"].low < 0.1 * TRUE["m11"]


def test_derivatives_are_those_of_the_prediction(log):
    model = LogModel(log, np.array([0, 200, 400]))
    values = np.array([TRUE[name] for name in FITTED_PARAMETERS])
    states = log.measured[model.starts]
    every = np.arange(len(values))
    exact = model.predict(values, states, every)
    for j, name in enumerate(FITTED_PARAMETERS):
        h = 1e-5 * max(1.0, abs(values[j]))
        ends = [model.predict(values + side * h * np.eye(len(values))[j], states, every).outputs for side in (1, -1)]
        numeric = (ends[0] - ends[1]) / (2 * h)
        np.testing.assert_allclose(exact.by_value[:, :, j], numeric, atol=1e-5 * (1 + abs(numeric).max()), err_msg=name)
    moved = states.copy()
    moved[1, 4] += 1e-6
    numeric = (model.predict(values, moved, every).outputs - exact.outputs) / 1e-6
    np.testing.assert_allclose(exact.by_state[200:400, :, 4], numeric[200:400], atol=1e-3)
    assert not numeric[:200].any()
    assert not numeric[400:].any()


@pytest.mark.slow
def test_what_a_straight_run_does_not_show_has_no_number(ahead):
    fitted = ahead
    assert fitted["m11"].verdict == fitted["d11"].verdict == IDENTIFIED
    assert fitted["m11"].low <= 215 <= fitted["m11"].high
    assert fitted["d11"].low <= 70 <= fitted["d11"].high
    assert {"m33", "d33"} <= set(fitted.unknown)
    assert math.isnan(fitted["m33"].value)
    assert fitted["F_u_max"].verdict == UNREACHED
    assert fitted["F_u_max"].low <= 80 < fitted["F_u_max"].high == math.inf
    with pytest.raises(ValueError, match=r"the log does not show .*; a zig-zag or a turning circle under way would"):
        fitted.vehicle()
    filled = fitted.vehicle(PAPER_VEHICLE)
    assert (filled.m33, filled.m11) == (80.0, pytest.approx(fitted["m11"].value))


@pytest.mark.slow
def test_the_vehicle_file_of_the_tutorial_is_that_of_the_command():
    tutorials = ROOT / "docs" / "tutorials"
    fitted = identify(Log.load(tutorials / "otter.csv"), ("X_uu", "Y_vv", "N_rr"))
    written = files.vehicle_text(fitted, fitted.vehicle(), files.limits_of(fitted), "otter.csv").splitlines()
    page = (tutorials / "log-to-agent.md").read_text(encoding="utf-8")
    shown = re.findall(r"^\w+ = \S+  # \[.*\.\.\..*$", page, re.MULTILINE)
    assert len(shown) == 10
    assert set(shown) <= set(written)


def test_the_states_that_are_fitted_make_no_misfit():
    """Many short segments: p-values of right logs are small by chance only, although the residuals are correlated."""
    rng, p_values = np.random.default_rng(5), []
    for _ in range(200):
        noise, basis = rng.standard_normal((1000, 6)), np.zeros((1000, 6, 6))
        starts = np.arange(0, 1000, 20)
        for k in starts.tolist():
            smooth = np.stack([np.eye(6) * (i / 20) ** 0.5 + 0.5 for i in range(1, 21)])
            q, _ = np.linalg.qr(smooth.reshape(-1, 6))
            basis[k : k + 20] = q.reshape(20, 6, 6)
            noise[k : k + 20] -= (q @ (q.T @ noise[k : k + 20].ravel())).reshape(20, 6)
        p_values.append(whiteness(Residuals(np.zeros((50, 6)), noise, np.zeros((1000, 6, 0)), None, basis), starts))
    assert np.mean(np.array(p_values) < 0.05) < 0.1
    assert whiteness(Residuals(np.zeros((50, 6)), noise, np.zeros((1000, 6, 0))), starts) < 1e-3


def test_white_residuals_are_told_from_correlated_ones():
    """The p-value is uniform for white noise, and small for errors that last for two rows."""
    rng, starts = np.random.default_rng(2), np.array([0, 250, 500, 750])

    def of(errors, seen=None):
        return Residuals(np.zeros((4, 6)), errors, np.zeros((1000, 6, 0)), seen)

    p_values = [whiteness(of(rng.standard_normal((1000, 6))), starts) for _ in range(200)]
    assert kstest(p_values, "uniform").pvalue > 0.01
    noise = rng.standard_normal((1001, 6))
    assert whiteness(of(noise[1:] + noise[:-1]), starts) < 1e-10
    slow = np.ones((1000, 6), dtype=bool)
    slow[np.arange(1000) % 5 > 0, :2] = False  # two measurements in every fifth row
    p_values = [whiteness(of(rng.standard_normal((1000, 6)) * slow, slow), starts) for _ in range(200)]
    assert kstest(p_values, "uniform").pvalue > 0.01


def test_forces_per_coefficient_add_up_to_the_equations_of_motion():
    """Linear in the coefficients: by hand for a vehicle with quadratic drag, at the accelerations of a known force."""
    u, v, r, X, N = np.random.default_rng(3).standard_normal((5, 50))
    p = {**HULL_TRUE, **DRAG_TRUE}
    accelerations = np.array([
        (X + p["m22"] * v * r - (p["d11"] + p["X_uu"] * abs(u)) * u) / p["m11"],
        (-p["m11"] * u * r - (p["d22"] + p["Y_vv"] * abs(v)) * v) / p["m22"],
        (N + (p["m11"] - p["m22"]) * u * v - (p["d33"] + p["N_rr"] * abs(r)) * r) / p["m33"],
    ])  # fmt: skip
    terms = regressors(np.array([u, v, r]), accelerations)
    forces = np.einsum("eht,h->et", terms, [TRUE[name] for name in COEFFICIENTS])
    np.testing.assert_allclose(forces, [X, 0 * X, N], atol=1e-9)


def test_simple_predictions_are_exact_for_a_vehicle_that_obeys_them():
    """A steady turn for constant velocities; a yaw rate that follows its command with a lag for Nomoto's model."""
    t, dt, starts = np.arange(0.0, 30.0, 0.01), 0.01, np.array([0])
    command = np.where((t < 10) | (t % 6 < 3), 1.0, -0.5)
    r = np.full(len(t), 0.08)
    for k in range(len(t) - 1):
        r[k + 1] = r[k] + dt / 2.0 * (0.1 * (command[k] - 0.2) - r[k])  # T = 2 s, K = 0.1 1/s, neutral = 0.2

    def log_of(r):
        psi = np.concatenate(([0.0], np.cumsum(dt * 0.5 * (r[1:] + r[:-1]))))
        x, y = (np.concatenate(([0.0], np.cumsum(dt * side(psi[1:])))) for side in (np.cos, np.sin))
        return Log(t, np.column_stack((x, y, psi, np.ones(len(t)), 0 * t, r)), np.column_stack((command, command)))

    turning, steady = log_of(r), log_of(0 * r + 0.1)
    np.testing.assert_allclose(nomoto(turning, turning, starts, 10.0), turning.measured, atol=1e-9)
    np.testing.assert_allclose(constant_velocity(steady, starts, 10.0), steady.measured, atol=1e-9)


def scaled(log, factor, turn=1.0):
    """Return a log with `factor` times the lengths, speeds and surge commands, and `turn` times the yaw commands."""
    measured = log.measured * (factor, factor, 1.0, factor, factor, 1.0)
    return replace(log, measured=measured, commands=log.commands * (factor, turn))


def test_runs_beyond_the_fit_are_named(log):
    """Ahead and astern differ, port and starboard do not."""

    def beyond(*runs):
        return [(e.run, e.name) for e in extrapolations(log, joined(runs), np.array(NOISE.noise))]

    assert beyond(log, scaled(log, 0.9), scaled(log, 1.03)) == []  # within the margin
    assert beyond(log, scaled(log, 1.5)) == [(1, "u"), (1, "|v|"), (1, "F_u")]
    assert beyond(scaled(log, -0.9)) == [(0, "u"), (0, "F_u")]  # astern
    assert beyond(log, log, scaled(log, 1.0, 1.4)) == [(2, "|F_r|")]
    mirrored = replace(log, measured=log.measured * (1, -1, -1, 1, -1, -1), commands=log.commands * (1, -1))
    assert beyond(mirrored) == []
    (_, found) = extrapolations(log, scaled(log, -0.9), np.array(NOISE.noise))
    assert found.fitted == (log.commands[:, 0].min(), log.commands[:, 0].max())
    assert found.reached == pytest.approx((-0.9 * found.fitted[1], -0.9 * found.fitted[0]))
    one, none = np.zeros((1, 6)), np.zeros(1, dtype=np.int64)
    result = HeldOut(log, Windows(15.0, 60.0), np.zeros(1), none, {"model": one}, None, (), one, (found,))
    low, high = found.fitted
    expected = (
        f"Run 1: F_u is {-0.9 * high:.3g} to {-0.9 * low:.3g} N, in the fit {low:.3g} to {high:.3g}: this prediction"
    )
    assert f"{expected} is an extrapolation." in held_out_text(result, "log")


def test_related_residuals_widen_the_intervals():
    """The slope of a line through errors of an autoregressive process: against drawing it again and again."""
    T, rho, rng = 2000, 0.7, np.random.default_rng(1)
    slopes = np.zeros((T, 6, 1))
    slopes[:, 3, 0] = np.cos(np.arange(T) / 150)
    errors = np.zeros((400, T))
    for k in range(1, T):
        errors[:, k] = rho * errors[:, k - 1] + math.sqrt(1 - rho**2) * rng.standard_normal(400)
    estimates = errors @ slopes[:, 3, 0] / (slopes[:, 3, 0] @ slopes[:, 3, 0])
    residuals = np.zeros((T, 6))
    residuals[:, 3] = errors[0]
    spread = covariance(Residuals(np.zeros((1, 6)), residuals, slopes), np.array([0]))[0, 0]
    assert spread == pytest.approx(estimates.var(), rel=0.4)
    assert spread > 3 / (slopes[:, 3, 0] @ slopes[:, 3, 0])


DRAG = WindDrag(0.08, 0.2, 0.05, 0.1)


@given(st.floats(0.1, 20.0), st.floats(-math.pi, math.pi))
def test_wind_goes_with_its_angle_as_fossen_has_it(speed, angle):
    X, Y, N = wind_load(speed * math.cos(angle), speed * math.sin(angle), DRAG)
    assert -X == pytest.approx(DRAG.X_air * speed**2 * math.cos(angle), abs=1e-6)
    assert -Y == pytest.approx(DRAG.Y_air * speed**2 * math.sin(angle), abs=1e-6)
    turn = DRAG.N_air * math.sin(angle) + 0.5 * DRAG.N_turn * math.sin(2 * angle)
    assert -N == pytest.approx(speed**2 * turn, abs=1e-6)


def columns(log, **changes):
    """Return a log's columns by name, some of them replaced by functions of themselves."""
    table = dict(zip(log.columns, log.table.T, strict=True))
    return table | {name: change(table[name]) for name, change in changes.items()}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"psi": np.degrees}, "psi changes 57 times as fast as r: it looks like degrees"),
        ({"r": np.degrees}, "r is 57 times the rate of psi: it looks like degrees"),
        ({"psi": np.degrees, "r": np.degrees}, "psi looks like degrees"),
        ({"psi": np.negative, "r": np.negative}, "psi seems to have the opposite sign"),
        ({"u": lambda u: u / 0.5144, "v": lambda v: v / 0.5144}, "u and v look like knots"),
        ({"t": lambda t: t[::-1]}, r"t goes from 60 to 59.9 s in data row 2; time must increase"),
        ({"x": lambda x: np.where(np.arange(len(x)) == 4, np.nan, x)}, "x in data row 5 is nan; every entry must be"),
        ({"F_u": lambda F: 0 * F, "F_r": lambda F: 0 * F}, "is 0 throughout"),
        ({"y": lambda y: 1e200 * y}, "y in data row 1 is .*; every entry must be a number of at most 1e.12"),
        ({name: lambda w: 1e-20 * w for name in ("x", "y", "u", "v", "r")}, "the vehicle must move"),
        ({"F_r": lambda F: 0 * F}, "F_r is 0 throughout, but the vehicle turns"),
        ({"t": lambda t: t + 30 * (t > 30)}, "t has a gap of 30.1 s"),
    ],
)
def test_a_log_that_cannot_be_is_refused(log, changes, says):
    table = np.column_stack(list(columns(log, **changes).values()))
    with pytest.raises(ValueError, match=says):
        Log(table[:, 0], table[:, 1:7], table[:, 7:])


def turned(angle):
    return lambda psi: psi + angle


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"x": np.negative}, "x seems to have the opposite sign; .* x = { column = .x., scale = -1 }"),
        ({"y": np.negative}, "y seems to have the opposite sign"),
        ({"psi": np.negative}, "psi seems to have the opposite sign; .* scale = -1 }$"),
        ({"psi": np.negative, "r": np.negative}, "psi seems to have the opposite sign; .* and r with scale = -1"),
        ({"u": np.negative}, "turned by 180 degrees"),
        ({"v": np.negative}, "v has the opposite sign of the sway that positions show"),
        ({"r": np.negative}, "^r has the opposite sign of the rate of psi"),
        ({"F_u": np.negative}, "F_u has the opposite sign of the change of u"),
        ({"F_r": np.negative}, "F_r has the opposite sign of the change of r"),
        ({"psi": turned(math.pi / 2)}, "turned by -90 degrees; .* offset = 1.5"),
        ({"psi": turned(-math.pi / 2)}, "turned by 90 degrees"),
        ({"psi": turned(math.pi)}, "turned by 180 degrees"),
        ({"psi": turned(0.5)}, r"turned by -2\d degrees; .* offset = 0.[45]"),
        ({"psi": lambda psi: math.pi / 2 - psi}, "psi seems to have the opposite sign; .* scale = -1, offset = 1.5"),
        ({"t": lambda t: 1e3 * t}, "t looks like ms"),
        ({"t": lambda t: 1e6 * t}, "t looks like us"),
    ],
)
def test_each_contradiction_of_signs_and_axes_is_named(log, changes, says):
    """With precise positions, and with those of a receiver with an error of half a metre."""
    rough = example(PAPER_VEHICLE, EXAMPLE_ACTUATORS, replace(NOISE, position=0.5, velocity=0.05), 4)
    for one in (log, rough):
        table = np.column_stack(list(columns(one, **changes).values()))
        with pytest.raises(ContradictionError, match=says):
            Log(table[:, 0], table[:, 1:7], table[:, 7:])


def test_speeds_along_the_axes_of_the_positions_are_named(log):
    c, s = np.cos(log.measured[:, 2]), np.sin(log.measured[:, 2])
    measured = log.measured.copy()
    measured[:, 3], measured[:, 4] = to_world(log.measured[:, 3], log.measured[:, 4], c, s)
    with pytest.raises(ContradictionError, match='in a format: velocity = "world"'):
        replace(log, measured=measured)


def test_no_contradiction_is_seen_in_right_logs():
    """Noise over two decades, currents up to 0.4 m/s, lags up to 1.5 s, speeds over ground and through water."""
    rng = np.random.default_rng(0)
    for _ in range(40):
        position, heading, velocity, yaw_rate = np.array([0.01, 0.003, 0.01, 0.001]) * 10 ** rng.uniform(
            0, [2, 1, 1, 1.5]
        )
        current = tuple(rng.uniform(-0.4, 0.4, 2).tolist())
        plant = Simulated(PAPER_VEHICLE, Actuators(lag=rng.uniform(0, 1.5)), current)
        log = recorded(plant, Trial(), Sensors(position, heading, velocity, yaw_rate), rng, current)
        c, s = np.cos(log.measured[:, 2]), np.sin(log.measured[:, 2])
        through = np.column_stack(to_body(*current, c, s))
        replace(log, measured=log.measured - np.column_stack((np.zeros((len(c), 3)), through, 0 * c)))


def test_a_limit_that_no_command_reaches_is_not_identified():
    far = Simulated(PAPER_VEHICLE, Actuators(5000.0, 5000.0, lag=0.4), EXAMPLE_CURRENT)
    log = recorded(far, Trial(300.0, 150.0), NOISE, np.random.default_rng(1), EXAMPLE_CURRENT)
    fitted = identify(log)
    assert fitted["F_u_max"].verdict == fitted["F_r_max"].verdict == UNREACHED


@pytest.mark.slow
@pytest.mark.parametrize("held", [True, False])
def test_slow_positions_give_intervals_that_hold(held, tmp_path):
    """Fixes at 5 Hz that are held in rows at 10 Hz, or at 2 Hz with blanks between them."""
    true = TRUE | dict.fromkeys(COEFFICIENTS, 0.0) | {name: getattr(PAPER_VEHICLE, name) for name in HULL_TRUE}
    true |= {"F_u_max": 400.0, "F_r_max": 200.0, "lag": 0.4}
    inside, lags = [], []
    for seed in range(12):
        log = example(PAPER_VEHICLE, EXAMPLE_ACTUATORS, NOISE, seed)
        table, rows = log.table, np.arange(len(log.t))
        if held:
            table[:, 1:3] = table[rows // 2 * 2, 1:3]
        else:
            table[rows % 5 > 0, 1:3] = np.nan
        np.savetxt(tmp_path / "log.csv", table, "%.9g", ",", header=",".join(log.columns), comments="")
        fitted = identify(Log.load(tmp_path / "log.csv"))
        inside += [e.low <= true[e.name] <= e.high for e in fitted.estimates if true[e.name]]
        lags.append(fitted["lag"].value)
    assert np.mean(inside) > 0.85
    assert np.mean(lags) == pytest.approx(0.4, rel=0.02)


def test_logs_of_wrong_shapes_and_axes_and_short_ones_are_refused(log):
    swapped, wind = log.measured[:, [1, 0, 2, 3, 4, 5]], log.measured[1:, :2]
    for columns, says in (
        ((log.t, log.measured[:, :5], log.commands), r"measured of shape \(\d+, 5\); it must be \(\d+, 6\)"),
        ((log.t, log.measured, log.commands, "force", wind), r"wind of shape \(\d+, 2\); it must be \(\d+, 2\)"),
        ((log.t, swapped, log.commands), "x and y look interchanged"),
        ((log.t[:40], log.measured[:40], log.commands[:40]), "the log has 40 rows; it must have 50 to"),
    ):
        with pytest.raises(ValueError, match=says):
            Log(*columns)
    with pytest.raises(ValueError, match="there is no log"):
        joined([])
    with pytest.raises(ValueError, match="'m11' is not an optional parameter of a vehicle; allowed are X_uu"):
        identify(log, ("m11",))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "there is no column 't'; the first line must name t [s], x [m]"),
        ("t,x,y,psi,u,v,r,F_u,F_r\n", "the log has no rows; it must have 50 to"),
        ("t,x,y,psi [gon],u,v,r,F_u,F_r\n", "psi is in 'gon'; allowed are rad, deg"),
        ("t,x,y,psi,u,v,r,F_u,F_r\n0,0,0,east,0,0,0,0,0\n", "psi in data row 1 is 'east'; it must be a number"),
    ],
)
def test_a_wrong_file_is_one_line(text, says, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text(text, encoding="utf-8")
    assert run(main, PROGRAM, ["log.csv"]) == 2
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([], "no LOG is given"),
        (["log.csv", "--example"], "log.csv exists; --example does not replace a log"),
        (["log.csv", "--known", "m11=-5"], "--known m11=-5 must be NAME=VALUE"),
        (["log.csv", "--known", "V_x=0.5", "--still-water"], "--still-water excludes --known V_x"),
        (["log.csv", "--out", "log.csv"], "--out log.csv is not a folder"),
    ],
)
def test_wrong_options_are_one_line_and_change_nothing(words, says, log, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    log.save("log.csv")
    before = Path("log.csv").read_bytes()
    assert run(main, PROGRAM, words) == 2
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1
    assert Path("log.csv").read_bytes() == before
    assert [file.name for file in Path().iterdir()] == ["log.csv"]


@pytest.mark.slow
def test_the_command_writes_a_vehicle_that_scenarios_take(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(main, PROGRAM, ["log.csv", "--example", "--seed", "3"]) == 0
    assert Log.load("log.csv").duration == pytest.approx(60)
    assert run(main, PROGRAM, ["log.csv", "--terms", "X_uu", "--out", "out"]) == 0
    printed = capsys.readouterr().out
    assert "m11" in printed
    vehicle = as_vehicle("out/vehicle.toml")
    assert vehicle.m11 == pytest.approx(215, rel=0.05)
    storm = changed(PRESETS["cruise-storm"], "out/vehicle.toml")
    np.testing.assert_allclose(storm.sensors.noise, NOISE.noise, rtol=0.2)  # of the log, whatever the vehicle's size
    scenario = Scenario.load("out/scenario.toml")
    assert scenario.vehicle.m22 == pytest.approx(vehicle.m22, rel=1e-5)
    assert scenario.actuators.lag == pytest.approx(0.4, abs=0.05)
    text = Path("out/report.md").read_text(encoding="utf-8")
    assert "fit.png" in text
    assert "| m11 " in text
    assert run(main, PROGRAM, ["new.csv", "--example", "--seed", "1"]) == 0
    assert run(main, PROGRAM, ["log.csv", "--terms", "X_uu", "--holdout", "new.csv", "--out", "out"]) == 0
    text = Path("out/report.md").read_text(encoding="utf-8")
    assert "## Held-out runs" in text
    assert "| constant velocity |" in text
    assert run(main, PROGRAM, ["none.csv"]) == 1
    assert run(main, PROGRAM, ["log.csv", "--like", "canoe"]) == 2
    assert "unknown vehicle 'canoe'" in capsys.readouterr().err


def test_the_ensemble_has_the_distribution_of_the_fit(fitted):
    several = fitted.ensemble(400, seed=1)
    shown = [name for name in fitted.free if name in COEFFICIENTS]
    at = [fitted.free.index(name) for name in shown]
    spread = np.sqrt(np.diag(fitted.covariance))[at]
    drawn = np.array([[getattr(v, name) for name in shown] for v in several])
    means = np.array([fitted[name].value for name in shown])
    assert (np.abs(drawn.mean(axis=0) - means) < 4 * spread / 20).all()
    np.testing.assert_allclose(drawn.std(axis=0), spread, rtol=0.2)


def test_episodes_of_an_ensemble_have_its_vehicles(fitted):
    """Also in the units of the vehicle."""
    several = fitted.ensemble(3)
    scenario = files.scenario(fitted, fitted.vehicle(), files.limits_of(fitted), several)
    assert Scenario.from_dict(scenario.to_dict()) == scenario
    env, true = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario=scenario), set()
    for seed in range(8):
        env.reset(seed=seed)
        true.add(tuple(env.unwrapped._truth()[2].coefficients))
    assert true <= {tuple(v.all_coefficients) for v in several}
    assert len(true) > 1
    for row, vehicle in zip(in_vehicle_units(scenario).mismatch.vehicles, several, strict=True):
        assert row[1] / row[0] == pytest.approx(vehicle.m22 / vehicle.m11)
        drag = vehicle.d11 / vehicle.m11 * fitted.vehicle().time
        assert row[3] / row[0] * PAPER_VEHICLE.time == pytest.approx(drag)
    with pytest.raises(ValueError, match=r"mismatch vehicles has a row of 2 numbers; for this vehicle it must have 13"):
        replace(scenario, mismatch=replace(scenario.mismatch, vehicles=((1.0, 2.0),)))


@pytest.mark.slow
def test_a_log_without_a_turn_gives_a_report_and_no_vehicle(straight, ahead, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "identify", lambda *_: ahead)
    straight.save("log.csv")
    assert run(main, PROGRAM, ["log.csv", "--out", "out"]) == 1
    assert "no vehicle.toml: the log does not show" in capsys.readouterr().out
    assert {p.name for p in Path("out").iterdir()} == {"report.md", "fit.png", "residuals.png"}
    assert "No vehicle.toml: the log does not show" in Path("out/report.md").read_text(encoding="utf-8")
    assert run(main, PROGRAM, ["log.csv", "--like", "paper", "--out", "out"]) == 0
    assert "m33 = 80.0  # [kg m^2] not from the log" in Path("out/vehicle.toml").read_text(encoding="utf-8")


@pytest.mark.slow
def test_speeds_through_the_water_serve_too():
    log = example(PAPER_VEHICLE, Actuators(lag=0.4), NOISE, 1)
    c, s = np.cos(log.measured[:, 2]), np.sin(log.measured[:, 2])
    V_x, V_y = EXAMPLE_CURRENT
    measured = log.measured.copy()
    measured[:, 3] -= c * V_x + s * V_y
    measured[:, 4] -= c * V_y - s * V_x
    fitted = identify(replace(log, measured=measured), (), over_ground=False)
    assert fitted["V_x"].value == pytest.approx(V_x, abs=0.01)
    assert fitted["m22"].value == pytest.approx(265, rel=0.02)
