"""The tracking law against an independent form of the paper's equations, and properties of its closed loop."""

import math
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st

import baselines
from auv_gym import decode_observation
from auv_gym.physics.dynamics import rates
from auv_gym.physics.namespaces import FLOATS
from auv_gym.physics.vehicle import PAPER_VEHICLE as V
from auv_gym.task.observation import SIZE, Observation, action_of, encode_observation
from baselines.control.backstepping import GAINS, Backstepping, StabilityWarning, lyapunov_terms, tracking_forces

small = st.floats(-2, 2)
PAPER = GAINS["paper"]


def observation(e_x=0.0, e_y=0.0, psi_e=0.0, u_e=0.0, v_e=0.0, r_e=0.0, speed=0.1, r_R=-0.01):
    """Return an observation on a steady turn."""
    tan = -V.m11 * r_R / V.d22
    u_R, v_R = speed / math.hypot(1, tan), speed * tan / math.hypot(1, tan)
    F_uR, F_rR = V.d11 * u_R - V.m22 * v_R * r_R, (V.m22 - V.m11) * u_R * v_R + V.d33 * r_R
    known = e_x, e_y, psi_e, u_e, v_e, r_e, u_R, v_R, r_R, F_uR, F_rR, 1.0, 0.0, 400.0, 200.0, 0.0, 0.0, 0.1
    return Observation(*known, *[0.0] * (SIZE - len(known)))


def test_law_is_the_papers():
    """(21), (22), (26), (34), (40), (47) in world-frame errors as printed, in SymPy."""
    x_e, y_e, psi, psi_e, u_e, v_e, r_e, u_R, v_R, r_R, F_uR, F_rR = sp.symbols(
        "x_e y_e psi psi_e u_e v_e r_e u_R v_R r_R F_uR F_rR"
    )
    k, k1, cu, ku, c, kc, cr = (sp.Float(getattr(PAPER, n)) for n in ("k", "k1", "cu", "ku", "c", "kc", "cr"))
    R = sp.Matrix([[sp.cos(psi), -sp.sin(psi)], [sp.sin(psi), sp.cos(psi)]])
    alpha = -R.T * (k + k1) * sp.Matrix([x_e, y_e])
    z_u, z_v = u_e - alpha[0], v_e - alpha[1]
    tau_u = -(k + k1) * u_e - cu * z_u - ku * z_u * (k + k1) ** 2
    u = u_R + u_e
    alpha_r = -cr * (-V.m11 / V.m22 * u * z_v + psi_e)
    z_r = r_e - alpha_r
    tau_r = -z_v - psi_e - cr * ((V.m11 * u / V.m22) ** 2 + 1) * r_e - (c + kc * (cr * V.m11 * u / V.m22) ** 2) * z_r
    F_u = F_uR + V.d11 * u_e - V.m22 * (v_e * r_e + v_e * r_R + v_R * r_e) + V.m11 * tau_u
    F_r = F_rR + V.d33 * r_e + (V.m22 - V.m11) * (u_e * v_e + u_e * v_R + u_R * v_e) + V.m33 * tau_r
    e_x, e_y = R.T * sp.Matrix([x_e, y_e])
    ours = tracking_forces((e_x, e_y, psi_e, u_e, v_e, r_e, u_R, v_R, r_R, F_uR, F_rR), V, PAPER)
    values = dict(
        zip((x_e, y_e, psi, psi_e, u_e, v_e, r_e, u_R, v_R, r_R, F_uR, F_rR), np.linspace(-1.3, 2.1, 12), strict=True)
    )
    for mine, printed in zip(ours, (F_u, F_r), strict=True):
        assert sp.expand(mine - printed).subs(values) == pytest.approx(0, abs=1e-9)


@given(small, small, small, small, small, small)
def test_partial_linearisation(e_x, e_y, psi_e, u_e, v_e, r_e):
    """(23), (24): in the closed loop u_e' and r_e' are functions of the errors through tau alone."""
    o = observation(e_x, e_y, psi_e, u_e, v_e, r_e)
    F_u, F_r = tracking_forces(o, V, PAPER)
    _, _, u_dot, _, r_dot = rates(0.0, o.u_R + u_e, o.v_R + v_e, o.r_R + r_e, (F_u, 0.0, F_r), V.coefficients)
    kap = PAPER.k + PAPER.k1
    z_u = u_e + kap * e_x
    assert u_dot == pytest.approx(-kap * u_e - (PAPER.cu + PAPER.ku * kap**2) * z_u, abs=1e-9)
    assert math.isfinite(r_dot)


