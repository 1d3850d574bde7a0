"""Line-of-sight guidance with PID autopilots in space: that of the plane in both planes, with its gains.

See `baselines.control.los_pid`. The vertical plane has the heave velocity and -q where the horizontal plane has the
sway velocity and r, and its autopilot cancels the change of the restoring moment.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from auv_gym.physics.errors import to_world
from auv_gym.physics.namespaces import ARRAYS, Array, wrap_angle
from auv_gym.physics.space import SpaceVehicle
from auv_gym.task.observation import Layout
from auv_gym.task.space import SPACE, Observation, in_body_frame
from baselines.control.los_pid import LARGEST_INTEGRAL, PIDGains
from baselines.policy import Memory, first_order
from baselines.space.integral import bounded, next_integral, speed


class SpaceLineOfSight:
    """Line-of-sight guidance with PID autopilots, a `Controller`.

    Its memory is the integral xi (N, 3) [m] of the position error, the filtered drift angles (N, 2) [rad] and the
    integrals of the errors of yaw and pitch (N, 2) [rad s].
    """

    layout: ClassVar[Layout] = SPACE.layout

    def __init__(self, gains: Mapping[str, float], vehicle: SpaceVehicle) -> None:
        """Make the controller; its gains are the fields of `PIDGains`."""
        self.gains, self.vehicle = PIDGains(**gains), vehicle

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return np.zeros((n, 3)), np.zeros((n, 2)), np.zeros((n, 2))

    def forces(self, o: Observation, memory: Memory, extra: Array) -> tuple[Array, Array, Array, Memory]:
        """Return F_u [N], F_q [N m], F_r [N m], shape (N,), and the memory for the next call."""
        g, level, upright = self.gains, self.vehicle.horizontal, self.vehicle.vertical
        xi, U = next_integral(memory[0].T, o, g.rate, g.horizon), speed(o)
        u, s, s_R = o.u_R + o.u_e, -o.q_R - o.q_e, -o.q_R
        # side velocity, turn rate, angle of the axis, and what the reference has of them, in each plane
        planes = (
            (o.v_R + o.v_e, o.r_R + o.r_e, o.psi_e, o.v_R, o.r_R, np.abs(o.a_r) < 1.0),
            (o.w_R + o.w_e, s, -o.theta_e, o.w_R, s_R, np.abs(o.a_q) < 1.0),
        )
        gammas = [np.arctan2(side_R, o.u_R) for _, _, _, side_R, _, _ in planes]
        angles = [plane[2] - gamma for plane, gamma in zip(planes, gammas, strict=True)]  # heading minus course
        along, across = _in_path_frame(bounded(o, g.horizon) + np.array(in_body_frame(xi, o)), angles)
        advance, drifts = _in_path_frame(np.array((u, planes[0][0], planes[1][0])), angles)
        crabs, totals, turns = [], [], []
        for k, ((side, turn, angle, _, turn_R, free), gamma) in enumerate(zip(planes, gammas, strict=True)):
            drift_angle = wrap_angle(np.arctan2(side, np.maximum(u, 0.5 * U)) - gamma, ARRAYS)
            crab = memory[1][:, k] + first_order(o.dt, g.crab_time) * (drift_angle - memory[1][:, k])
            ahead = g.lookahead * U
            desired = -np.arctan2(across[k], ahead) - g.crab * crab
            desired_rate = -drifts[k] * ahead / (ahead * ahead + across[k] * across[k])
            error = wrap_angle(angle - desired, ARRAYS)
            total = np.clip(memory[2][:, k] + o.dt * free * error, -LARGEST_INTEGRAL, LARGEST_INTEGRAL)
            turns.append(-g.heading * error - g.turn * (turn - turn_R - desired_rate) - g.heading_integral * total)
            crabs.append(crab)
            totals.append(total)
        u_dot = -g.along * along - g.speed * (advance - U)
        (v, r, _, v_R, r_R, _), (w, _, _, w_R, _, _) = planes
        F_u = o.F_uR - level.m22 * (v * r - v_R * r_R) - upright.m22 * (w * s - w_R * s_R) + level.m11 * u_dot
        F_r = o.F_rR + g.munk * (level.m22 - level.m11) * (u * v - o.u_R * v_R) + level.m33 * turns[0]
        weight = self.vehicle.stiffness * (o.sin_theta - np.sin(o.theta_R))
        F_s = g.munk * (upright.m22 - upright.m11) * (u * w - o.u_R * w_R) + upright.m33 * turns[1] - weight
        return F_u, o.F_qR - F_s, F_r, (xi.T, np.stack(crabs, axis=1), np.stack(totals, axis=1))


def _in_path_frame(vector: Array, angles: list[Array]) -> tuple[Array, list[Array]]:
    """Return a body vector (3, N) along the path, and across it in both planes, for the angles of axis to course."""
    x, y, z = vector
    yaw, pitch = angles
    x, z = to_world(x, z, np.cos(pitch), np.sin(pitch))
    x, y = to_world(x, y, np.cos(yaw), np.sin(yaw))
    return x, [y, z]
