"""The speed-normalised tracking law with L1 adaptive augmentation.

N. Hovakimyan and C. Cao, L1 Adaptive Control Theory, SIAM 2010, chapters 2 and 3: a predictor of the velocities nu runs
on the known model f and an estimate sigma of all that f leaves out,

    nu^' = f(nu, F) + sigma - a (nu^ - nu),    sigma' = -Gamma (nu^ - nu).

It adapts fast; robust is what is done with it, behind low-passes. Here it is sampled, and a and Gamma are those for
which both poles of every axis are exp(-predictor dt). Where there is a current the water moves, and sigma is

    m11 sigma_u = d11 c_u - (m22 - m11) r c_v,    m22 sigma_v = d22 c_v - (m22 - m11) r c_u,

with its components c_u, c_v. Sway has no actuator that could take that away: it is solved for the current, which is
filtered in the world, and for which the law's reference is planned anew. What is then left of sigma in surge and yaw is
cancelled below a bandwidth.
"""

from __future__ import annotations

from typing import Any, NamedTuple, cast

from auv_gym.physics.errors import to_body, to_world
from auv_gym.physics.namespaces import Namespace, Number
from auv_gym.physics.vehicle import Coefficients, Vehicle
from auv_gym.task.observation import Observation, V
from baselines.control.backstepping import tracking_forces
from baselines.control.ekf_law import undamped_symbols
from baselines.control.traced import TracedController, TracedLaw, effective_periods, foreseen_velocities
from baselines.estimation.water_frame import PlannedReference, Sea, planned, reference_motion, water_errors

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
    drift: Number  # [1/s] with which the current is found
    bandwidth: Number  # [1/s] below which surge and yaw loads are cancelled


class AdaptiveMemory(NamedTuple):
    """What is remembered: of the planner, see `water_frame.PlannedReference`, and of the adaptation."""

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
    u_last: Number  # [m/s] measured last, over ground
    v_last: Number  # [m/s]
    r_last: Number  # [rad/s]
    V_x: Number  # [m/s] current in the world
    V_y: Number  # [m/s]
    X: Number  # [N] load that is cancelled
    N: Number  # [N m]


_PLAN = len(PlannedReference._fields)  # how many entries are the planner's
_AT: Any = AdaptiveMemory._make(range(len(AdaptiveMemory._fields)))  # where each entry stands
AT_PREDICTED = slice(_AT.u, _AT.sigma_u)  # the predicted velocities
AT_SIGMA = slice(_AT.sigma_u, _AT.u_last)  # sigma of the three axes
AT_LAST = slice(_AT.u_last, _AT.V_x)  # the velocities measured last


def adaptive(
    o: Observation, before: AdaptiveMemory, g: AdaptiveGains, vehicle: Coefficients, ns: Namespace
) -> tuple[AdaptiveMemory, tuple[Number, Number]]:
    """Return what is remembered, and F_u [N], F_r [N m]; see `traced.LawEquation`."""
    c, held_out = vehicle, before.count <= 0.0
    measured = o.u_R + o.u_e, o.v_R + o.v_e, o.r_R + o.r_e
    predicted, sigma = _adapted(o, before, measured, g.predictor, c, ns)
    V_u, V_v = current_of(sigma, measured[2], c)
    V_x, V_y = to_world(V_u, V_v, o.cos_psi, o.sin_psi)
    share = ns.where(held_out, 0.0, 1 - ns.exp(-g.drift * o.dt))
    V_x = ns.clip(before.V_x + share * (V_x - before.V_x), -V, V)
    V_y = ns.clip(before.V_y + share * (V_y - before.V_y), -V, V)
    V_u, V_v = to_body(V_x, V_y, o.cos_psi, o.sin_psi)
    u, v, r = measured[0] - V_u, measured[1] - V_v, measured[2]
    known = (c.d11 * V_u - (c.m22 - c.m11) * r * V_v) / c.m11, yaw_of_current(measured, (u, v), c)
    share = ns.where(held_out, 0.0, 1 - ns.exp(-g.bandwidth * o.dt))
    X = before.X + share * (c.m11 * (sigma[0] - known[0]) - before.X)
    N = before.N + share * (c.m33 * (sigma[2] - known[1]) - before.N)
    plan, R = planned(PlannedReference(*before[:_PLAN]), reference_motion(o, c, ns), Sea(V_x, V_y), o.dt, c, ns)
    psi = ns.arctan2(o.sin_psi, o.cos_psi)
    errors = water_errors((o.e_x, o.e_y, psi, u, v, r), R, ns)
    law = undamped_symbols((g.k, g.cu, g.c, g.cr, g.reference_speed))
    F_u, F_r = tracking_forces(errors, cast(Vehicle, c), law, ns)
    return AdaptiveMemory._make((*plan, *predicted, *sigma, *measured, V_x, V_y, X, N)), (F_u - X, F_r - N)


def _adapted(
    o: Observation,
    before: AdaptiveMemory,
    measured: tuple[Number, Number, Number],
    p: Number,
    vehicle: Coefficients,
    ns: Namespace,
) -> tuple[tuple[Number, ...], tuple[Number, ...]]:
    """Return predicted velocities and sigma, each of surge, sway and yaw.

    Args:
        o: the observation in SI units.
        before: what is remembered.
        measured: velocities over ground.
        p: [1/s] poles of the predictor.
        vehicle: as it is known.
        ns: the namespace of the numbers.
    """
    held_out, pole = before.count <= 0.0, ns.exp(-p * o.dt)
    follow, adapt = 1 - pole * pole, (1 - pole) * (1 - pole)
    last, found = before[AT_LAST], before[AT_SIGMA]
    moved = foreseen_velocities(o, last, found, vehicle, ns)  # from what was measured then
    predicted, sigma = [], []
    axes = zip(measured, before[AT_PREDICTED], last, moved, found, effective_periods(o.dt, vehicle, ns), strict=True)
    for nu, old, then, now, value, period in axes:
        error = ns.where(held_out, 0.0, ns.clip(now + (1 - follow) * (old - then), -V, V) - nu)
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
    """Return sigma of yaw [rad/s^2] that a current makes, from velocities over ground and relative to the water."""
    c = vehicle
    return (c.m22 - c.m11) * (measured[0] * measured[1] - relative[0] * relative[1]) / c.m33


class Adaptive(TracedController):
    """The controller; its gains are the fields of `AdaptiveGains`."""

    law = TracedLaw(adaptive, AdaptiveGains, AdaptiveMemory)
