"""Tracking errors and their dynamics, (17)-(20), and the rotation between world and body frame."""

from __future__ import annotations

import math
from typing import Any

from auv_gym.physics.dynamics import Force, State
from auv_gym.physics.namespaces import FLOATS, Namespace, Number, wrap_angle
from auv_gym.physics.vehicle import Coefficients


def to_body(x: Number, y: Number, c: Number, s: Number) -> tuple[Number, Number]:
    """Rotate a world vector into the body frame: R(psi)^T (x, y) with c = cos(psi), s = sin(psi), (19a)."""
    return c * x + s * y, c * y - s * x


def to_world(x: Number, y: Number, c: Number, s: Number) -> tuple[Number, Number]:
    """Rotate a body vector into the world frame: R(psi) (x, y) with c = cos(psi), s = sin(psi), (19a)."""
    return c * x - s * y, s * x + c * y


def tracking_errors(state: State, reference: State, ns: Namespace = FLOATS) -> State:
    """Return x_e, y_e [m] in the world, psi_e [rad] in [-pi, pi), u_e, v_e [m/s], r_e [rad/s] (section IV.A)."""
    x, y, psi, u, v, r = state
    x_R, y_R, psi_R, u_R, v_R, r_R = reference
    return x - x_R, y - y_R, wrap_angle(psi - psi_R, ns), u - u_R, v - v_R, r - r_R


def error_rates(
    errors: State,
    reference: State,
    force: Force,
    reference_force: Force,
    coefficients: Coefficients,
    ns: Any = math,
) -> State:
    """Return the time derivative of the tracking errors, (17)-(20), for linear drag and still water.

    The simulator integrates (1)-(2); this form is the paper's own and serves analysis and tests.
    """
    _, _, psi_e, u_e, v_e, r_e = errors
    _, _, psi_R, u_R, v_R, r_R = reference
    m11, m22, m33, d11, d22, d33 = coefficients[:6]
    c, s = ns.cos(psi_R + psi_e), ns.sin(psi_R + psi_e)
    c_R, s_R = ns.cos(psi_R), ns.sin(psi_R)
    F_ue, F_re = force[0] - reference_force[0], force[1] - reference_force[1]
    return (
        c * u_e - s * v_e + (c - c_R) * u_R - (s - s_R) * v_R,  # (17a)
        s * u_e + c * v_e + (s - s_R) * u_R + (c - c_R) * v_R,  # (17b)
        r_e,  # (17c)
        m22 / m11 * (v_e * r_e + v_e * r_R + v_R * r_e) - d11 / m11 * u_e + F_ue / m11,  # (20a)
        -m11 / m22 * (u_e * r_e + u_e * r_R + u_R * r_e) - d22 / m22 * v_e,  # (20b)
        (m11 - m22) / m33 * (u_e * v_e + u_e * v_R + u_R * v_e) - d33 / m33 * r_e + F_re / m33,  # (20c)
    )
