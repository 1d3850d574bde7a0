"""Entries of the vehicle files, computed from the raw numbers of their sources, for the tests to compare with."""

import math

import numpy as np


def lamb(a, b):
    """Added mass of a spheroid in water, as shares of its mass along and across, and of its moment of inertia."""
    e = math.sqrt(1 - (b / a) ** 2)
    alpha = 2 * (1 - e**2) / e**3 * (math.atanh(e) - e)
    beta = 1 / e**2 - (1 - e**2) / e**3 * math.atanh(e)
    turn = e**4 * (beta - alpha) / ((2 - e**2) * (2 * e**2 - (2 - e**2) * (beta - alpha)))
    return alpha / (2 - alpha), beta / (2 - beta), turn


def hoerner(half):
    """Return the drag coefficient of a section for half its beam over its draft, from the digitised curve."""
    return np.interp(half, (0.4933, 0.5585, 0.6464), (1.2108, 1.0836, 0.9986))


def strips(drag, length, count=20):
    """Return cross-flow terms by least squares over all ratios of v and length r, for `drag` [kg/m^2] by length.

    As in the sources, the integral over the length is a sum at both ends of `count` strips.
    """
    angle, x = np.linspace(0, 2 * np.pi, 361)[:-1, None], length * (np.arange(count + 1) / count - 0.5)
    v, r = np.cos(angle), np.sin(angle) / length
    force = drag * length / count * np.abs(v + x * r) * (v + x * r)
    v, r = v[:, 0], r[:, 0]
    Y = np.linalg.lstsq(np.stack((abs(v) * v, abs(r) * v), axis=1), force.sum(axis=1), rcond=None)[0]
    N = np.linalg.lstsq(np.stack((abs(v) * r, abs(r) * r), axis=1), (x * force).sum(axis=1), rcond=None)[0]
    return dict(zip(("Y_vv", "Y_rv", "N_vr", "N_rr"), (*Y, *N), strict=True))


def lauv():
    fins = 2 * 0.5 * 1028 * 0.0064 * 3.0 * 0.4 * math.radians(30)
    spin = 18 * (3 * 0.075**2 + 1.08**2) / 12
    body = {"m11": 18 + 1, "m22": 18 + 16, "m33": spin + 1.3, "d11": 2.4, "d22": 23, "d33": 9.7}
    body |= {"d23": -11.5, "d32": 3.1, "Y_rr": -0.3, "N_vv": 1.5, "eps": (spin + 1.3) / (18 + 16) / 0.4}
    return {
        **body,
        "X_uu": 2.4,
        "Y_vv": 80,
        "N_rr": 9.1,
        "fin": fins,
        "F_u_max": 2.4 * 2 + 2.4 * 4,
        "F_r_max": 4 * fins,
    }


def remus100():
    a, b, rho = 0.8, 0.095, 1026
    m, (k1, k2, k3) = 4 / 3 * math.pi * rho * a * b * b, lamb(a, b)
    m11, m22, m33 = m * (1 + k1), m * (1 + k2), m * (a * a + b * b) / 5 * (1 + k3)
    n, D, J = 1525 / 60, 0.14, 0.944 * 2.5 / (0.14 * 1525 / 60)
    thrust = 0.9 * rho * D**4 * n * n * (0.4566 + (0.1798 - 0.4566) / 0.6632 * J)
    fin = 0.5 * rho * 0.0133 * 0.5 * a * math.radians(15)
    body = {"m11": m11, "m22": m22, "m33": m33, "d33": m33, "Y_ur": m11 - m}
    body |= {"d11": math.exp(-3 * 0.8) * m11 / 20, "d22": math.exp(-3 * 0.8) * m22 / 20}
    body |= {"X_vr": m22 - m, "eps": m33 / m22 / a, **strips(0.5 * rho * 2 * b * hoerner(0.5), 2 * a)}
    drag = {"X_uu": 0.5 * rho * 0.42 * math.pi * b * b, "N_uv": m22 - m11}
    return {**body, **drag, "fin": fin, "F_u_max": thrust, "F_r_max": fin * 2.5**2}


