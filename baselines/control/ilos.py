"""Integral line-of-sight guidance with a sway observer, extended from path following to trajectory tracking.

E. Borhaug, A. Pavlov and K. Y. Pettersen, "Integral LOS control for path following of underactuated marine surface
vessels in the presence of constant ocean currents", IEEE CDC 2008, pp. 4984-4991; W. Caharija et al., "Integral
line-of-sight guidance and control of underactuated marine vehicles: theory, simulations, and experiments", IEEE Trans.
Control Systems Technology 24(5):1623-1642, 2016. With the cross-track error y their desired heading is

    psi_d = -atan((y + sigma I) / Delta),    I' = Delta y / ((y + sigma I)^2 + Delta^2).

The integral grows slowly if the error is large. In trajectory tracking the along-track error matters as well. So both
components of the error are integrated, in the world frame: there a constant current is constant on a curved path too.
The heading of guidance is relative to the planned heading, and the along-track part acts on the surge force.

Sway is not actuated, but its dynamics relative to the water are stable: the observer v^' = -(m11 u r + d22 v^)/m22
needs no correction. The measured sway minus v^ is the current across the vehicle, which is low-pass filtered in the
world frame. Surge and yaw are feedback-linearised with velocities relative to the water.
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
"""Bound of sigma I over the look-ahead distance; at the bound the integral turns the desired heading by 39 degrees."""


class IlosGains(NamedTuple):
    """Gains of guidance, observer and autopilots."""

    lookahead: Number  # [s] Delta as a travel time of the reference
    sigma: Number  # [1] weight of the integral over the reference's speed
    heading: Number  # [1/s^2] of the heading error
    turn: Number  # [1/s] of the yaw rate error
    along: Number  # [1/s^2] of the along-track error
    speed: Number  # [1/s] of the rate of the along-track error
    along_integral: Number  # [1/s^2] of the integral of the along-track error, times sigma
    horizon: Number  # [s] bound of the along-track error as a travel time of the reference
    drift: Number  # [1/s] bandwidth of the current's filter


class IlosMemory(NamedTuple):
    """Memory of the controller."""

    started: Number  # 0 at the start of an episode, else 1
    I_x: Number  # [s] the integral in the world
    I_y: Number
    v: Number  # [m/s] estimated sway relative to the water
    u: Number  # [m/s] last surge velocity relative to the water
    r: Number  # [rad/s] last measured yaw rate
    V_x: Number  # [m/s] current in the world
    V_y: Number


def ilos(
    o: Observation, before: IlosMemory, g: IlosGains, vehicle: Coefficients, ns: Namespace
) -> tuple[IlosMemory, tuple[Number, Number]]:
    """Return the memory, and F_u [N], F_r [N m]; see `traced.LawEquation`."""
    c = vehicle
    m11, m22 = c.m11, c.m22
    U = reference_speed(o.u_R, o.v_R, ns)
    u_g, v_g, r = o.u_R + o.u_e, o.v_R + o.v_e, o.r_R + o.r_e
    v, V_x, V_y = sway_observer(o, before, v_g, g.drift, c, ns)
    V_u, _ = to_body(V_x, V_y, o.cos_psi, o.sin_psi)
    u = u_g - V_u
    angle = o.psi_e - ns.arctan2(o.v_R, o.u_R)  # heading minus course of the path
    cos, sin = ns.cos(angle), ns.sin(angle)
    along, across = to_world(o.e_x, o.e_y, cos, sin)  # in the path's frame
    forward, sideways = to_world(u_g, v_g, cos, sin)
    cos_path = o.cos_psi * cos + o.sin_psi * sin  # of the course of the path in the world
    sin_path = o.sin_psi * cos - o.cos_psi * sin
    I_s, I_n = to_body(before.I_x, before.I_y, cos_path, sin_path)
    ahead, sigma = g.lookahead * U, g.sigma * U
    offset = across + sigma * I_n
    square = offset * offset + ahead * ahead
    along = along / ns.sqrt(1 + (along / (g.horizon * U)) ** 2)
    desired = -ns.arctan2(offset, ahead)  # heading error
    desired_rate = -ahead * (sideways + sigma * ahead * across / square) / square
    psi_error, turn_error = wrap_angle(o.psi_e - desired, ns), o.r_e - desired_rate
    u_dot = -g.along * along - g.speed * (forward - U) - g.along_integral * sigma * I_s
    r_dot = -g.heading * psi_error - g.turn * turn_error
    F_u = o.F_uR + c.d11 * (u - o.u_R) - m22 * (v * r - o.v_R * o.r_R) + m11 * u_dot
    F_r = o.F_rR + c.d33 * o.r_e + (m22 - m11) * (u * v - o.u_R * o.v_R) + c.m33 * r_dot
    free = ns.where((abs(o.a_u) < 1.0) & (abs(o.a_r) < 1.0), o.dt, 0.0)  # anti-windup: 0 with an actuator at its limit
    bound = LARGEST_SHARE * ahead / sigma
    I_s = ns.clip(I_s + free * ahead * along / square, -bound, bound)
    I_n = ns.clip(I_n + free * ahead * across / square, -bound, bound)
    I_x, I_y = to_world(I_s, I_n, cos_path, sin_path)
    started = ns.where(before.started > 0.0, before.started, 1.0)
    return IlosMemory(started, I_x, I_y, v, u, r, V_x, V_y), (F_u, F_r)


def sway_observer(
    o: Observation, before: IlosMemory, v_g: Number, drift: Number, vehicle: Coefficients, ns: Namespace
) -> tuple[Number, Number, Number]:
    """Return the sway relative to the water [m/s] and the current V_x, V_y [m/s], one period later.

    Args:
        o: the observation in SI units.
        before: memory of the controller; the first estimate of the sway is that of the reference.
        v_g: measured sway over ground [m/s].
        drift: see `IlosGains`.
        vehicle: the nominal one.
        ns: the namespace of the numbers.
    """
    c = vehicle
    rate = (c.d22 + c.Y_vv * abs(before.v)) / c.m22
    decay = ns.exp(-rate * o.dt)
    v = decay * before.v - (1 - decay) * c.m11 * before.u * before.r / (c.m22 * rate)
    v = ns.clip(ns.where(before.started > 0.0, v, o.v_R), -V, V)
    _, V_v = to_body(before.V_x, before.V_y, o.cos_psi, o.sin_psi)
    correction = (1 - ns.exp(-drift * o.dt)) * (v_g - v - V_v)
    x, y = to_world(0.0, correction, o.cos_psi, o.sin_psi)
    return v, ns.clip(before.V_x + x, -V, V), ns.clip(before.V_y + y, -V, V)


class Ilos(TracedController):
    """The controller; its gains are the fields of `IlosGains`."""

    law = TracedLaw(ilos, IlosGains, IlosMemory)
