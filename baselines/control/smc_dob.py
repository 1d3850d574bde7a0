"""Sliding-mode control with a disturbance observer and boundary layers.

T. Elmokadem, M. Zribi and K. Youcef-Toumi, "Terminal sliding mode control for the trajectory tracking of underactuated
autonomous underwater vehicles", Ocean Engineering 129:613-625, 2017; W.-H. Chen, D. J. Ballance, P. J. Gawthrop and
J. O'Reilly, "A nonlinear disturbance observer for robotic manipulators", IEEE Trans. Industrial Electronics
47(4):932-938, 2000; boundary layers: J.-J. E. Slotine and W. Li, Applied Nonlinear Control, 1991, section 7.2.

With the model m nu' = h(nu) + F + D over ground, the observer of the load D is, l being its bandwidth,

    D^ = z + l m nu,    z' = -l (h(nu) + F + D^),

so that D^' = l (D - D^). Inside the boundary layer the sliding variables s_u = along' + lambda along and
s_r = psi~' + lambda_r psi~ have the reaching law s' = -K s/layer, outside of it s' = -K sign(s). Sway has no actuator.
The steady drift angle is computed from the sway load; the desired heading compensates this angle and points to a
look-ahead point on the path.
"""

from __future__ import annotations

from typing import NamedTuple

from auv_gym.physics.errors import to_world
from auv_gym.physics.namespaces import Namespace, Number, wrap_angle
from auv_gym.physics.vehicle import Coefficients
from auv_gym.task.observation import Observation
from baselines.control.traced import TracedController, TracedLaw, effective_periods, predicted_velocities
from baselines.policy import reference_speed

LARGEST_LOAD = 10.0
"""Bound of the estimated loads over the inertia [m/s^2], [rad/s^2]."""
_SLOWEST = 0.5  # least surge velocity over the reference's speed in the computation of a drift angle


class SmcGains(NamedTuple):
    """Gains of guidance, sliding modes and observers."""

    lookahead: Number  # [s] look-ahead distance as a travel time of the reference
    along: Number  # [1/s] lambda of the error along the path
    surge_reach: Number  # [m/s^2] K of surge
    surge_layer: Number  # [m/s] boundary layer of surge
    heading: Number  # [1/s] lambda of the heading error
    yaw_reach: Number  # [rad/s^2] K of yaw
    yaw_layer: Number  # [rad/s] boundary layer of yaw
    observer: Number  # [1/s] bandwidth of the observer in surge and yaw
    drift: Number  # [1/s] bandwidth of the observer in sway
    horizon: Number  # [s] bound of the error along the path as a travel time of the reference


class SmcMemory(NamedTuple):
    """Memory of the controller."""

    started: Number  # 0 at the start of an episode, else 1
    u: Number  # [m/s] last measured velocities over ground
    v: Number  # [m/s]
    r: Number  # [rad/s]
    X: Number  # [m/s^2] estimated loads over the inertia
    Y: Number  # [m/s^2]
    N: Number  # [rad/s^2]


def smc_dob(
    o: Observation, before: SmcMemory, g: SmcGains, vehicle: Coefficients, ns: Namespace
) -> tuple[SmcMemory, tuple[Number, Number]]:
    """Return the memory, and F_u [N], F_r [N m]; see `traced.LawEquation`."""
    c = vehicle
    u, v, r = nu = (o.u_R + o.u_e, o.v_R + o.v_e, o.r_R + o.r_e)
    X, Y, N = estimated_loads(o, before, nu, (g.observer, g.drift, g.observer), c, ns)
    U = reference_speed(o.u_R, o.v_R, ns)
    course = ns.arctan2(o.v_R, o.u_R)
    angle = o.psi_e - course  # heading minus course of the path
    cos, sin = ns.cos(angle), ns.sin(angle)
    along, across = to_world(o.e_x, o.e_y, cos, sin)  # in the path's frame
    forward, sideways = to_world(u, v, cos, sin)
    along = along / ns.sqrt(1 + (along / (g.horizon * U)) ** 2)
    surge = ns.clip(u, _SLOWEST * U, 10.0 * U)
    steady_sway = (c.m22 * Y - c.m11 * surge * o.r_R) / (c.d22 + c.Y_vv * abs(v))  # [m/s]
    crab = ns.arctan2(steady_sway, surge) - course
    ahead = g.lookahead * U
    desired = -ns.arctan2(across, ahead) - crab  # heading error
    desired_rate = -sideways * ahead / (ahead * ahead + across * across)
    s_u = forward - U + g.along * along
    s_r = o.r_e - desired_rate + g.heading * wrap_angle(o.psi_e - desired, ns)
    u_dot = -g.along * (forward - U) - g.surge_reach * ns.clip(s_u / g.surge_layer, -1.0, 1.0)
    r_dot = -g.heading * (o.r_e - desired_rate) - g.yaw_reach * ns.clip(s_r / g.yaw_layer, -1.0, 1.0)
    F_u = o.F_uR + c.d11 * o.u_e - c.m22 * (v * r - o.v_R * o.r_R) + c.m11 * (u_dot - X)
    F_r = o.F_rR + c.d33 * o.r_e + (c.m22 - c.m11) * (u * v - o.u_R * o.v_R) + c.m33 * (r_dot - N)
    return SmcMemory(ns.where(before.started > 0.0, before.started, 1.0), *nu, X, Y, N), (F_u, F_r)


def estimated_loads(
    o: Observation,
    before: SmcMemory,
    nu: tuple[Number, Number, Number],
    bandwidths: tuple[Number, Number, Number],
    vehicle: Coefficients,
    ns: Namespace,
) -> tuple[Number, ...]:
    """Return the estimated loads in surge, sway and yaw over the inertia, D^/m, one control period later.

    This is the observer in discrete time: the estimates change by 1 - exp(-l dt) times the error of the load in the
    last period, which follows from the prediction error of the velocity.

    Args:
        o: the observation in SI units.
        before: memory of the controller.
        nu: velocities over ground.
        bandwidths: l of surge, sway and yaw [1/s].
        vehicle: the nominal one.
        ns: the namespace of the numbers.
    """
    last, past = (before.u, before.v, before.r), (before.X, before.Y, before.N)
    predicted = predicted_velocities(o, last, past, vehicle, ns)
    loads = []
    axes = zip(past, nu, predicted, bandwidths, effective_periods(o.dt, vehicle, ns), strict=True)
    for load, now, model, bandwidth, period in axes:
        gain = ns.where(before.started > 0.0, 1 - ns.exp(-bandwidth * o.dt), 0.0)
        loads.append(ns.clip(load + gain * (now - model) / period, -LARGEST_LOAD, LARGEST_LOAD))
    return tuple(loads)


class SmcDob(TracedController):
    """The controller; its gains are the fields of `SmcGains`."""

    law = TracedLaw(smc_dob, SmcGains, SmcMemory)