def eca_a9():
    fin = 4 * 7.2 * math.sqrt(0.5) * 0.70777 * math.radians(20)
    body = {
        "m11": 69.7 + 4,
        "m22": 69.7 + 95,
        "m33": 35 + 32,
        "d11": 0.8,
        "d22": 16.2,
        "d33": 3.2,
        "X_uu": 8,
        "Y_uv": 162,
    }
    lift = {"Y_ur": 150, "N_uv": -34, "N_ur": 32}
    body["eps"] = 67 / 164.7 / 0.70777
    return {**body, **lift, "fin": fin, "F_u_max": 8 * 2.5**2, "F_r_max": fin * 2.5**2}


def nps_auv2():
    m, (r2, r3, r4, r5) = 53400 / 9.81, (0.5 * 1025 * 5.3**n for n in (2, 3, 4, 5))
    m11, m22 = m + 7.6e-3 * r3, m + 5.5e-2 * r3
    drag = {"X_uu": 0.00385 * r2, "Y_uv": 0.1 * r2, "N_ur": 1.6e-2 * r4}
    drag |= strips(0.5 * 1025 * 0.5 * 0.53, 5.3, count=10)
    drag |= {"X_vv": -5.3e-2 * r2, "X_vr": m22 - m - 2e-2 * r3, "X_rr": -4e-3 * r4}
    drag["eps"] = (13587 + 3.4e-3 * r5) / m22 / (1.3e-2 * r3) * (2.7e-2 * r2)
    mixed = {"Y_ur": 3e-2 * r3 - (m - m11), "N_uv": -7.4e-3 * r3 + (m22 - m11)}
    fast, fin = 0.012 * 1500 / 60 * 2 * math.pi, 1.3e-2 * r3 * math.radians(20)
    limits = {"fin": fin, "F_u_max": 0.00385 * r2 * fast**2, "F_r_max": fin * fast**2}
    return {"m11": m11, "m22": m22, "m33": 13587 + 3.4e-3 * r5, **drag, **mixed, **limits}


def otter():
    ahead, astern, m, payload = 24.4 * 9.81, 13.6 * 9.81, 55, 25
    x = (m * 0.2 + payload * 0.05) / (m + payload)
    spin = m * 0.5**2 + m * x * x + payload * 0.05**2
    m22, m33 = m + payload + 1.5 * m, spin + (m + payload) * x * x + 1.7 * spin
    draft = (m + payload) / 1025 / (2 * 2.0 * 0.25 * 0.4)
    drag = {"d11": ahead / (6 * 0.5144), "d22": m22, "d33": m33, **strips(0.5 * 1026 * draft * hoerner(0.64), 2.0)}
    drag["N_rr"] += 10 * m33
    limits = {"F_u_max": ahead, "F_r_max": 0.395 * (ahead + astern) / 2, "astern": astern / ahead}
    return {"m11": m + payload + 0.1 * m, "m22": m22, "m33": m33, **drag, **limits}


def cybership2():
    body = {"m11": 23.8 + 2, "m22": 23.8 + 10, "m33": 1.76 + 1, "d11": 0.72253, "d22": 0.88965, "d33": 1.9}
    drag = {"X_uu": 1.32742, "Y_vv": 36.47287, "N_rr": 0.75}
    return {**body, **drag, "F_u_max": 8, "F_r_max": 2.5, "astern": 0.5}


def gunnerus():
    m = 574127.69
    body = {"m11": m + 26599.24721721, "m22": m + 132619.44, "m33": 41237080 + 13320142}
    drag = {"d11": 1117.59831, "d22": 22288.64, "d33": 1949686.56, "X_uu": 1671.60006965, "Y_vv": 23611.351393}
    return {**body, **drag, "N_rr": 365427334, "F_u_max": 154273, "F_r_max": 0.6 * 154273 * 15.5600097}


def supply():
    m, L = 6000e3, 76.2
    rate = m * math.sqrt(9.81 / L)
    body = {"m11": 1.1274 * m, "m22": 1.8902 * m, "m33": 0.1278 * m * L * L}
    return {**body, "d11": 0.0358 * rate, "d22": 0.1183 * rate, "d33": 0.0308 * rate * L * L}


SOURCES = {
    f.__name__.replace("_", "-"): f for f in (lauv, remus100, eca_a9, nps_auv2, otter, cybership2, gunnerus, supply)
}
