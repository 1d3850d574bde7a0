"""The certificate: the known rates, an independent optimum, and nonlinear motion that keeps what it promises."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from auv_gym.physics.dynamics import state_rates
from auv_gym.physics.errors import to_body, tracking_errors
from auv_gym.physics.namespaces import FLOATS
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.planning.paths import Sine
from auv_gym.planning.planner import plan
from baselines import make_policy
from baselines.control.backstepping import Backstepping
from baselines.evaluation.stability.certificate import BOXES, COARSE, Box, certify, decay_rate, largest_rate, loops

DT = 0.1
RATES = {
    "normalised-paper": (0.1459, 0.0650, 0.0272),
    "normalised": (0.1462, 0.0467, 0.0951),
}
"""Certified rate in each of `BOXES`, the same at every speed."""


@pytest.mark.parametrize(
    ("gains", "speed"), [("normalised-paper", 0.1), ("normalised-paper", 1.0), ("normalised", 2.0)]
)
def test_known_rates(gains, speed):
    found = [certify(PAPER_VEHICLE, Backstepping(gains), speed, box, DT) for box in BOXES]
    np.testing.assert_allclose([c.rate for c in found], RATES[gains], atol=1.5e-4)
    for c in found:  # on random references, not those of a grid
        P, rng = np.array(c.P), np.random.default_rng(0)
        assert np.linalg.eigvalsh(P)[0] > 0
        worst = min(
            decay_rate(P, loops(PAPER_VEHICLE, Backstepping(gains), speed, _part(c.box, rng), DT, 2)) for _ in range(50)
        )
        assert worst > c.rate - 1e-4


def _part(box, rng):
    return Box(*(rng.uniform(0, end) for end in (box.turn_rate, box.sideslip, box.acceleration)))


def test_one_matrix_is_certified_to_its_eigenvalue():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(6, 6)) - 4 * np.eye(6)
    abscissa = np.linalg.eigvals(A).real.max()
    assert decay_rate(largest_rate(A[None]), A[None]) == pytest.approx(-abscissa, rel=2e-3)


def test_two_stable_loops_without_a_common_function():
    """Switching between them diverges, so no function can exist: the product of two flows has an eigenvalue above 1."""
    A = np.full((2, 6, 6), -np.eye(6))
    A[0, :2, :2], A[1, :2, :2] = [[-0.1, 1.0], [-10.0, -0.1]], [[-0.1, 10.0], [-1.0, -0.1]]
    assert np.linalg.eigvals(A).real.max() < 0
    assert largest_rate(A) is None


def test_what_is_not_certified():
    paper = Backstepping("paper")
    assert certify(PAPER_VEHICLE, paper, 1.0, BOXES[0], DT).rate is None  # unstable
    assert certify(PAPER_VEHICLE, paper, 0.1, BOXES[1], DT).rate is None  # its loop depends on a speed that varies
    with pytest.raises(ValueError, match="memory"):
        certify(PAPER_VEHICLE, make_policy("integral"), 0.1, BOXES[0], DT)


def test_small_errors_fade_as_certified_along_a_varying_path():
    """The nonlinear loop on a sine, integrated with the paper's equations: V falls at least as fast as promised."""
    law, path, U = Backstepping("normalised"), Sine(speed=1.0, amplitude=4.0, frequency=0.12), 1.0
    t = np.linspace(0.0, 40.0, 4001)
    R = plan(path, PAPER_VEHICLE, t)
    assert np.abs(R.r).max() < BOXES[1].turn_rate
    assert np.abs(np.arctan2(R.v, R.u)).max() < BOXES[1].sideslip
    speed = np.hypot(R.u, R.v)
    assert np.abs(np.gradient(speed, t) / speed).max() < BOXES[1].acceleration
    c = certify(PAPER_VEHICLE, law, U, BOXES[1], DT)
    P, table = np.array(c.P), np.stack((R.x, R.y, R.psi, R.u, R.v, R.r, R.F_u, R.F_r))

    def reference(time):
        return [np.interp(time, t, row) for row in table]

    def scaled(time, state):
        r = reference(time)
        x_e, y_e, *others = tracking_errors(tuple(state), tuple(r[:6]), FLOATS)
        e = np.array((*to_body(x_e, y_e, np.cos(state[2]), np.sin(state[2])), *others))
        V = np.hypot(r[3], r[4])
        return e, e / (V, V, 1, V, V, 1), r

    def rates(time, state):
        e, _, r = scaled(time, state)
        F_u, F_r = law.forces((*e, *r[3:]))
        return state_rates(tuple(state), (F_u, 0.0, F_r), PAPER_VEHICLE.coefficients, ns=np)

    start = np.array(reference(0.0)[:6]) + 1e-3 * np.array((1.0, -2.0, 0.5, 0.3, -0.2, 0.4))
    motion = solve_ivp(rates, (0.0, 20.0), start, t_eval=np.linspace(0, 20, 21), rtol=1e-9, atol=1e-12)
    V = [e @ P @ e for e in (scaled(time, state)[1] for time, state in zip(motion.t, motion.y.T, strict=True))]
    assert (np.array(V) <= 1.02 * V[0] * np.exp(-2 * c.rate * motion.t)).all()
    assert V[-1] < 1e-2 * V[0]


def test_coarse_loops_agree_with_those_about_steady_motion():
    from baselines.control.linearisation import linearise

    law = Backstepping("paper")
    A = loops(PAPER_VEHICLE, law, 1.0, Box(0.0, 0.0), DT, 1)[0]
    steady = linearise(PAPER_VEHICLE, lambda o: law.forces(o, FLOATS), 1.0, 0.0)
    np.testing.assert_allclose(A, steady.A + steady.B @ steady.K, atol=1e-6)
    assert len(loops(PAPER_VEHICLE, law, 1.0, BOXES[1], DT, COARSE)) == 2 * COARSE**2