def test_on_the_reference_the_law_is_the_plan():
    o = observation()
    for gains in GAINS.values():
        assert tracking_forces(o, V, gains) == pytest.approx((o.F_uR, o.F_rR), abs=1e-12)


@given(small, small, small, st.floats(0.3, 2))
def test_normalised_form_scales_with_the_speed(e_x, e_y, psi_e, speed):
    """The acceleration in surge is proportional to the speed, that in yaw is constant; at 0.1 m/s it is the law."""
    gains = GAINS["normalised-paper"]
    ratio = speed / 0.1

    def tau(o):
        F_u, F_r = tracking_forces(o, V, gains)
        _, _, u_dot, _, r_dot = rates(0.0, o.u_R + o.u_e, o.v_R + o.v_e, o.r_R + o.r_e, (F_u, 0.0, F_r), V.coefficients)
        return u_dot, r_dot

    slow = observation(e_x, e_y, psi_e, 0.01, -0.02, 0.03)
    fast = observation(ratio * e_x, ratio * e_y, psi_e, ratio * 0.01, ratio * -0.02, 0.03, speed)
    assert tracking_forces(slow, V, gains) == pytest.approx(tracking_forces(slow, V, PAPER))
    assert tau(fast) == pytest.approx((ratio * tau(slow)[0], tau(slow)[1]), rel=1e-9, abs=1e-9)


def test_auto_chooses_the_gains_by_speed():
    auto = Backstepping()
    for speed, name in ((0.39, "paper"), (0.41, "cruise")):
        o = observation(0.1, 0.2, 0.1, speed=speed)
        assert auto.forces(o) == tracking_forces(o, V, GAINS[name])


def test_action_is_the_share_of_the_limits():
    o = observation()._replace(F_u_max=250.0, F_r_max=80.0)
    assert action_of((50.0, -20.0), o, FLOATS) == (0.2, -0.25)
    assert action_of((-400.0, 81.0), list(o), FLOATS) == (-1.0, 1.0)


def test_too_fast_a_reference_warns_once():
    policy = Backstepping("paper")
    slow, fast = (encode_observation(observation(speed=s)) for s in (0.3, 1.0))
    policy.predict(slow)
    with pytest.warns(
        StabilityWarning, match=r"stable up to 0.49 m/s, but the reference speed is .* gains 'cruise', 'robust'"
    ):
        policy.predict(fast)
    policy.predict(np.stack([fast, fast]))
    Backstepping("normalised").predict(fast)


def test_lyapunov_terms_by_hand():
    o = observation(e_x=3.0, e_y=4.0)._replace(psi_e=0.2, u_e=0.1, v_e=-0.1, r_e=0.05)
    z_u, z_v = 0.1 + 1.2 * 3, -0.1 + 1.2 * 4
    z_r = 0.05 + 0.1 * (0.2 - 215 / 265 * (o.u_R + 0.1) * z_v)
    V1, V2, V3, V4 = lyapunov_terms(o, V, PAPER)
    assert V1 == pytest.approx(12.5)
    assert V2 - V1 == pytest.approx(z_u**2 / 2)
    assert V3 - V2 == pytest.approx((z_v**2 + 0.2**2) / 2)
    assert V4 - V3 == pytest.approx(z_r**2 / 2)


@given(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_bounded_error_bounds_the_force(e_x, e_y):
    bound = 10.0 * 0.1  # distance that a vehicle at 0.1 m/s travels in 10 s
    free = Backstepping("paper", horizon=10.0).forces(observation(e_x, e_y))
    kap = PAPER.k + PAPER.k1
    largest = V.m11 * (PAPER.cu + PAPER.ku * kap**2) * kap * bound + 8.0
    assert abs(free[0]) <= largest


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gains": "soft"}, "unknown gains 'soft'; allowed are a Gains, auto, paper"),
        ({"horizon": 0.0}, "horizon is 0.0"),
        ({"colour": 1}, "does not take these options"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        baselines.make_policy("backstepping", **options)
    with pytest.raises(ValueError, match="gain cr is nan"):
        replace(PAPER, cr=math.nan)


def test_open_loop_is_the_plan():
    o = encode_observation(observation())
    action = baselines.make_policy("open-loop").predict(o)[0]
    decoded = decode_observation(o)
    assert action == pytest.approx((decoded.F_uR / 400, decoded.F_rR / 200), rel=1e-6)
