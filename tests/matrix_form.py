"""The equations of motion once more, in matrix form, for the tests to check against."""

import numpy as np


def matrix_form(state, tau, vehicle, current=(0.0, 0.0)):
    """Return eta' = R(psi) nu + V_c and nu' of M nu' + C(nu) nu + D(nu) nu = tau, shape (6,)."""
    psi, nu = state[2], np.array(state[3:])
    M = np.diag([vehicle.m11, vehicle.m22, vehicle.m33])
    a, b = -vehicle.m22 * nu[1], vehicle.m11 * nu[0]
    C = np.array([[0, 0, a], [0, 0, b], [-a, -b, 0]])
    linear, quadratic = [vehicle.d11, vehicle.d22, vehicle.d33], [vehicle.X_uu, vehicle.Y_vv, vehicle.N_rr]
    D = np.diag(linear + np.array(quadratic) * abs(nu))
    D[1:, 1:] += abs(nu[0]) * np.array([[vehicle.Y_uv, -vehicle.Y_ur], [-vehicle.N_uv, vehicle.N_ur]])
    _, v, r = nu
    loss = np.array([vehicle.X_vv * v * v + vehicle.X_vr * v * r + vehicle.X_rr * r * r, 0.0, 0.0])
    cross = [[vehicle.Y_rv * abs(r), vehicle.Y_vr * abs(v) + vehicle.Y_rr * abs(r) + vehicle.d23]]
    cross += [[vehicle.N_vv * abs(v) + vehicle.N_rv * abs(r) + vehicle.d32, vehicle.N_vr * abs(v)]]
    D[1:, 1:] += np.array(cross)
    R = np.array([[np.cos(psi), -np.sin(psi), 0], [np.sin(psi), np.cos(psi), 0], [0, 0, 1]])
    return np.concatenate((R @ nu + [*current, 0], np.linalg.solve(M, np.array(tau) - loss - (C + D) @ nu)))
