"""evaluate.py --stability: the known figures of the paper's law, and policies that are no formula."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

import evaluate
from auv_gym.installation import install
from auv_gym.physics.dynamics import rates
from auv_gym.physics.namespaces import ARRAYS
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.planning.paths import Circle, Line
from auv_gym.planning.planner import plan
from baselines import make_policy
from baselines.control.backstepping import Backstepping, tracking_forces
from baselines.control.linearisation import error_dynamics, linearise
from baselines.control.lqi import gain_schedule
from baselines.evaluation.stability import report as stability_report
from baselines.evaluation.stability.analysis import linearise_policy
from baselines.evaluation.stability.report import EXAMINED_LIMITS, success
from baselines.evaluation.stability.sampled_loop import steady_motion
from baselines.evaluation.stability.tables import Stability
from baselines.evaluation.stability.verdicts import verdicts

DT = 0.1
HELD = {"slow": (0.2, 100.0, 50.0), "cruise": (0.1, 400.0, 200.0)}  # control period and limits of the presets
MAP = {0.1: (-0.213, -0.168, -0.098, -0.051), 0.5: (0.002, -0.010, -0.047, -0.096), 2.0: (0.422, 0.414, 0.392, 0.362)}
"""Largest real part for the paper's gains by speed, at turn rates 0 ... 0.3 rad/s."""


class Plain:
    """A law behind `predict` alone."""

    def __init__(self, law):
        self.predict = law.predict


def test_error_dynamics_with_quadratic_drag_and_lift():
    """Against differences of (2) and of the errors' kinematics in the body frame, about any motion."""
    hull = Vehicle(m11=215.0, m22=265.0, m33=80.0, d11=70.0, d22=100.0, d33=50.0, X_uu=30.0, Y_vv=80.0, N_rr=20.0)
    hull = replace(hull, Y_uv=60.0, Y_ur=40.0, N_uv=25.0, N_ur=30.0)
    u_R, v_R, r_R = 0.8, -0.3, 0.2

    def error_rates(e, force=(0.0, 0.0)):
        e_x, e_y, psi_e, u_e, v_e, r_e = e
        u, v, r = u_R + u_e, v_R + v_e, r_R + r_e
        c, s = np.cos(psi_e), np.sin(psi_e)
        _, _, *accelerations = rates(0.0, u, v, r, (force[0], 0.0, force[1]), hull.coefficients)
        return np.array((u - c * u_R - s * v_R + r * e_y, v - c * v_R + s * u_R - r * e_x, r_e, *accelerations))

    A, B = error_dynamics(hull, u_R, v_R, r_R)
    h, still = 1e-6, np.zeros(6)
    slopes = [(error_rates(h * d) - error_rates(-h * d)) / (2 * h) for d in np.eye(6)]
    np.testing.assert_allclose(A, np.array(slopes).T, atol=1e-8)
    np.testing.assert_allclose(
        B, np.array([error_rates(still, d) - error_rates(still) for d in np.eye(2)]).T, atol=1e-12
    )


@pytest.mark.parametrize("speed", MAP)
def test_the_papers_law(speed):
    law = make_policy("backstepping-paper")
    loops = [linearise_policy(PAPER_VEHICLE, law, speed, om, DT) for om in stability_report.TURN_RATES]
    np.testing.assert_allclose([loop.eigenvalues[0].real for loop in loops], MAP[speed], atol=6e-4)


@pytest.mark.parametrize(
    ("gains", "speed", "period"), [("paper", 0.1, 0.83), ("paper", 0.3, 0.83), ("robust", 2.0, 0.91)]
)
def test_largest_control_period(gains, speed, period):
    loop = linearise_policy(PAPER_VEHICLE, Backstepping(gains), speed, 0.0, DT)
    assert loop.largest_period() == pytest.approx(period, abs=0.01)
    growth = [np.abs(np.linalg.eigvals(loop.held(T))).max() for T in (0.98 * period, 1.02 * period)]
    assert growth[0] < 1 < growth[1]
    fast = np.log(np.linalg.eigvals(loop.held(1e-4))) / 1e-4
    assert fast.real.max() == pytest.approx(loop.eigenvalues[0].real, abs=1e-3)


def test_a_policy_that_is_no_formula():
    law = Backstepping("robust")
    exact, found = (linearise_policy(PAPER_VEHICLE, policy, 1.0, 0.1, DT) for policy in (law, Plain(law)))
    np.testing.assert_allclose(found.eigenvalues, exact.eigenvalues, atol=2e-3)
    assert linearise_policy(PAPER_VEHICLE, make_policy("open-loop"), 1.0, 0.0, DT).largest_period() == 0


