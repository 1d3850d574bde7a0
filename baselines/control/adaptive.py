"""The speed-normalised tracking law with L1 adaptive augmentation.

N. Hovakimyan and C. Cao, L1 Adaptive Control Theory, SIAM 2010, chapters 2 and 3: the velocities nu are predicted by
the nominal model f and an estimate sigma of all unmodelled accelerations,

    nu^' = f(nu, F) + sigma - a (nu^ - nu),    sigma' = -Gamma (nu^ - nu).

The adaptation is fast; low-pass filters on its results make the control robust. Here the predictor is discrete in time,
and a and Gamma place both poles of every axis at exp(-predictor dt). In a current with the components c_u, c_v in the
body frame, sigma is

    m11 sigma_u = d11 c_u - (m22 - m11) r c_v,    m22 sigma_v = d22 c_v - (m22 - m11) r c_u.

Sway has no actuator that could cancel sigma_v. So the two equations are solved for the current. The current is low-pass
filtered in the world frame, and the reference of the law is planned for it. The remaining part of sigma in surge and
yaw is cancelled up to a bandwidth.
"""

from __future__ import annotations

from typing import Any, NamedTuple, cast

from auv_gym.physics.errors import to_body, to_world
from auv_gym.physics.namespaces import Namespace, Number
from auv_gym.physics.vehicle import Coefficients, Vehicle
from auv_gym.task.observation import Observation, V
from baselines.control.backstepping import tracking_forces
from baselines.control.ekf_law import undamped_symbols
from baselines.control.traced import TracedController, TracedLaw, effective_periods, predicted_velocities
from baselines.estimation.water_frame import PlannedReference, Sea, plan_in_water, reference_motion, water_errors

LARGEST_SIGMA = 10.0
"""Bound [m/s^2], [rad/s^2] of sigma."""


class AdaptiveGains(NamedTuple):
    """Gains of the law, see `backstepping.undamped`, and of the adaptation."""

    k: Number  # [1/s]
    cu: Number  # [1/s]
    c: Number  # [1/s]
    cr: Number  # [1/s]
    reference_speed: Number  # [m/s]
    predictor: Number  # [1/s] poles of the predictor
    drift: Number  # [1/s] bandwidth of the current's filter
    bandwidth: Number  # [1/s] up to which loads in surge and yaw are cancelled


class AdaptiveMemory(NamedTuple):
    """Memory of the planner, see `water_frame.PlannedReference`, and of the adaptation."""

    count: Number
    a_x: Number
    a_y: Number
    before_x: Number
    before_y: Number
    w: Number
    rest: Number
    u: Number  # [m/s] predicted, over ground
    v: Number  # [m/s]
    r: Number  # [rad/s]
    sigma_u: Number  # [m/s^2]
    sigma_v: Number  # [m/s^2]
    sigma_r: Number  # [rad/s^2]
    u_last: Number  # [m/s] last measured velocities over ground
    v_last: Number  # [m/s]
    r_last: Number  # [rad/s]
    V_x: Number  # [m/s] current in the world
    V_y: Number  # [m/s]
    X: Number  # [N] cancelled load
    N: Number  # [N m]


_PLAN = len(PlannedReference._fields)  # number of entries of the planner
_AT: Any = AdaptiveMemory._make(range(len(AdaptiveMemory._fields)))  # index of each entry
AT_PREDICTED = slice(_AT.u, _AT.sigma_u)  # the predicted velocities
AT_SIGMA = slice(_AT.sigma_u, _AT.u_last)  # sigma of the three axes
AT_LAST = slice(_AT.u_last, _AT.V_x)  # the last measured velocities


