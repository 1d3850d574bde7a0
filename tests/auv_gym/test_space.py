"""Motion in space: against six degrees of freedom with a constraint, the equations of the plane, energy, rotations."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from vehicle_sources import nps_auv2, strips

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics import dynamics
from auv_gym.physics.space import (
    SPACE_ROWS,
    Pitch,
    SpaceVehicle,
    axes,
    from_ned,
    rk4_step,
    state_rates,
    to_ned,
    tracking_errors,
)
from auv_gym.physics.vehicle import PAPER_2007, PAPER_VEHICLE
from auv_gym.scenarios.vehicles import PAPER, VEHICLES_FOLDER, VehicleModel, vehicle_model

TORPEDOES = ("lauv", "eca-a9", "nps-auv2", "remus100")
CROSSED = replace(PAPER_2007, Y_uv=60.0, Y_ur=40.0, N_uv=25.0, N_ur=30.0, X_vv=9.0, X_vr=-30.0, Y_rv=70.0, N_vr=35.0)
ROUND = SpaceVehicle(replace(CROSSED, eps=0.3), replace(CROSSED, eps=0.3))
VEHICLES = {
    "paper": PAPER.in_space,
    "round": replace(ROUND, stiffness=20.0, buoyancy=-7.0),
    "other": SpaceVehicle(CROSSED, replace(CROSSED, m22=400.0, m33=130.0, Y_vv=90.0), 20.0, 5.0, False),
} | {name: vehicle_model(name).in_space for name in TORPEDOES}
EACH = pytest.mark.parametrize("name", VEHICLES)

unit = st.floats(-1.0, 1.0)
states = st.tuples(*[unit.map(lambda x, top=top: top * x) for top in (50, 50, 50, 1.4, 4, 2, 1, 1, 1, 1)])
loads = st.tuples(*[unit.map(lambda x, top=top: top * x) for top in (400, 0, 0, 200, 200)])


def damping(vehicle, nu, whole):
    """Return the matrix of drag and lift (6, 6) of velocities at the origin; `whole` is |v|, |w|, |q|, |r| of drag."""
    u = abs(nu[0])
    D, loss = np.zeros((6, 6)), 0.0
    for plane, (i, k), sign in ((vehicle.horizontal, (1, 5), 1.0), (vehicle.vertical, (2, 4), -1.0)):
        slip, turn = whole[i], whole[k]
        D[i, i] = plane.d22 + plane.Y_uv * u + plane.Y_vv * slip + plane.Y_rv * turn
        D[i, k] = sign * (plane.d23 - plane.Y_ur * u + plane.Y_vr * slip + plane.Y_rr * turn)
        D[k, i] = sign * (plane.d32 - plane.N_uv * u + plane.N_vv * slip + plane.N_rv * turn)
        D[k, k] = plane.d33 + plane.N_ur * u + plane.N_rr * turn + plane.N_vr * slip
        a, b = nu[i], sign * nu[k]
        loss += plane.X_vv * a * a + plane.X_vr * a * b + plane.X_rr * b * b
    D[0, 0] = vehicle.horizontal.d11 + vehicle.horizontal.X_uu * u
    return D, loss


def six(vehicle, state, load):
    """Return the rates of u, v, w, q, r at the origin from six degrees of freedom with the constraint of no roll.

    M nu' + C(nu) nu + D nu + g = tau + lambda (0, 0, 0, 1, 0, tan theta), without inertia in roll.
    """
    theta, u, v, w, q, r = state[3], *state[5:]
    level, upright = vehicle.horizontal, vehicle.vertical
    tan = math.tan(theta)
    nu = np.array([u, v, w, -r * tan, q, r])
    masses = np.array([level.m11, level.m22, upright.m22, 0.0, upright.m33, level.m33])
    linear, angular = (masses * nu)[:3], (masses * nu)[3:]
    C_nu = np.concatenate((np.cross(nu[3:], linear), np.cross(nu[3:], angular) + np.cross(nu[:3], linear)))
    whole = [0.0, *map(abs, nu[1:])]
    if vehicle.of_revolution:
        whole[1] = whole[2] = math.hypot(v, w)
        whole[4] = whole[5] = math.hypot(q, r)
    D, loss = damping(vehicle, nu, whole)
    axis = np.array(axes(theta, 0.0))
    buoyancy = axis @ [0.0, 0.0, vehicle.buoyancy]
    weight = np.cross([0.0, 0.0, vehicle.stiffness], axis @ [0.0, 0.0, 1.0])  # buoyancy acts above the origin
    X, Y, Z, M, N = load
    arms = [p.m33 / (p.m22 * p.eps) if p.eps else math.inf for p in (level, upright)]
    tau = np.array([X - loss, Y - N / arms[0], Z + M / arms[1], 0.0, M, N]) + np.concatenate((buoyancy, weight))
    J = np.array([0.0, 0.0, 0.0, 1.0, 0.0, tan])
    full = np.block([[np.diag(masses), -J[:, None]], [J[None], np.zeros((1, 1))]])
    rates = np.linalg.solve(full, [*(tau - C_nu - D @ nu), -q * r / math.cos(theta) ** 2])
    return rates[[0, 1, 2, 4, 5]]


@EACH
@given(state=states, load=loads)
def test_rates_are_those_of_six_degrees_of_freedom_without_roll(name, state, load):
    vehicle = VEHICLES[name]
    got, eps = state_rates(state, load, vehicle.acting), vehicle.horizontal.eps
    v, w = state[6] - eps * state[9], state[7] + eps * state[8]  # of the origin
    u_dot, v_dot, w_dot, q_dot, r_dot = six(vehicle, (*state[:6], v, w, *state[8:]), load)
    expected = [u_dot, v_dot + eps * r_dot, w_dot - eps * q_dot, q_dot, r_dot]
    scale = 1 + np.abs(expected).max()
    np.testing.assert_allclose(got[5:], expected, rtol=0, atol=1e-11 * scale)
    theta, psi, u, v, w, q, r = state[3:]
    np.testing.assert_allclose(got[:3], np.transpose(axes(theta, psi)) @ [u, v, w], rtol=0, atol=1e-12)
    np.testing.assert_allclose(got[3:5], [q, r / math.cos(theta)], rtol=1e-12)


@EACH
@given(state=states, load=loads)
def test_level_motion_is_that_of_the_plane_to_the_last_bit(name, state, load):
    x, y, _, _, psi, u, v, _, _, r = state
    vehicle = replace(VEHICLES[name], buoyancy=0.0)
    load, flat_load, current = (load[0], 3.0, 0, 0, load[4]), (load[0], 3.0, load[4]), (0.2, -0.1, 0.0)
    after = rk4_step((x, y, 0, 0, psi, u, v, 0, 0, r), load, vehicle.acting, 0.1, current)
    flat = dynamics.rk4_step((x, y, psi, u, v, r), flat_load, vehicle.horizontal.acting, 0.1, current[:2])
    assert [after[k] for k in (0, 1, 4, 5, 6, 9)] == list(flat)
    assert [after[k] for k in (2, 3, 7, 8)] == [0.0] * 4


@given(state=states)
def test_vertical_motion_of_a_neutral_body_is_that_of_the_plane(state):
    """In the plane y = 0 the vehicle is a planar one on its side: x, z, -theta; u, w, -q."""
    x, _, z, theta, _, u, _, w, q, _ = state
    after = rk4_step((x, 0, z, theta, 0, u, 0, w, q, 0), (9.0, 0, 3.0, -5.0, 0), ROUND.acting, 0.01)
    flat = dynamics.rk4_step((x, z, -theta, u, w, -q), (9.0, 3.0, 5.0), ROUND.horizontal.acting, 0.01)
    np.testing.assert_allclose(
        [after[k] for k in (0, 2, 3, 5, 7, 8)], np.multiply(flat, (1, 1, -1, 1, 1, -1)), atol=1e-13
    )


@given(state=states, load=loads)
def test_energy_changes_by_what_loads_and_damping_give(state, load):
    vehicle = VEHICLES["other"]
    level, upright = vehicle.horizontal, vehicle.vertical
    masses = np.array([level.m11, level.m22, upright.m22, upright.m33, level.m33])
    rates, nu = state_rates(state, load, vehicle.acting), np.array(state[5:])
    power = masses * nu @ rates[5:] - vehicle.buoyancy * rates.z + vehicle.stiffness * math.sin(state[3]) * rates.theta
    six_nu = np.array([*nu[:3], 0.0, *nu[3:]])
    D, loss = damping(vehicle, six_nu, np.abs(six_nu))
    expected = np.dot(load, nu) - six_nu @ D @ six_nu - loss * nu[0]
    assert power == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_motion_of_a_neutral_body_of_revolution_does_not_depend_on_the_axes_of_the_world():
    rng = np.random.default_rng(1)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.linalg.det(turn)

    def seen(state):
        """Return position, axis, velocity and rate of the axis in the world."""
        rows = np.array(axes(*state[3:5]))
        return np.array([state[:3], rows[0], state[5:8] @ rows, state[9] * rows[1] - state[8] * rows[2]])

    def turned(state):
        position, axis, velocity, rate = seen(state) @ turn.T
        theta, psi = -math.asin(axis[2]), math.atan2(axis[1], axis[0])
        rows = np.array(axes(theta, psi))
        return [*position, theta, psi, *rows @ velocity, -rows[2] @ rate, rows[1] @ rate]

    one = [0.0, 0.0, 0.0, 0.3, 0.2, 1.0, 0.1, -0.2, 0.15, 0.2]
    other = turned(one)
    assert abs(other[3]) < 1.0
    for _ in range(400):
        one, other = (rk4_step(s, (70.0, 0, 0, 0, 0), ROUND.acting, 0.01) for s in (one, other))
    np.testing.assert_allclose(seen(other), seen(one) @ turn.T, atol=1e-10)


@EACH
@given(state=states, load=loads)
def test_north_east_down_has_the_same_equations_with_the_other_buoyancy(name, state, load):
    vehicle = VEHICLES[name]
    other, (X, Y, Z, M, N) = replace(vehicle, buoyancy=-vehicle.buoyancy), load
    down = state_rates(to_ned(state), (X, -Y, -Z, -M, -N), other.acting)
    np.testing.assert_allclose(from_ned(down), state_rates(state, load, vehicle.acting), rtol=1e-12, atol=1e-12)


@EACH
def test_the_compiled_step_gives_the_numbers_of_python(name):
    rng = np.random.default_rng(0)
    state, load = 0.3 * rng.normal(size=(10, 8)), rng.normal(size=(5, 8))

    def equation(state, load, vehicle):
        return {"after": rk4_step(state, load, vehicle, 0.05, (0.1, 0.2, 0.3), SYMBOLS)}

    row = np.array(VEHICLES[name].acting)
    kernel = Kernel.traced(equation, {"state": 10, "load": 5, "vehicle": SPACE_ROWS}, shared=["vehicle"])
    after = kernel(state=state, load=load, vehicle=row)["after"]
    for k in range(8):
        python = rk4_step(state[:, k], load[:, k], row, 0.05, (0.1, 0.2, 0.3))
        np.testing.assert_allclose(after[:, k], python, rtol=1e-12, atol=1e-12)


@given(state=states, reference=states)
def test_errors_of_the_axis_and_of_the_position_are_those_of_vectors(state, reference):
    rows, rows_R = np.array(axes(*state[3:5])), np.array(axes(*reference[3:5]))
    errors = tracking_errors(state, reference)
    np.testing.assert_allclose(errors[:3], rows @ np.subtract(state[:3], reference[:3]), atol=1e-11)
    theta_e, psi_e = errors.theta_e, errors.psi_e
    n = [math.cos(theta_e) * math.cos(psi_e), -math.cos(theta_e) * math.sin(psi_e), math.sin(theta_e)]
    np.testing.assert_allclose(n, rows @ rows_R[0], atol=1e-12)


def test_pitch_of_the_published_vehicles_is_that_of_their_sources():
    m, (r2, r3, r4, r5) = 53400 / 9.81, (0.5 * 1025 * 5.3**n for n in (2, 3, 4, 5))
    m11, heave = nps_auv2()["m11"], m + 0.24 * r3
    nps = {"m22": heave, "m33": 13587 + 1.7e-2 * r5, **strips(0.5 * 1025 * 0.6 * 0.53, 5.3, count=10)}
    nps |= {
        "X_vv": -0.17 * r2,
        "X_vr": heave - m - 0.2 * r3,
        "X_rr": 1.5e-2 * r4,
        "Y_uv": 0.3 * r2,
        "N_ur": 6.8e-2 * r4,
    }
    nps |= {"Y_ur": 0.14 * r3 - (m - m11), "N_uv": heave - m11 - 0.1 * r3, "d22": 0.03 * r2, "d33": 6.8e-3 * r4}
    aspect, area = 0.19 / (0.7 * 1.6), 0.5 * 1026 * 0.7 * 1.6 * 0.19
    lift = area * math.pi * aspect / (1 + math.sqrt(1 + (aspect / 2) ** 2)) + 0.5 * 1026 * 0.42 * math.pi * 0.095**2
    stiffness = {"lauv": 18 * 9.81 * 0.01, "eca-a9": 69.7 * 9.81 * 0.06, "nps-auv2": 53400 * 0.061}
    remus = {"Y_uv": lift, "d22": 60.47 / 20, "d33": 1.6 * math.sqrt(31.03 * 9.81 * 0.02 * 7.45), "Y_vv": 0.0}
    eca = {"m22": 69.7 + 75, "m33": 30 + 27, "Y_uv": 108, "Y_ur": 100, "N_uv": -37, "N_ur": 20}
    for name, numbers in {"lauv": {}, "nps-auv2": nps, "remus100": remus, "eca-a9": eca}.items():
        vehicle = vehicle_model(name).in_space
        assert {key: getattr(vehicle.vertical, key) for key in numbers} == pytest.approx(numbers, rel=5e-3)
        assert vehicle.stiffness == pytest.approx(stiffness.get(name, 31.03 * 9.81 * 0.02), rel=5e-3)
    assert vehicle_model("nps-auv2").pitch.fin == pytest.approx(4.1e-2 * r3 * math.radians(20), rel=5e-3)
    assert vehicle_model("remus100").pitch.fin == pytest.approx(
        0.5 * 1026 * 0.0133 * 0.7 * 0.8 * math.radians(15), rel=5e-3
    )


def test_without_a_table_both_planes_are_equal_and_units_do_not_matter():
    otter = vehicle_model("otter").in_space
    assert otter.horizontal == otter.vertical
    for name in TORPEDOES:
        mine = vehicle_model(name)
        own, paper, (length, time) = (
            mine.in_space,
            mine.in_paper_units.in_space,
            (mine.vehicle.length, mine.vehicle.time),
        )
        scale = np.array([length / PAPER_VEHICLE.length] * 3 + [1, 1] + [1] * 5)
        scale[5:] = (scale[0], scale[0], scale[0], 1, 1)
        scale[5:] /= time / PAPER_VEHICLE.time
        state = np.array([0, 0, 0, 0.2, 0.1, 1.0, 0.1, -0.1, 0.2, 0.1])
        rates = np.array(state_rates(state * scale, (0,) * 5, own.acting)) * time / PAPER_VEHICLE.time / scale
        np.testing.assert_allclose(rates, state_rates(state, (0,) * 5, paper.acting), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Pitch(parameters={"m11": 3.0}), "no entry 'm11'; allowed are m22, m33"),
        (lambda: Pitch(parameters={"m22": 300.0}).vehicle(PAPER_VEHICLE), "set of_revolution = false"),
        (
            lambda: SpaceVehicle(PAPER_VEHICLE, replace(PAPER_VEHICLE, d11=3.0)),
            "d11 = 70.0 and 3.0; it must be the same",
        ),
        (lambda: SpaceVehicle(PAPER_VEHICLE, PAPER_VEHICLE, -1.0), "stiffness"),
    ],
)
def test_wrong_vehicles_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_a_wrong_table_is_refused_with_its_entry(tmp_path):
    text = (VEHICLES_FOLDER / "lauv.toml").read_text(encoding="utf-8")
    (tmp_path / "mine.toml").write_text(text.replace("stiffness =", "stifness ="), encoding="utf-8")
    with pytest.raises(ValueError, match="pitch has no entry 'stifness' \\(did you mean 'stiffness'\\?\\)"):
        VehicleModel.load(tmp_path / "mine.toml")
