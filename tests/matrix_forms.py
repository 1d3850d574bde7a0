"""REMUS 100 and Otter as Fossen (2021) prints equations of motion, with matrices: for comparison."""

import math

import numpy as np
from scipy.integrate import quad
from scipy.spatial.transform import Rotation


def S(a):
    return np.cross(np.eye(3), a)


def H(r):
    matrix = np.eye(6)
    matrix[:3, 3:] = S(r).T
    return matrix


def strips(v, r, length, beam, draft):
    """The sum over strips, with Hoerner's coefficient interpolated between the two nearest points of his curve."""
    known = {0.5: (0.4933, 1.2108, 0.5585, 1.0836), 0.640625: (0.5585, 1.0836, 0.6464, 0.9986)}
    x_0, y_0, x_1, y_1 = known[round(beam / 2 / draft, 6)]
    C = y_0 + (y_1 - y_0) * (beam / 2 / draft - x_0) / (x_1 - x_0)
    x = np.linspace(-length / 2, length / 2, 21)
    force = -0.5 * 1026 * draft * C * np.abs(v + x * r) * (v + x * r) * length / 20
    return force.sum(), (x * force).sum()


def lamb(a, b):
    """Lamb's factors of a spheroid by his integrals."""
    along = quad(lambda x: a * b * b / ((a * a + x) ** 1.5 * (b * b + x)), 0, np.inf, epsabs=1e-13)[0]
    across = quad(lambda x: a * b * b / ((a * a + x) ** 0.5 * (b * b + x) ** 2), 0, np.inf, epsabs=1e-13)[0]
    slim, sum_ = a * a - b * b, a * a + b * b
    turning = slim**2 * (across - along) / (sum_ * (2 * slim - sum_ * (across - along)))
    return along / (2 - along), across / (2 - across), turning


def remus_acceleration(eta, nu, act):
    """M nu' + C(nu) nu + D nu + g(eta) = tau of REMUS 100, matrices filled as Fossen (2021) prints them."""
    a, b, rho = 0.8, 0.095, 1026.0
    m = 4 / 3 * math.pi * rho * a * b * b
    J = m / 5 * np.array([2 * b * b, a * a + b * b, a * a + b * b])
    rigid = H([0, 0, 0.02]).T @ np.diag([m, m, m, *J]) @ H([0, 0, 0.02])
    k1, k2, k3 = lamb(a, b)
    added = np.array([m * k1, m * k2, m * k2, 0.3 * J[0], k3 * J[1], k3 * J[2]])
    M = rigid + np.diag(added)
    v, w = nu[:3], nu[3:]
    C_rigid = np.zeros((6, 6))
    C_rigid[:3, :3], C_rigid[3:, 3:] = m * S(w), -S(J * w)
    C_rigid = H([0, 0, 0.02]).T @ C_rigid @ H([0, 0, 0.02])
    C_added = np.block([[np.zeros((3, 3)), -S(added[:3] * v)], [-S(added[:3] * v), -S(added[3:] * w)]])
    for place in ((4, 0), (0, 4), (4, 2), (2, 4), (5, 0), (0, 5), (5, 1), (1, 5)):
        C_added[place] = 0
    U = np.linalg.norm(v)
    W = 9.81 * m
    own = np.sqrt(W * 0.02 * np.diag(M)[3:5])
    D = np.diag([M[0, 0] / 20 * math.exp(-3 * U), M[1, 1] / 20 * math.exp(-3 * U), M[2, 2] / 20, 0, 0, M[5, 5]])
    D[3, 3], D[4, 4] = 2 * 0.3 * own[0], 2 * 0.8 * own[1]
    area, alpha = 0.7 * 1.6 * 0.19, math.atan2(nu[2], nu[0])
    AR = 0.19**2 / area
    CL = math.pi * AR / (1 + math.sqrt(1 + AR * AR / 4)) * alpha
    CD = 0.42 * math.pi * b * b / area + CL**2 / (math.pi * 0.7 * AR)
    flow = 0.5 * rho * U * U * area * np.array([-CD, -CL])
    X_hull, Z_hull = np.array([[math.cos(alpha), -math.sin(alpha)], [math.sin(alpha), math.cos(alpha)]]) @ flow
    Y_cross, N_cross = strips(nu[1], nu[5], 1.6, 0.19, 0.19)
    delta_r, delta_s, n = act[0], act[1], act[2] / 60
    advance = 0.944 * U / (0.14 * n) if n > 0 else 0.0
    T = 0.9 * rho * 0.14**4 * n * abs(n) * (0.4566 + (0.1798 - 0.4566) / 0.6632 * advance)
    Q = 0.1 * rho * 0.14**5 * n * abs(n) * (0.07 + (0.0312 - 0.07) / 0.6632 * advance)
    q_r, q_s = 0.5 * rho * (nu[0] ** 2 + nu[1] ** 2) * 0.0133, 0.5 * rho * (nu[0] ** 2 + nu[2] ** 2) * 0.0133
    Y, Z = -0.5 * q_r * delta_r, -0.7 * q_s * delta_s
    tau = np.array([T + Y * delta_r + Z * delta_s, Y, Z, Q, 0.8 * Z, -0.8 * Y])
    tau += [X_hull, Y_cross, Z_hull, 0, 0, N_cross]
    phi, theta = eta[3:5]
    g = 0.02 * W * np.array([0, 0, 0, math.cos(theta) * math.sin(phi), math.sin(theta), 0])
    return np.linalg.solve(M, tau - (C_rigid + C_added + D) @ nu - g)


