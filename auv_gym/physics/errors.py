"""Tracking errors, and the rotation between world and body frame."""

from __future__ import annotations

from auv_gym.physics.dynamics import State
from auv_gym.physics.namespaces import FLOATS, Namespace, Number, wrap_angle


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
