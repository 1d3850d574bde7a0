"""Vehicles with six degrees of freedom: compared with Fossen's matrix form, the plane, and another simulator."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matrix_forms import otter_acceleration, remus_acceleration
from scipy import stats
from scipy.spatial.transform import Rotation

from auv_gym.effects.mismatch import RandomMismatch
from auv_gym.physics.dynamics import from_outside, rk4_step
from auv_gym.physics.namespaces import ARRAYS, FLOATS
from auv_gym.physics.vehicle import Coefficients
from auv_gym.scenarios.presets import as_scenario
from baselines import make_policy
from baselines.evaluation.cells import drawn
from baselines.evaluation.plants import input_names, moved_by
from baselines.evaluation.rollout import rollout
from baselines.identification.log import Log
from research.transfer import comparison, otter, remus100, trials
from research.transfer.comparison import concordance, pooled
from research.transfer.simulators import SIX_DOF_MODELS, SixDofSimulator, deviation
from research.transfer.six_dof import (
    AS_PUBLISHED,
    ModelInputs,
    SpatialMotion,
    coriolis,
    cross_flow,
    place_rates,
)

ROOT = Path(__file__).parents[2]
NO_INPUT = ModelInputs(*[0.0] * 7)


REFERENCE = {"remus100": remus_acceleration, "otter": otter_acceleration}
SIZES = {"remus100": (0.2, 0.2, 1500.0), "otter": (90.0, 90.0)}


@pytest.mark.parametrize("name", REFERENCE)
def test_accelerations_are_those_of_the_matrix_form(name):
    rng, model = np.random.default_rng(0), SIX_DOF_MODELS[name]
    for _ in range(40):
        eta = rng.normal(size=6) * [5, 5, 0.3, 0.2, 0.2, 2]
        nu = rng.normal(size=6) * [1, 0.3, 0.2, 0.2, 0.2, 0.3]
        act = rng.uniform(-1, 1, len(SIZES[name])) * SIZES[name]
        loops = [0.0] * (model.size - 12 - len(act))
        rates = model.rates([*eta, *nu, *act, *loops], act.tolist(), NO_INPUT, AS_PUBLISHED, FLOATS)
        wanted = REFERENCE[name](eta, nu, act)
        np.testing.assert_allclose(rates[6:12], wanted, rtol=1e-5, atol=1e-5 * np.abs(wanted).max())
        np.testing.assert_allclose(rates[12 : 12 + len(act)], 0, atol=1e-12)


def test_place_rates_turn_as_rotations_do():
    rng = np.random.default_rng(1)
    state = SpatialMotion(*rng.normal(size=12) * 0.5)
    turn = Rotation.from_euler("ZYX", [state.psi, state.theta, state.phi])
    rates = place_rates(state, (0.3, -0.1, 0.2), FLOATS)
    np.testing.assert_allclose(rates[:3], turn.apply(state[6:9]) + np.array([0.3, -0.1, 0.2]))
    h = 1e-6
    later = Rotation.from_euler("ZYX", [s + h * r for s, r in zip(state[5:2:-1], rates[5:2:-1], strict=True)])
    np.testing.assert_allclose((turn.inv() * later).as_rotvec() / h, state[9:], rtol=1e-4)


def test_coriolis_forces_do_no_work():
    rng = np.random.default_rng(2)
    nu, A = rng.normal(size=6), rng.normal(size=(6, 6))
    assert abs(nu @ np.array(coriolis((A @ A.T) @ nu, nu))) < 1e-12


def test_the_planar_masses_of_a_drawn_vehicle_are_those_in_six_degrees_of_freedom():
    """In level motion the forces v r, u r and u v of the masses are those of Kirchhoff's equations."""
    known, u, v, r = as_scenario("cruise-calm@remus100").vehicle, 1.1, -0.2, 0.15
    true = RandomMismatch(mass=1.2, m33=0.9).draw(lambda: 0.0, known)
    turning = remus100.REMUS100.coriolis([u, v, 0, 0, 0, r], deviation(true.coefficients, known.coefficients), FLOATS)
    plane = (true.m22 - true.X_vr) * v * r, -(true.m11 - true.Y_ur) * u * r
    np.testing.assert_allclose([-turning[0], -turning[1]], plane, rtol=2e-3)
    assert turning[5] == pytest.approx(0, abs=1e-12)
    assert true.m22 - true.m11 == pytest.approx(true.N_uv)


