"""evaluate.py --stability: the known figures of the paper's law, and policies that are no formula."""

import json
import sys

import numpy as np
import pytest

import evaluate
from auv_gym.dynamics import rates
from auv_gym.installation import install
from auv_gym.vehicle import PAPER_VEHICLE, Vehicle
from baselines import make_policy
from baselines.control.backstepping import Backstepping
from baselines.control.linearisation import error_dynamics
from baselines.evaluation.stability import report as stability_report
from baselines.evaluation.stability.analysis import linearise_policy
from baselines.evaluation.stability.report import LIMITS, success

DT = 0.1
MAP = {0.1: (-0.213, -0.168, -0.098, -0.051), 0.5: (0.002, -0.010, -0.047, -0.096), 2.0: (0.422, 0.414, 0.392, 0.362)}
"""Largest real part for the paper's gains by speed, at turn rates 0 ... 0.3 rad/s."""


class Plain:
    """A law behind `predict` alone."""

    def __init__(self, law):
        self.predict = law.predict


def test_error_dynamics_with_quadratic_drag():
    """Against differences of (2) and of the errors' kinematics in the body frame, about any motion."""
    hull = Vehicle(m11=215.0, m22=265.0, m33=80.0, d11=70.0, d22=100.0, d33=50.0, X_uu=30.0, Y_vv=80.0, N_rr=20.0)
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
    free, limited = (success(law, limits, 60) for limits in LIMITS.values())
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
    assert "data:image/png;base64," in page


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