def adaptive(
    o: Observation, before: AdaptiveMemory, g: AdaptiveGains, vehicle: Coefficients, ns: Namespace
) -> tuple[AdaptiveMemory, tuple[Number, Number]]:
    """Return the memory, and F_u [N], F_r [N m]; see `traced.LawEquation`."""
    c, first = vehicle, before.count <= 0.0
    measured = o.u_R + o.u_e, o.v_R + o.v_e, o.r_R + o.r_e
    predicted, sigma = _adaptation(o, before, measured, g.predictor, c, ns)
    V_u, V_v = current_of(sigma, measured[2], c)
    V_x, V_y = to_world(V_u, V_v, o.cos_psi, o.sin_psi)
    gain = ns.where(first, 0.0, 1 - ns.exp(-g.drift * o.dt))
    V_x = ns.clip(before.V_x + gain * (V_x - before.V_x), -V, V)
    V_y = ns.clip(before.V_y + gain * (V_y - before.V_y), -V, V)
    V_u, V_v = to_body(V_x, V_y, o.cos_psi, o.sin_psi)
    u, v, r = measured[0] - V_u, measured[1] - V_v, measured[2]
    by_current = (c.d11 * V_u - (c.m22 - c.m11) * r * V_v) / c.m11, yaw_of_current(measured, (u, v), c)
    gain = ns.where(first, 0.0, 1 - ns.exp(-g.bandwidth * o.dt))
    X = before.X + gain * (c.m11 * (sigma[0] - by_current[0]) - before.X)
    N = before.N + gain * (c.m33 * (sigma[2] - by_current[1]) - before.N)
    plan, R = plan_in_water(PlannedReference(*before[:_PLAN]), reference_motion(o, c, ns), Sea(V_x, V_y), o.dt, c, ns)
    psi = ns.arctan2(o.sin_psi, o.cos_psi)
    errors = water_errors((o.e_x, o.e_y, psi, u, v, r), R, ns)
    law = undamped_symbols((g.k, g.cu, g.c, g.cr, g.reference_speed))
    F_u, F_r = tracking_forces(errors, cast(Vehicle, c), law, ns)
    return AdaptiveMemory._make((*plan, *predicted, *sigma, *measured, V_x, V_y, X, N)), (F_u - X, F_r - N)


def _adaptation(
    o: Observation,
    before: AdaptiveMemory,
    measured: tuple[Number, Number, Number],
    p: Number,
    vehicle: Coefficients,
    ns: Namespace,
) -> tuple[tuple[Number, ...], tuple[Number, ...]]:
    """Return the predicted velocities and sigma, each in surge, sway and yaw.

    Args:
        o: the observation in SI units.
        before: memory of the controller.
        measured: velocities over ground.
        p: [1/s] poles of the predictor.
        vehicle: the nominal one.
        ns: the namespace of the numbers.
    """
    first, pole = before.count <= 0.0, ns.exp(-p * o.dt)
    follow, adapt = 1 - pole * pole, (1 - pole) * (1 - pole)
    last, past = before[AT_LAST], before[AT_SIGMA]
    model = predicted_velocities(o, last, past, vehicle, ns)
    predicted, sigma = [], []
    axes = zip(measured, before[AT_PREDICTED], last, model, past, effective_periods(o.dt, vehicle, ns), strict=True)
    for nu, old, then, now, value, period in axes:
        error = ns.where(first, 0.0, ns.clip(now + (1 - follow) * (old - then), -V, V) - nu)
        predicted.append(nu + error)
        sigma.append(ns.clip(value - adapt / period * error, -LARGEST_SIGMA, LARGEST_SIGMA))
    return tuple(predicted), tuple(sigma)


def current_of(sigma: tuple[Number, ...], r: Number, vehicle: Coefficients) -> tuple[Number, Number]:
    """Return the current in the body frame [m/s] that explains sigma in surge and sway at a yaw rate r [rad/s]."""
    c = vehicle
    coupling = (c.m22 - c.m11) * r
    X, Y, det = c.m11 * sigma[0], c.m22 * sigma[1], c.d11 * c.d22 - coupling * coupling
    return (c.d22 * X + coupling * Y) / det, (c.d11 * Y + coupling * X) / det


def yaw_of_current(
    measured: tuple[Number, Number, Number], relative: tuple[Number, Number], vehicle: Coefficients
) -> Number:
    """Return sigma in yaw [rad/s^2] due to a current, from velocities over ground and relative to the water."""
    c = vehicle
    return (c.m22 - c.m11) * (measured[0] * measured[1] - relative[0] * relative[1]) / c.m33


class Adaptive(TracedController):
    """The controller; its gains are the fields of `AdaptiveGains`."""

    law = TracedLaw(adaptive, AdaptiveGains, AdaptiveMemory)
