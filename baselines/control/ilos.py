"""Integral line-of-sight guidance with an observer of the sway, brought from a path to a trajectory.

E. Borhaug, A. Pavlov and K. Y. Pettersen, "Integral LOS control for path following of underactuated marine surface
vessels in the presence of constant ocean currents", IEEE CDC 2008, pp. 4984-4991; W. Caharija et al., "Integral
line-of-sight guidance and control of underactuated marine vehicles: theory, simulations, and experiments", IEEE Trans.
Control Systems Technology 24(5):1623-1642, 2016. With the cross-track error y they steer

    psi_d = -atan((y + sigma I) / Delta),    I' = Delta y / ((y + sigma I)^2 + Delta^2),

so that the integral grows slowly where the error is large. Here the vehicle has to be on time as well: the integral is
that of both components of the error, and is kept in the world, where a constant current is constant on a curved path
too; the heading is leant from the planned one; and the part along the path goes to the surge.

Sway is not actuated, but its dynamics relative to the water are stable: the copy v^' = -(m11 u r + d22 v^)/m22 needs no
correction. What the measured sway exceeds it by is the current across the hull, which is filtered in the world; surge
and yaw are linearised with velocities relative to the water.
"""

from __future__ import annotations

from typing import NamedTuple

from auv_gym.physics.errors import to_body, to_world
from auv_gym.physics.namespaces import Namespace, Number, wrap_angle
from auv_gym.physics.vehicle import Coefficients
from auv_gym.task.observation import Observation, V
from baselines.control.traced import TracedController, TracedLaw
from baselines.policy import reference_speed

LARGEST_SHARE = 0.8
"""Most of the look-ahead distance that the integral may stand for: it asks for 39 degrees then."""


class IlosGains(NamedTuple):
    """Gains of guidance, observer and autopilots."""

    lookahead: Number  # [s] Delta as a travel time of the reference
    sigma: Number  # [1] weight of the integral over the reference's speed
    heading: Number  # [1/s^2] of the heading error
    turn: Number  # [1/s] of the yaw rate's
    along: Number  # [1/s^2] of the error along the path
    speed: Number  # [1/s] of its rate
    along_integral: Number  # [1/s^2] of its integral, times sigma
    horizon: Number  # [s] bound of the error along the path as a travel time of the reference
    drift: Number  # [1/s] with which the current is found


class IlosMemory(NamedTuple):
    """What is remembered."""

    begun: Number  # 1 once there was an observation, 0 before
    I_x: Number  # [s] the integral in the world
    I_y: Number
    v: Number  # [m/s] sway relative to the water
    u: Number  # [m/s] measured last, relative to the water
    r: Number  # [rad/s] measured last
    V_x: Number  # [m/s] current in the world
    V_y: Number


def ilos(
    o: Observation, before: IlosMemory, g: IlosGains, vehicle: Coefficients, ns: Namespace
) -> tuple[IlosMemory, tuple[Number, Number]]:
    """Return what is remembered, and F_u [N], F_r [N m]; see `traced.LawEquation`."""
    c = vehicle
    m11, m22 = c.m11, c.m22
    U = reference_speed(o.u_R, o.v_R, ns)
    u_g, v_g, r = o.u_R + o.u_e, o.v_R + o.v_e, o.r_R + o.r_e
    v, V_x, V_y = observed_sway(o, before, v_g, g.drift, c, ns)
    V_u, _ = to_body(V_x, V_y, o.cos_psi, o.sin_psi)
    u = u_g - V_u
    angle = o.psi_e - ns.arctan2(o.v_R, o.u_R)  # from the path's course to the heading
    cos, sin = ns.cos(angle), ns.sin(angle)
    along, across = to_world(o.e_x, o.e_y, cos, sin)  # in the path's frame
    forward, sideways = to_world(u_g, v_g, cos, sin)
    cos_path = o.cos_psi * cos + o.sin_psi * sin  # of the path's course in the world
    sin_path = o.sin_psi * cos - o.cos_psi * sin
    I_s, I_n = to_body(before.I_x, before.I_y, cos_path, sin_path)
    ahead, sigma = g.lookahead * U, g.sigma * U
    wanted = across + sigma * I_n
    square = wanted * wanted + ahead * ahead
    along = along / ns.sqrt(1 + (along / (g.horizon * U)) ** 2)
    lean = -ns.arctan2(wanted, ahead)
    lean_rate = -ahead * (sideways + sigma * ahead * across / square) / square
    psi_error, turn_error = wrap_angle(o.psi_e - lean, ns), o.r_e - lean_rate
    u_dot = -g.along * along - g.speed * (forward - U) - g.along_integral * sigma * I_s
    r_dot = -g.heading * psi_error - g.turn * turn_error
    F_u = o.F_uR + c.d11 * (u - o.u_R) - m22 * (v * r - o.v_R * o.r_R) + m11 * u_dot
    F_r = o.F_rR + c.d33 * o.r_e + (m22 - m11) * (u * v - o.u_R * o.v_R) + c.m33 * r_dot
    free = ns.where((abs(o.a_u) < 1.0) & (abs(o.a_r) < 1.0), o.dt, 0.0)  # no windup while an actuator is at its limit
    bound = LARGEST_SHARE * ahead / sigma
    I_s = ns.clip(I_s + free * ahead * along / square, -bound, bound)
    I_n = ns.clip(I_n + free * ahead * across / square, -bound, bound)
    I_x, I_y = to_world(I_s, I_n, cos_path, sin_path)
    begun = ns.where(before.begun > 0.0, before.begun, 1.0)
    return IlosMemory(begun, I_x, I_y, v, u, r, V_x, V_y), (F_u, F_r)


def observed_sway(
    o: Observation, before: IlosMemory, v_g: Number, drift: Number, vehicle: Coefficients, ns: Namespace
) -> tuple[Number, Number, Number]:
    """Return the sway relative to the water [m/s] and the current V_x, V_y [m/s], one period later.

    Args:
        o: the observation in SI units.
        before: what is remembered; at first the sway is taken to be the reference's.
        v_g: measured sway over ground [m/s].
        drift: see `IlosGains`.
        vehicle: as it is known.
        ns: the namespace of the numbers.
    """
    c = vehicle
    rate = (c.d22 + c.Y_vv * abs(before.v)) / c.m22
    left = ns.exp(-rate * o.dt)
    v = left * before.v - (1 - left) * c.m11 * before.u * before.r / (c.m22 * rate)
    v = ns.clip(ns.where(before.begun > 0.0, v, o.v_R), -V, V)
    _, V_v = to_body(before.V_x, before.V_y, o.cos_psi, o.sin_psi)
    missing = (1 - ns.exp(-drift * o.dt)) * (v_g - v - V_v)
    x, y = to_world(0.0, missing, o.cos_psi, o.sin_psi)
    return v, ns.clip(before.V_x + x, -V, V), ns.clip(before.V_y + y, -V, V)


class Ilos(TracedController):
    """The controller; its gains are the fields of `IlosGains`."""

    law = TracedLaw(ilos, IlosGains, IlosMemory)
