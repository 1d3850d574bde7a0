"""Line-of-sight guidance with PID autopilots, as on most marine craft, and the planner's feed-forward.

Guidance steers to a look-ahead point on the path and compensates the measured drift angle (T. I. Fossen, Handbook of
Marine Craft Hydrodynamics and Motion Control, 2nd ed., 2021, sections 12.3-12.4; the integral: A. M. Lekkas and T. I.
Fossen, "Integral LOS path following for curved paths based on a monotone cubic Hermite spline parametrization", IEEE
Trans. Control Systems Technology 22(6):2287-2301, 2014). Heading and along-track position have PID controllers.
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
from baselines.control.integral import in_body_frame, next_integral
from baselines.policy import Memory, first_order, reference_speed

LARGEST_INTEGRAL = 0.5
"""Bound [rad s] of the heading autopilot's integral."""


class PIDGains(NamedTuple):
    """Gains of guidance and autopilots."""

    lookahead: float  # [s] look-ahead distance as a travel time of the reference
    rate: float  # [1/s] of the position error's integral, see `integral.next_integral`
    horizon: float  # [s] bound of error and integral as a travel time of the reference
    crab: float  # [1] share of the measured drift angle that the heading compensates
    crab_time: float  # [s] time constant of the low-pass filter of that angle
    heading: float  # [1/s^2] heading, proportional
    turn: float  # [1/s] heading, derivative
    heading_integral: float  # [1/s^3]
    munk: float  # [1] share of the Munk moment that is cancelled
    along: float  # [1/s^2] along-track, proportional
    speed: float  # [1/s] along-track, derivative


class LineOfSightPID:
    """Line-of-sight guidance with PID autopilots, a `Controller`.

    Its memory is the integral xi (N, 2) [m] of the position error, the filtered drift angle (N,) [rad] and the integral
    of the heading error (N,) [rad s].
    """

    def __init__(self, gains: Mapping[str, float], vehicle: Vehicle) -> None:
        """Make the controller; its gains are the fields of `PIDGains`."""
        self.gains = PIDGains(**gains)
        self.vehicle = vehicle

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return np.zeros((n, 2)), np.zeros(n), np.zeros(n)

    def forces(self, o: Observation, memory: Memory, extra: Array) -> tuple[Array, Array, Memory]:
        """Return F_u [N], F_r [N m], shape (N,), and the memory for the next call."""
        g, vehicle = self.gains, self.vehicle
        m11, m22, m33 = vehicle.m11, vehicle.m22, vehicle.m33
        u, v, r = o.u_R + o.u_e, o.v_R + o.v_e, o.r_R + o.r_e
        past_xi, past_crab, past_total = memory
        U = reference_speed(o.u_R, o.v_R, ARRAYS)
        gamma = np.arctan2(o.v_R, o.u_R)
        xi = next_integral(past_xi.T, o, g.rate, g.horizon)
        e_x, e_y, *_ = bounded_error(o, g.horizon, ARRAYS)
        eta_x, eta_y = in_body_frame(xi, o)
        angle = o.psi_e - gamma  # heading minus course of the path
        c, s = np.cos(angle), np.sin(angle)
        along, across = to_world(e_x + eta_x, e_y + eta_y, c, s)  # in the path's frame
        speed, drift = to_world(u, v, c, s)
        drift_angle = wrap_angle(np.arctan2(v, np.maximum(u, 0.5 * U)) - gamma, ARRAYS)
        crab = past_crab + first_order(o.dt, g.crab_time) * (drift_angle - past_crab)
        ahead = g.lookahead * U
        desired = -np.arctan2(across, ahead) - g.crab * crab  # [rad] of psi_e
        desired_rate = -drift * ahead / (ahead * ahead + across * across)
        psi_error = wrap_angle(o.psi_e - desired, ARRAYS)
        free = np.abs(o.a_r) < 1.0  # anti-windup: the integral is constant while the torque is at its limit
        total = np.clip(past_total + o.dt * free * psi_error, -LARGEST_INTEGRAL, LARGEST_INTEGRAL)
        r_dot = -g.heading * psi_error - g.turn * (o.r_e - desired_rate) - g.heading_integral * total
        u_dot = -g.along * along - g.speed * (speed - U)
        F_u = o.F_uR - m22 * (v * r - o.v_R * o.r_R) + m11 * u_dot
        F_r = o.F_rR + g.munk * (m22 - m11) * (u * v - o.u_R * o.v_R) + m33 * r_dot
        return F_u, F_r, (xi.T, crab, total)
