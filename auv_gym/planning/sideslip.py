"""The sideslip of a vehicle without a side thruster on a path, and the rates of speed and direction along the path.

With w = sin(gamma) = v_R / v_p, the paper's (8)-(15) become one scalar equation, without the singularity of (15) at
v_R = 0,

    w' = -(d22/Dm) w - [(m22 v_p'/v_p + Y_vv v_p |w|) w + (m omega + Y_uv v_p w) sqrt(1 - w^2)] / Dm,

with m = m11 and Dm = m22 - m. For a vehicle with lift m = m11 - Y_ur: at u = v_p sqrt(1 - w^2) lift changes the sway
force of a turn and adds Y_uv u to the sway drag. The time constant of the first term is Dm/d22 (0.5 s for the paper's
vehicle). This term is integrated exactly, the other terms by an Adams-Bashforth formula: exponential time differencing
(S. M. Cox and P. C. Matthews, J. Comput. Phys. 176:430-455, 2002).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss

from auv_gym.physics.dynamics import rates
from auv_gym.physics.namespaces import ARRAYS, Namespace, Number
from auv_gym.physics.vehicle import Coefficients, Vehicle

ORDER = 4  # number of samples in each integration formula
SIDESLIP_TERMS = 4  # number of terms of the equation, see `sideslip_terms`
MAX_SIDESLIP = math.radians(80.0)  # largest sideslip of a reference
_POINTS, _GAUSS = leggauss(24)  # points and weights of an integral over [-1, 1]


@dataclass(frozen=True, eq=False)
class PathRates:
    """Speed, direction and their time derivatives along a path: arrays of one shape, or other numbers."""

    v_p: Number  # [m/s] (3)
    beta: Number  # [rad] (4), by atan2
    omega: Number  # [rad/s] (5)
    v_p_dot: Number  # [m/s^2] (6)
    omega_dot: Number  # [rad/s^2]
    v_p_ddot: Number  # [m/s^3]


RATES = tuple(field.name for field in fields(PathRates))  # names of the fields


def path_rates(derivatives: Any, ns: Namespace = ARRAYS) -> PathRates:
    """Return the rates of a path, for its position and three time derivatives, shape (4, 2, ...)."""
    (x1, y1), (x2, y2), (x3, y3) = derivatives[1:]
    v_p = ns.hypot(x1, y1)
    with np.errstate(divide="ignore", invalid="ignore"):  # `plan` reports a speed of zero
        omega = (x1 * y2 - y1 * x2) / v_p**2
        v_p_dot = (x1 * x2 + y1 * y2) / v_p
        omega_dot = (x1 * y3 - y1 * x3) / v_p**2 - 2 * omega * v_p_dot / v_p
        v_p_ddot = (x1 * x3 + y1 * y3) / v_p + v_p * omega**2
    return PathRates(v_p, ns.arctan2(y1, x1), omega, v_p_dot, omega_dot, v_p_ddot)


def formula_weights(z: float) -> list[float]:
    """Return the weights of the integration formulas for a step of z time constants Dm/d22.

    In the symbols of Cox and Matthews the equation of the module's docstring is u' = c u + F(u, t) with u = w and
    c = -d22/Dm. Below, F is h F and z = -c h. The first weights are those of the implicit formula for the first `ORDER`
    samples: the decays e^(-k z) of samples 1 to `ORDER` - 1, then the weights of F for each of them. The last ones are
    the decay and g_3 ... g_0 of u_(n+1) = e^(-z) u_n + g_0 F_n + g_1 F_(n-1) + g_2 F_(n-2) + g_3 F_(n-3).
    """
    first = [math.exp(-k * z) for k in range(1, ORDER)] + [g for k in range(1, ORDER) for g in _weights(z, 0, k)]
    return [*first, math.exp(-z), *_weights(z, 1 - ORDER, 1)]


def weighted_sum(total: Number, weights: Sequence[Number], F: Sequence[Number]) -> Number:
    """Return total + sum_k weights[k] F[k], added in this order."""
    for g, f in zip(weights, F, strict=True):
        total = total + g * f
    return total


def sideslip_terms(along: PathRates, c: Vehicle | Coefficients) -> tuple[Number, Number, Number, Number]:
    """Return the factors of w, |w| w, sqrt(1 - w^2) and w sqrt(1 - w^2) in the bracket of the module's docstring."""
    v_p = along.v_p
    return c.m22 * along.v_p_dot / v_p, c.Y_vv * v_p, (c.m11 - c.Y_ur) * along.omega, c.Y_uv * v_p


def sideslip_rest(terms: Sequence[Number], w: Number, sqrt: Callable[[Number], Number]) -> Number:
    """Return the nonlinear part of the equation: minus the bracket, for its `sideslip_terms`, which may be scaled."""
    slope, square, turn, lift = terms
    return -(slope + square * abs(w)) * w - (turn + lift * w) * sqrt(abs(1 - w * w))  # abs: beyond 90 degrees


