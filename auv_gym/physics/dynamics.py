"""The equations of motion (1)-(2), with ocean current, drag, lift, cross-flow and external forces: their only copy.

Written on components, so that they run on floats, NumPy arrays, torch tensors and symbols alike.

A current that is irrotational and constant in the world enters the hydrodynamics only through the water-relative
velocity (T. I. Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed., 2021, section 10.3): (2)
then holds for `u, v` relative to the water, and (1) gains the current. Currents that vary in time or, by a shear, in
space are treated as if they were: what their change along the way would add to the inertia forces is left out. For a
shear that is m (V . grad) V for the vehicle's velocity V over ground, up to 15 N at cruise in `ood-v1`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeAlias

from auv_gym.physics.namespaces import Number

State: TypeAlias = tuple[Number, Number, Number, Number, Number, Number]
"""x, y [m], psi [rad] in the world; u, v [m/s] relative to the water in the body frame; r [rad/s]."""
Force: TypeAlias = tuple[Number, Number]
"""F_u [N], F_r [N m]."""
Load: TypeAlias = tuple[Number, Number, Number]
"""Total force on the vehicle in the body frame: surge [N], sway [N], yaw [N m]; its actuators give (F_u, 0, F_r), where
the rudder's side force does not count, and a force from outside gives `from_outside`."""
CurrentVelocity: TypeAlias = tuple[Number, Number]
"""V_x, V_y [m/s] of the water in the world."""

STILL_WATER: CurrentVelocity = (0.0, 0.0)  # [m/s]
_WITH_EPS = 22  # number of coefficients behind m11, m22, m33 if eps is the last one


def rates(
    psi: Number, u: Number, v: Number, r: Number, load: Load, coefficients: Sequence[Number], ns: Any = math
) -> tuple[Number, Number, Number, Number, Number]:
    """Return x_dot, y_dot [m/s] in still water, u_dot, v_dot [m/s^2] and r_dot [rad/s^2]; psi_dot is r, (1c).

    The coefficients are `Vehicle.acting`: a vehicle's `Coefficients` and its `CrossTerms`, with d23, d32 and eps or
    without; or the coefficients alone, or those `without_lift`. A foil damps astern as it does ahead, so lift goes with
    |u|; the sources, which look ahead alone, write u. Signs of the cross terms, and the tracked point, which v and the
    yaw moment refer to: see `auv_gym.physics.vehicle.Vehicle`.
    """
    m11, m22, m33, d11, d22, d33, X_uu, Y_vv, N_rr, *more = coefficients
    X, Y, N = load
    v_P, torque, cross, eps = v, N, [], 0.0
    sway, munk = m11 * u, (m11 - m22) * u
    if more:
        Y_uv, Y_ur, N_uv, N_ur, *cross = more
        speed = abs(u)
        sway, munk = sway - Y_ur * speed, munk + N_uv * speed
        d22, d33 = d22 + Y_uv * speed, d33 + N_ur * speed
        if cross:
            X_vv, X_vr, X_rr, Y_rv, Y_vr, Y_rr, N_vv, N_rv, N_vr, *linear = cross
            d23, d32, eps = linear or (0.0, 0.0, 0.0)
            v = v - eps * r
            slip, turn = abs(v), abs(r)
            X = X - (X_vv * v + X_vr * r) * v - X_rr * r * r
            Y = Y - Y_rv * turn * v - (Y_vr * slip + Y_rr * turn + d23) * r
            N = N - (N_vv * slip + N_rv * turn + d32) * v - N_vr * slip * r
    c, s = ns.cos(psi), ns.sin(psi)
    x_dot, y_dot, u_dot, v_dot, r_dot = (
        u * c - v_P * s,  # (1a)
        u * s + v_P * c,  # (1b)
        (m22 * v * r - (d11 + X_uu * abs(u)) * u + X) / m11,  # (2a)
        (Y - sway * r - (d22 + Y_vv * abs(v)) * v) / m22,  # (2b)
        (munk * v - (d33 + N_rr * abs(r)) * r + N) / m33,  # (2c)
    )
    if cross:  # the side force that comes with the torque N cancels eps N / m33, see `from_outside`
        v_dot = v_dot + eps * (r_dot - torque / m33)
    return x_dot, y_dot, u_dot, v_dot, r_dot


def from_outside(load: Load, coefficients: Sequence[Number]) -> Load:
    """Return a force from outside on the origin, such as that of waves, as a part of the load of `rates`.

    With eps, `rates` takes a yaw moment N for that of a rudder, with its side force -N / arm, arm = m33 / (m22 eps). A
    moment from outside has no such force, so Y gains N / arm.

    Args:
        load: X, Y [N], N [N m].
        coefficients: as of `rates`.
    """
    _, m22, m33, *more = coefficients
    if len(more) < _WITH_EPS:
        return load
    X, Y, N = load
    return X, Y + more[-1] * m22 / m33 * N, N


def state_rates(
    state: State, load: Load, coefficients: Sequence[Number], current: CurrentVelocity = STILL_WATER, ns: Any = math
) -> State:
    """Return the time derivative of the whole state, for integrators and analysis."""
    _, _, psi, u, v, r = state
    x_dot, y_dot, u_dot, v_dot, r_dot = rates(psi, u, v, r, load, coefficients, ns)
    return x_dot + current[0], y_dot + current[1], r, u_dot, v_dot, r_dot


def rk4_step(
    state: State,
    load: Load,
    coefficients: Sequence[Number],
    dt: Number,
    current: CurrentVelocity = STILL_WATER,
    ns: Any = math,
) -> State:
    """Return the state after dt [s] by one classical Runge-Kutta step with load and current held.

    No rate depends on x and y, so the stages carry psi, u, v, r alone, and the current adds up outside of them.
    """
    x, y, psi, u, v, r = state
    h = 0.5 * dt
    a_x, a_y, a_u, a_v, a_r = rates(psi, u, v, r, load, coefficients, ns)
    r_b = r + h * a_r
    b_x, b_y, b_u, b_v, b_r = rates(psi + h * r, u + h * a_u, v + h * a_v, r_b, load, coefficients, ns)
    r_c = r + h * b_r
    c_x, c_y, c_u, c_v, c_r = rates(psi + h * r_b, u + h * b_u, v + h * b_v, r_c, load, coefficients, ns)
    r_d = r + dt * c_r
    d_x, d_y, d_u, d_v, d_r = rates(psi + dt * r_c, u + dt * c_u, v + dt * c_v, r_d, load, coefficients, ns)
    w = dt / 6
    V_x, V_y = current
    return (
        x + w * (a_x + 2 * (b_x + c_x) + d_x) + dt * V_x,
        y + w * (a_y + 2 * (b_y + c_y) + d_y) + dt * V_y,
        psi + w * (r + 2 * (r_b + r_c) + r_d),
        u + w * (a_u + 2 * (b_u + c_u) + d_u),
        v + w * (a_v + 2 * (b_v + c_v) + d_v),
        r + w * (a_r + 2 * (b_r + c_r) + d_r),
    )