def test_strips_approximate_the_integral():
    x = np.linspace(-0.8, 0.8, 20001)
    flow = 0.1 + 0.3 * x
    per_metre = -0.5 * 1026 * 0.19 * 1.19772 * np.abs(flow) * flow
    Y, N = cross_flow(0.1, 0.3, 1.6, 0.19, 0.19, 1026.0)
    assert Y == pytest.approx(np.trapezoid(per_metre, x), rel=0.15)  # 21 strips of a twentieth of the length
    assert N == pytest.approx(np.trapezoid(x * per_metre, x), rel=0.2)


def test_inner_loops_give_the_commanded_force():
    F, speed = np.linspace(-20, 40, 61), 0.8
    n = remus100.revolutions(F, remus100.WAKE * speed, ARRAYS) / 60
    T = 0.9 * 1026 * 0.14**4 * remus100.propeller(n, remus100.WAKE * speed, remus100.KT_0, remus100.KT_J, ARRAYS)
    np.testing.assert_allclose(T, F, atol=1e-9)
    angle = remus100.fin_angle(np.array([-0.3, 0.3, 9.0]), remus100.RUDDER_LIFT, 1.0, ARRAYS)
    np.testing.assert_allclose(0.8 * 0.5 * 1026 * 0.0133 * 0.5 * angle[:2], [-0.3, 0.3], rtol=1e-5)
    assert angle[2] == pytest.approx(math.radians(15))
    for F_u, F_r in ((100.0, 20.0), (-60.0, -10.0), (239.0, 60.0), (0.0, 100.0)):
        port, starboard = (
            otter.propeller_thrust(otter.propeller_speed(T, FLOATS), FLOATS) for T in otter.shares(F_u, F_r, FLOATS)
        )
        assert -133.5 / 2 <= min(port, starboard) + 1e-9
        assert max(port, starboard) <= 239.4 / 2
        assert 0.395 * (port - starboard) == pytest.approx(min(F_r, 73.63), abs=0.01)
        if abs(F_u) + abs(F_r) / 0.395 < 133:
            assert port + starboard == pytest.approx(F_u)


class KnownSimulator:
    """A simulator with the known equations of motion, for which the adapter must not change the results."""

    def __init__(self, known, scenario):
        self.acting, self.substeps, self.model = known.acting, scenario.substeps, scenario.parts.model

    def place(self, indices, states, true):
        self.states = states.copy()

    def advance(self, inputs, dt):
        own, model = dict(zip(input_names(self.model), inputs, strict=True)), self.model
        forces, current = [own[f"F_{c}"] for c in model.channels], [own[name] for name in model.current]
        load = list(model.from_outside([own[name] for name in model.load], self.acting))
        for name, force in zip(model.driven, forces, strict=True):
            load[model.load.index(name)] += force
        for _ in range(self.substeps):
            self.states = model.advance(self.states, tuple(load), self.acting, dt / self.substeps, current, ARRAYS)
        return np.array(self.states), np.array(forces)