def otter_acceleration(eta, nu, act):
    """The same of the Otter: the source's numbers, written out."""
    m, mp, g0 = 55.0, 25.0, 9.81
    r_g, r_p = (55 * np.array([0.2, 0, -0.2]) + 25 * np.array([0.05, 0, -0.35])) / 80, np.array([0.05, 0, -0.35])
    J = m * np.diag([0.432**2, 0.25, 0.25]) - m * S(r_g) @ S(r_g) - mp * S(r_p) @ S(r_p)
    centre = np.block([[80 * np.eye(3), np.zeros((3, 3))], [np.zeros((3, 3)), J]])
    added = np.array([5.5, 82.5, 55.0, 0.2 * J[0, 0], 0.8 * J[1, 1], 1.7 * J[2, 2]])
    M = H(r_g).T @ centre @ H(r_g) + np.diag(added)
    v, w = nu[:3], nu[3:]
    C = np.zeros((6, 6))
    C[:3, :3], C[3:, 3:] = 80 * S(w), -S(J @ w)
    C = H(r_g).T @ C @ H(r_g)
    C += np.block([[np.zeros((3, 3)), -S(added[:3] * v)], [-S(added[:3] * v), -S(added[3:] * w)]])
    volume = 80 / 1025
    draft, A = volume / 0.4, 0.75
    second = np.array([2 / 12 * 2 * 0.25**3 * (6 * 0.75**3 / (1.75 * 2.5)) + A * 0.395**2, 0.8 * 2 / 12 * 0.25 * 8])
    GM = (5 * draft / 2 - volume) / 3 + second / volume - (draft - r_g[2])
    stiff = np.array([0, 0, 1025 * g0 * A, *(1025 * g0 * volume * GM), 0])
    own = np.sqrt(stiff * np.diag(M))
    D = np.array([24.4 * g0 / 3.0864, M[1, 1], 0.6 * own[2], 0.4 * own[3], 0.8 * own[4], M[5, 5]])
    G = H([-0.2, 0, 0]).T @ np.diag(stiff) @ H([-0.2, 0, 0])
    down = Rotation.from_euler("ZYX", [eta[5], eta[4], eta[3]]).inv().apply([0, 0, mp * g0])
    T = [(0.01108 if n > 0 else 0.006445) * n * abs(n) for n in act]
    Y, N = strips(nu[1], nu[5], 2.0, 0.25, draft)
    tau = np.array([T[0] + T[1], Y, 0, 0, 0, 0.395 * (T[0] - T[1]) + N - 10 * D[5] * abs(nu[5]) * nu[5]])
    return np.linalg.solve(M, tau - C @ nu - D * nu - G @ eta + np.concatenate((down, np.cross(r_p, down))))
