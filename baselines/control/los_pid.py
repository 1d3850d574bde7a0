"""Line-of-sight guidance with PID autopilots: what most boats run, with the planner's feed-forward added.

Guidance steers for a point ahead on the path and leans against the measured drift (T. I. Fossen, Handbook of Marine
Craft Hydrodynamics and Motion Control, 2nd ed., 2021, sections 12.3-12.4; the integral: A. M. Lekkas and T. I. Fossen,
"Integral LOS path following for curved paths based on a monotone cubic Hermite spline parametrization", IEEE Trans.
Control Systems Technology 22(6):2287-2301, 2014). The heading autopilot is a PID, and so is the one along the track.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from auv_gym.physics.errors import to_world
from auv_gym.physics.namespaces import ARRAYS, Array, wrap_angle
from auv_gym.physics.vehicle import Vehicle
from auv_gym.task.observation import Observation
from baselines.control.backstepping import bounded_error
from baselines.control.integral import integrated, seen_from_body
from baselines.policy import Memory, first_order, reference_speed

LARGEST_INTEGRAL = 0.5
"""Bound [rad s] of the heading autopilot's integral."""


class PIDGains(NamedTuple):
    """Gains of guidance and autopilots."""

    lookahead: float  # [s] distance to the point steered for, as a travel time of the reference
    rate: float  # [1/s] of the position error's integral, see `integral.integrated`
    horizon: float  # [s] bound of error and integral as a travel time of the reference
    crab: float  # [1] share of the measured drift angle that the heading leans against
    crab_time: float  # [s] low-pass of that angle
    heading: float  # [1/s^2] heading, proportional
    turn: float  # [1/s] heading, derivative
    heading_integral: float  # [1/s^3]
    munk: float  # [1] share of the destabilising moment of sway that is cancelled
    along: float  # [1/s^2] along-track, proportional
    speed: float  # [1/s] along-track, derivative


class LineOfSightPID:
    """The controller, a `Controller`.

    Its memory is the position error's integral xi (N, 2) [m], the filtered drift angle (N,) [rad] and the heading
    error's integral (N,) [rad s].
    """

    def __init__(self, gains: Mapping[str, float], vehicle: Vehicle) -> None:
        """Make the controller; its gains are the fields of `PIDGains`."""
        self.gains = PIDGains(**gains)
        self.vehicle = vehicle

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return np.zeros((n, 2)), np.zeros(n), np.zeros(n)

    def forces(self, o: Observation, memory: Memory, extra: Array) -> tuple[Array, Array, Memory]:
        """Return F_u [N], F_r [N m], shape (N,), and the memory to hand in next."""
        g, vehicle = self.gains, self.vehicle
        m11, m22, m33 = vehicle.m11, vehicle.m22, vehicle.m33
        u, v, r = o.u_R + o.u_e, o.v_R + o.v_e, o.r_R + o.r_e
        past_xi, past_crab, past_total = memory
        U = reference_speed(o.u_R, o.v_R, ARRAYS)
        gamma = np.arctan2(o.v_R, o.u_R)
        xi = integrated(past_xi.T, o, g.rate, g.horizon)
        e_x, e_y, *_ = bounded_error(o, g.horizon, ARRAYS)
        eta_x, eta_y = seen_from_body(xi, o)
        angle = o.psi_e - gamma  # from the path's course to the heading
        c, s = np.cos(angle), np.sin(angle)
        along, across = to_world(e_x + eta_x, e_y + eta_y, c, s)  # in the path's frame
        speed, drift = to_world(u, v, c, s)
        drift_angle = wrap_angle(np.arctan2(v, np.maximum(u, 0.5 * U)) - gamma, ARRAYS)
        crab = past_crab + first_order(o.dt, g.crab_time) * (drift_angle - past_crab)
        ahead = g.lookahead * U
        lean = -np.arctan2(across, ahead) - g.crab * crab  # [rad] wanted of psi_e
        lean_rate = -drift * ahead / (ahead * ahead + across * across)
        psi_error = wrap_angle(o.psi_e - lean, ARRAYS)
        free = np.abs(o.a_r) < 1.0  # no windup while the torque is at its limit
        total = np.clip(past_total + o.dt * free * psi_error, -LARGEST_INTEGRAL, LARGEST_INTEGRAL)
        r_dot = -g.heading * psi_error - g.turn * (o.r_e - lean_rate) - g.heading_integral * total
        u_dot = -g.along * along - g.speed * (speed - U)
        F_u = o.F_uR - m22 * (v * r - o.v_R * o.r_R) + m11 * u_dot
        F_r = o.F_rR + g.munk * (m22 - m11) * (u * v - o.u_R * o.v_R) + m33 * r_dot
        return F_u, F_r, (xi.T, crab, total)