def response(along: PathRates, c: Vehicle | Coefficients, ns: Namespace) -> Number:
    """Return the derivative by w of the nonlinear part of the equation for w [1/s], at the quasi-steady gamma."""
    a, turn = along.v_p_dot / along.v_p, abs(c.m11 - c.Y_ur) * abs(along.omega)
    lift = c.Y_uv * along.v_p
    tan = ns.clip(turn / (c.d22 + c.m22 * a + lift), -math.inf, math.tan(MAX_SIDESLIP))
    drag = 2 * c.Y_vv * along.v_p * tan / ns.sqrt(1 + tan * tan)
    return (c.m22 * abs(a) + turn * tan + drag + lift) / (c.m22 - (c.m11 - c.Y_ur))


def steady_sideslip(along: PathRates, vehicle: Vehicle | Coefficients, ns: Namespace) -> Number:
    """Return w without the fast transient, by two iterations of m omega + D tan(gamma) = -Dm gamma'."""
    a, m = along.v_p_dot / along.v_p, vehicle.m11 - vehicle.Y_ur
    linear, turn = vehicle.d22 + vehicle.m22 * a + vehicle.Y_uv * along.v_p, m * along.omega
    slope = ns.sqrt(linear**2 + 4 * vehicle.Y_vv * along.v_p * abs(turn))  # d (D tan(gamma)) / d tan(gamma)
    tan = -2 * turn / (linear + slope)
    D_dot = vehicle.m22 * (along.v_p_ddot / along.v_p - a * a) + vehicle.Y_uv * along.v_p_dot
    gamma_dot = -(m * along.omega_dot + D_dot * tan) / (slope * (1 + tan * tan))
    tan = tan - (vehicle.m22 - m) * gamma_dot / slope
    return tan / ns.sqrt(1 + tan * tan)


def sideslip_step(
    w: Number, rest: Number, rest_at: Callable[[Number], Number], z: Number, largest: float, ns: Namespace = ARRAYS
) -> tuple[Number, Number]:
    """Return w, clipped to +-`largest`, and the nonlinear part of its equation after a step of z time constants.

    The formula is the exponential Runge-Kutta method of second order (Cox and Matthews 2002, eq. 22). It is less
    accurate than `plan`, but needs no earlier samples, so it can be used online.

    Args:
        w: sine of the sideslip before the step.
        rest: the nonlinear part before the step, times the step.
        rest_at: returns the nonlinear part after the step, times the step, for w.
        z: the step divided by the time constant Dm/d22.
        largest: largest |w|.
        ns: the namespace of the numbers.
    """
    decay = ns.exp(-z)
    guess = decay * w + (1 - decay) / z * rest
    correction = rest_at(ns.clip(guess, -largest, largest)) - rest
    new = ns.clip(guess + (z - 1 + decay) / (z * z) * correction, -largest, largest)
    return new, rest_at(new)


@lru_cache(2**12)  # a training plans repeatedly for hundreds of vehicles
def _weights(z: float, first: int, end: int) -> tuple[float, ...]:
    """Return the c_j of  integral_0^end exp(-z (end - s)) n(s) ds = sum_j c_j n(first + j),  exact for cubic n."""
    nodes = range(first, first + ORDER)
    s = 0.5 * end * (_POINTS + 1)
    kernel = 0.5 * end * _GAUSS * np.exp(-z * (end - s))
    return tuple(float(kernel @ np.prod([(s - m) / (j - m) for m in nodes if m != j], axis=0)) for j in nodes)


def in_sideslip(
    along: PathRates, w: Number, coefficients: Coefficients, sway_load: tuple[Number, Number], ns: Namespace
) -> tuple[Number, ...]:
    """Return psi [rad], u, v [m/s], r [rad/s], F_u [N], F_r [N m], gamma [rad] on a path; see `planner.Reference`."""
    m11, m22, m33, _, d22, _, _, Y_vv, _, Y_uv, *_ = coefficients
    m, Dm = m11 - coefficients.Y_ur, coefficients.slip_mass
    v_p, beta, om, v_p_dot, om_dot, v_p_ddot = (getattr(along, name) for name in RATES)
    c = ns.sqrt(1 - w * w)
    tan, gamma, a = w / c, ns.arcsin(w), v_p_dot / v_p
    u, v = v_p * c, v_p * w  # (7), (8)
    D = d22 + Y_uv * u + Y_vv * abs(v) + m22 * a
    push = sway_load[0] / u
    gamma_dot = -(m * om + D * tan - push) / Dm
    u_dot, v_dot = v_p_dot * c - v * gamma_dot, v_p_dot * w + u * gamma_dot  # (12)
    side = ns.where(v < 0, -1.0, ns.where(v > 0, 1.0, 0.0))
    D_dot = Y_vv * side * v_dot + m22 * (v_p_ddot / v_p - a * a) + Y_uv * u_dot
    push_dot = sway_load[1] / u + push * (tan * gamma_dot - a)
    gamma_ddot = -(m * om_dot + D_dot * tan + D * gamma_dot / c**2 - push_dot) / Dm
    psi = beta - gamma  # (10) with the signed sideslip
    r, r_dot = om - gamma_dot, om_dot - gamma_ddot  # (14)
    _, _, u_free, _, r_free = rates(psi, u, v, r, (0.0, 0.0, 0.0), coefficients, ns)
    return psi, u, v, r, m11 * (u_dot - u_free), m33 * (r_dot - r_free), gamma  # (16)