def test_sampled_success():
    """Without limits the law spins the vehicle up from half of the starts; limits prevent it."""
    law = Backstepping("paper")
    free, limited = (success(law, limits, 60) for limits in EXAMINED_LIMITS.values())
    assert 0.4 < free < 0.65
    assert limited == 1


def test_report(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(stability_report, "STARTS", 4)
    monkeypatch.setattr(stability_report, "SPEEDS", (0.1, 1.0))
    arguments = ["--stability", "--policy", "backstepping-paper", "open-loop", "oracle", "--out", str(tmp_path / "out")]
    assert evaluate.main(arguments) == 1
    out, err = capsys.readouterr()
    assert "+0.230" in out
    assert "0.1459" in out
    assert "oracle: " in err
    paper, loop = json.loads((tmp_path / "out" / "stability.json").read_text())
    assert (paper["policy"], loop["policy"]) == ("backstepping-paper", "open-loop")
    rates = {(c["speed"], *c["box"].values()): c["rate"] for c in paper["certificates"]}
    assert rates[0.1, 0.1, 0.22, 0.0] == pytest.approx(0.1459, abs=1e-4)
    assert rates[1.0, 0.1, 0.22, 0.0] is None
    assert (tmp_path / "out" / "stability.png").stat().st_size > 1000
    page = (tmp_path / "out" / "stability.html").read_text(encoding="utf-8")
    assert "0.1459" in page
    assert "Straight lines are stable below 0.497 m/s and unstable above" in page
    assert "Straight lines are stable below 0.497 m/s and unstable above" in out


def test_report_without_the_solver(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "cvxpy", None)
    monkeypatch.setattr(stability_report, "STARTS", 2)
    monkeypatch.setattr(stability_report, "SPEEDS", (0.1,))
    assert evaluate.main(["--stability", "--policy", "open-loop", "--out", str(tmp_path)]) == 0
    out, err = capsys.readouterr()
    assert err == f"note: the certificate needs a semidefinite solver: {install('certificate')}\n"
    assert "Certified" not in out
    assert json.loads((tmp_path / "stability.json").read_text())[0]["certificates"] is None
    assert "[certificate]" in (tmp_path / "stability.html").read_text(encoding="utf-8")


def in_next_frame(r_R, dt):
    """R(r_R dt)^T, which turns a vector's components into those of the next control instant's frame."""
    c, s = np.cos(r_R * dt), np.sin(r_R * dt)
    return np.array([[c, s], [-s, c]])


def held_motion(speed, turn_rate, dt):
    """Phi (6, 6), Gamma (6, 2) of the errors over a control period, and the reference's velocities."""
    path = Circle(speed, turn_rate) if turn_rate else Line(speed)
    velocities = plan(path, PAPER_VEHICLE, np.array([0.0, 1.0])).table[0, 3:6]
    A, B = error_dynamics(PAPER_VEHICLE, *velocities)
    step = expm(dt * np.block([[A, B], [np.zeros((2, 8))]]))
    return step[:6, :6], step[:6, 6:], velocities


def integral_loop(law, speed, turn_rate, dt):
    """The law with integral action: xi grows by rate dt e, then eta = diag(surge, 1) xi is added to the error."""
    Phi, Gamma, _ = held_motion(speed, turn_rate, dt)
    K = linearise(PAPER_VEHICLE, lambda o: tracking_forces(o, PAPER_VEHICLE, law.gains, ARRAYS), speed, turn_rate).K
    xi = np.eye(2, 8, 6) + law.rate * dt * np.eye(2, 8)
    force = K @ np.eye(6, 8) + K[:, :2] @ np.diag((law.surge, 1.0)) @ xi
    return np.vstack((Phi @ np.eye(6, 8) + Gamma @ force, in_next_frame(turn_rate, dt) @ xi))


def lqi_loop(law, speed, turn_rate, dt, limits):
    """States: errors, xi, the modelled forces and the last ones, all as deviations."""
    Phi, Gamma, (u_R, _, r_R) = held_motion(speed, turn_rate, dt)
    K, every = gain_schedule(PAPER_VEHICLE, law.weights, dt, limits)(np.array([[u_R, r_R]]))[0], np.eye(12)
    xi = every[6:8] + law.weights.rate * dt * every[:2]
    lagged = every[8:10] - np.expm1(-dt / law.weights.lag) * (every[10:] - every[8:10])
    force = -K @ np.vstack((every[:6], xi, lagged, every[10:]))
    return np.vstack((Phi @ every[:6] + Gamma @ force, in_next_frame(r_R, dt) @ xi, lagged, force))


def rate_of(matrix, dt):
    return np.log(np.abs(np.linalg.eigvals(matrix)).max()) / dt


@pytest.mark.parametrize(("speed", "turn_rate"), [(0.1, 0.0), (0.3, 0.1), (1.0, 0.0), (1.0, 0.1)])
def test_a_policy_with_memory_as_computed_by_hand(speed, turn_rate):
    regime = "slow" if speed < 0.4 else "cruise"
    dt, *limits = HELD[regime]
    for name, loop in (("integral", integral_loop), ("lqi", lqi_loop)):
        policy = make_policy(name)
        law = getattr(policy.controller, regime)
        expected = rate_of(loop(law, speed, turn_rate, dt, *([tuple(limits)] if name == "lqi" else [])), dt)
        found = steady_motion(PAPER_VEHICLE, policy, speed, turn_rate)
        assert found.rate == pytest.approx(expected, abs=1e-4)
        assert (found.offset, found.swing, found.held) == (0.0, 0.0, True)


@pytest.mark.filterwarnings("ignore::baselines.control.backstepping.StabilityWarning")
@pytest.mark.parametrize(("speed", "turn_rate"), [(0.2, 0.0), (0.6, 0.0), (0.6, 0.2)])
def test_a_law_without_memory_as_the_held_loop(speed, turn_rate):
    """Stable or not."""
    dt = HELD["slow" if speed < 0.4 else "cruise"][0]
    law = make_policy("backstepping-paper")
    expected = rate_of(linearise_policy(PAPER_VEHICLE, law, speed, turn_rate, dt).held(dt), dt)
    assert steady_motion(PAPER_VEHICLE, law, speed, turn_rate).rate == pytest.approx(expected, abs=1e-4)


class Pulling:
    """Remembers how often it was asked, and pulls to one side ever harder."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        count = np.zeros(len(observation)) if state is None else state[0]
        return np.stack((0 * count, np.minimum(count, 500.0) / 500), axis=1).astype(np.float32), (count + 1,)


def test_a_policy_that_leaves_and_one_that_has_not_the_force():
    assert steady_motion(PAPER_VEHICLE, Pulling(), 0.2, 0.0).rate == np.inf
    assert np.isnan(steady_motion(PAPER_VEHICLE, make_policy("integral"), 6.0, 0.0).rate)
    with pytest.raises(ValueError, match="behind the observation"):
        steady_motion(PAPER_VEHICLE, make_policy("oracle"), 0.2, 0.0)


def known(**changes):
    """What is known of a policy at two speeds."""
    record = {
        "policy": "mine", "speeds": (0.1, 1.0), "turn_rates": (0.0, 0.1), "abscissa": [[-0.2, -0.1], [-0.1, -0.1]],
        "swing": [[0.0, 0.0], [0.0, 0.0]], "largest_period": None, "limiting_speeds": [], "starts": 10,
        "success": {"without limits": 1.0}, "certificates": None,
    }  # fmt: skip
    return Stability(**record | changes)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({}, "Straight lines are stable at every speed looked at, from 0.1 to 1 m/s."),
        ({}, "Turns of 0.1 to 0.1 rad/s are stable at every speed looked at."),
        ({}, "On a straight line a small error halves in 6.9 s at 1 m/s, the slowest, and in 3.5 s at 0.1 m/s."),
        ({}, "Of 10 random starts up to 5 m off, with any heading, all without limits reach the paper's circle."),
        (
            {"abscissa": [[0.1, 0.1], [-0.1, 0.2]], "limiting_speeds": [0.5]},
            "Straight lines are unstable below 0.5 m/s and stable above; looked at from 0.1 to 1 m/s.",
        ),
        ({"abscissa": [[0.1, 0.1], [0.1, -0.2]]}, "Straight lines are stable at no speed looked at"),
        ({"abscissa": [[-0.1, 0.1], [-0.1, -0.2]]}, "stable in 1 of 2 motions looked at, none faster than 1 m/s."),
        (
            {"abscissa": [[np.nan, -0.1], [-0.1, np.inf]], "swing": [[1e-3, 0.0], [0.0, 0.0]]},
            "In 1 of 4 motions it stays near but comes to no rest: it swings by 1 to 1 mm.",
        ),
        ({"abscissa": [[-0.1, -0.1], [-0.1, np.inf]]}, "In 1 motions it leaves the reference."),
        ({"largest_period": [[0.8, 0.5], [0.0, np.inf]]}, "held for up to 0.50 s, at 0.1 m/s in a turn of 0.1 rad/s."),
    ],
)
def test_verdicts(changes, says):
    assert any(says in sentence for sentence in verdicts(known(**changes))), verdicts(known(**changes))
