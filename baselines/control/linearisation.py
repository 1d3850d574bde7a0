"""Error dynamics linearised about steady motion, for regulators."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from auv_gym.physics.dynamics import rates
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.vehicle import Vehicle

_STEP = 1e-6
"""Half width of the central differences, in SI units; their error is about 1e-10."""


def error_dynamics(vehicle: Vehicle, u_R: float, v_R: float, r_R: float) -> tuple[Array, Array]:
    """Return A (6, 6), B (6, 2) of the errors e_x, e_y, psi_e, u_e, v_e, r_e about a motion, from (17)-(20).

    Errors are in the body frame, in SI units. The inputs are deviations from F_uR [N], F_rR [N m].

    Args:
        vehicle: the vehicle; quadratic drag, lift and cross terms are linearised.
        u_R: surge velocity [m/s].
        v_R: sway velocity [m/s].
        r_R: yaw rate [rad/s].
    """
    m11, m22, m33, d11, d22, d33, X_uu, Y_vv, N_rr, Y_uv, Y_ur, N_uv, N_ur = vehicle.coefficients
    speed, way = abs(u_R), float(np.sign(u_R))
    drag_u, drag_v = d11 + 2 * X_uu * speed, d22 + 2 * Y_vv * abs(v_R) + Y_uv * speed
    drag_r = d33 + 2 * N_rr * abs(r_R) + N_ur * speed
    sway_u, sway_r = -m11 * r_R + (Y_ur * r_R - Y_uv * v_R) * way, -m11 * u_R + Y_ur * speed
    yaw_u, yaw_v = (m11 - m22) * v_R + (N_uv * v_R - N_ur * r_R) * way, (m11 - m22) * u_R + N_uv * speed
    A = np.array(
        [
            [0.0, r_R, -v_R, 1.0, 0.0, 0.0],
            [-r_R, 0.0, u_R, 0.0, 1.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
            [0.0, 0.0, 0.0, -drag_u / m11, m22 * r_R / m11, m22 * v_R / m11],  # (20a)
            [0.0, 0.0, 0.0, sway_u / m22, -drag_v / m22, sway_r / m22],  # (20b)
            [0.0, 0.0, 0.0, yaw_u / m33, yaw_v / m33, -drag_r / m33],  # (20c)
        ]
    )
    if vehicle.has_cross_terms:
        A[3:, 3:] = _velocity_slopes(vehicle, (u_R, v_R, r_R))
    B = np.zeros((6, 2))
    B[3, 0], B[5, 1] = 1 / m11, 1 / m33
    return A, B


def _velocity_slopes(vehicle: Vehicle, velocities: Sequence[float]) -> Array:
    """Return the derivatives of u', v', r' by u, v, r without forces, shape (3, 3), by central differences."""

    def changes(steps: Array) -> Array:
        u, v, r = np.array(velocities)[:, None] + steps
        return np.array(rates(0.0 * u, u, v, r, (0.0, 0.0, 0.0), vehicle.acting, ARRAYS)[2:])

    return (changes(_STEP * np.eye(3)) - changes(-_STEP * np.eye(3))) / (2 * _STEP)