@pytest.mark.parametrize("speed_range", ["cruise", "space"])
def test_with_the_known_equations_the_adapter_changes_nothing(speed_range):
    waves, current = (as_scenario(f"{speed_range}-{case}@remus100") for case in ("waves", "current"))
    scenario = replace(waves, current=current.current, vertical=current.vertical, steps=90)
    known = scenario.known if scenario.vertical else scenario.vehicle
    cell, policy = drawn(scenario, 2, 3), make_policy("los-pid", known)
    plain = rollout(policy, scenario, cell.episodes)
    made = moved_by(lambda _: KnownSimulator(known, scenario))
    other = rollout(policy, scenario, cell.episodes, simulator=made)
    np.testing.assert_allclose(other.errors, plain.errors, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(other.tracks[0].position, plain.tracks[0].position, rtol=1e-6)


@pytest.mark.parametrize("outside", [True, False])
def test_a_yaw_moment_moves_the_tracked_point_as_in_the_plane(outside):
    """The rudder's own torque alone has a side force, with which the point keeps its sway velocity at first."""
    known, t, N = as_scenario("cruise-calm@remus100").vehicle, 0.05, 0.2
    start = np.array([[0, 0, 0, 1.0, 0, 0]]).T
    after = []
    for moment in (N, 0.0):
        space, inputs = SixDofSimulator("remus100", 1), NO_INPUT._replace(**{"N" if outside else "F_r": moment})
        space.place([0], start)
        space.rows[12] = remus100.fin_angle(inputs.F_r, remus100.RUDDER_LIFT, 1.0, FLOATS)  # the angle has no lag
        load = from_outside((0.0, 0.0, moment), known.acting) if outside else (0.0, 0.0, moment)
        plane = rk4_step(tuple(start[:, 0].tolist()), load, known.acting, t)
        after.append((space.advance(np.array(inputs[:7])[:, None], t)[0][4:, 0], plane[4:]))
    space, (v, r) = np.subtract(*after)
    np.testing.assert_allclose(space, (v, r), rtol=0.04, atol=0.04 * known.eps * r)
    assert v / (known.eps * r) == pytest.approx(1.0 if outside else 0.0, abs=0.12)


def test_deviations_scale_masses_and_drag():
    """Twice the masses, drag and force give the same motion; the factors are those of a drawn vehicle."""
    plain, heavy = SixDofSimulator("otter", 1), SixDofSimulator("otter", 1)
    start = np.array([[0, 0, 0, 0.5, 0, 0]]).T
    plain.place([0], start)
    level = plain.rows[2:5].copy()
    plain.rows[2:5] = 0
    known = as_scenario("cruise-mismatch@otter").vehicle.coefficients
    heavy.place([0], start, Coefficients(*(2 * x for x in known)))
    heavy.rows[2:5] = level * 0
    push = np.array(NO_INPUT._replace(X=30.0, N=4.0)[:7])[:, None]
    np.testing.assert_allclose(heavy.advance(2 * push, 0.02)[0][3::2], plain.advance(push, 0.02)[0][3::2], rtol=2e-3)
    true = Coefficients(*known)._replace(m11=known.m11 * 1.2, d22=known.d22 * 0.8, Y_vv=known.Y_vv * 0.8 + 7)
    wanted = AS_PUBLISHED._replace(m_u=1.2, d_v=0.8, Y_vv=7.0)
    np.testing.assert_allclose(deviation(true, known), wanted, atol=1e-9)


def test_ranks_and_means_agree_with_scipy():
    rng = np.random.default_rng(4)
    a, b = rng.normal(size=(2, 9))
    assert concordance(a, b) == pytest.approx(stats.kendalltau(a, b).statistic)
    steady_rmses = [np.abs(rng.normal(size=(3, 5))) for _ in range(2)]
    means = pooled(steady_rmses)
    np.testing.assert_allclose(means[0], np.concatenate(steady_rmses, axis=1).mean(axis=1))
    assert means.shape[1] == 3


@pytest.mark.parametrize("name", REFERENCE)
def test_the_log_of_a_trial(name, tmp_path):
    trials.log(name).save(tmp_path / "log.csv")
    kept = Log.load(tmp_path / "log.csv")
    if name == "otter":  # the log of the tutorial
        np.testing.assert_allclose(Log.load(ROOT / "docs/tutorials/otter.csv").measured, kept.measured, atol=1e-6)
    assert np.ptp(kept.measured[:, 2]) > 1.0
    assert np.hypot(*kept.measured[:, 3:5].T).max() < 3.5


def test_rows_are_summarised():
    results = {policy: comparison._measure("otter", policy, quick=True) for policy in ("los-pid", "ilos")}
    record = comparison.summary(results)
    assert len(record["tau_by_case"]) == len(record["cases"])
    for policy, row in record["policies"].items():
        for place in ("plane", "space"):
            errors = [case[place]["steady_rmse"] for case in results[policy].values()]
            assert row["error_m"][place] == pytest.approx(np.mean(errors))
        assert row["growth"] == pytest.approx(row["error_m"]["space"] / row["error_m"]["plane"])
        assert row["failed"]["space"] == 0


def test_the_sentences_of_the_page_are_true():
    values = comparison.STUDY.values()
    remus, boat = (
        comparison.summary({policy: values[vehicle, policy] for policy in comparison._PARTS["cruise"].policies})
        for vehicle in ("remus100", "otter")
    )
    for vehicle, record in zip(comparison.context()["vehicles"], (remus, boat), strict=True):
        for name, plane, *_ in vehicle["policies"]:
            assert float(plane) == pytest.approx(record["policies"][name.strip("`")]["error_m"]["plane"], rel=5e-3)
    assert remus["tau_ci95"][0] < comparison.TAU < remus["tau"]
    assert boat["tau_ci95"][0] < comparison.TAU < boat["tau"]
    best = sorted(boat["policies"], key=lambda name: boat["policies"][name]["error_m"]["plane"])[:4]
    assert all(boat["policies"][name]["growth"] > 1.3 for name in best)
    for turn in values["remus100", "trials"]["turns"]:
        assert turn["space"] / turn["plane"] == pytest.approx(1.0, abs=0.05)
    growth = [row["growth"] for row in remus["policies"].values()]
    assert 1.0 < np.median(growth) < 1.1
    assert max(growth) < comparison.GROWTH
    assert {name for name, row in boat["policies"].items() if row["growth"] > 2} == {"helm-any", "ilos", "nmpc"}
    pitch = otter.OTTER.placed(np.zeros((6, 1)))[4, 0]
    assert math.degrees(pitch) == pytest.approx(-1.5, abs=0.05)
