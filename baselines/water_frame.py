"""The reference as seen from the water: what keeps the vehicle on its path in a current, re-planned at every step.

In a current c that is constant in the world the vehicle moves relative to the water as it would in still water. Its path
there has the derivatives p_R' - c, p_R'', p_R''', and the planner's equations give heading, velocities and forces for it.

A constant sway force Y on the hull shifts the sway velocity in (2b) by Y/d22, as a current of that velocity along the
sway axis would: it is planned for as one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.dynamics import rates
from auv_gym.errors import to_world
from auv_gym.planner import PathRates, assemble, path_rates, sideslip_rest, sideslip_terms, slow_sideslip
from auv_gym.task import Observation
from auv_gym.vehicle import Vehicle
from baselines.memory import Array, Memory

LARGEST_CURRENT = 0.85
"""Largest current that is planned for, as a share of the reference's speed: forward motion needs one below 1."""
HARDEST_BRAKING = 0.95
"""Largest braking -v_p'/v_p through the water, as a share of d22/m22, beyond which the sideslip grows without bound."""
LARGEST_SIDESLIP = 1.2
"""Largest sideslip [rad]."""


class Motion(NamedTuple):
    """How the reference moves over ground, in the world: rows of shape (N,)."""

    psi: Array  # [rad]
    v_x: Array  # [m/s]
    v_y: Array  # [m/s]
    a_x: Array  # [m/s^2]
    a_y: Array  # [m/s^2]


class WaterReference(NamedTuple):
    """The reference relative to the water, the fields of an `Observation`: rows of shape (N,)."""

    psi: Array  # [rad]
    u_R: Array  # [m/s]
    v_R: Array  # [m/s]
    r_R: Array  # [rad/s]
    F_uR: Array  # [N] (16a)
    F_rR: Array  # [N m] (16b)


def reference_motion(o: Observation, vehicle: Vehicle) -> Motion:
    """Return how the reference moves at this instant; `vehicle` is the one that it was planned for.

    The measured heading less the heading error is the reference's heading, free of noise but for a low-pass. The
    accelerations are those of (2) under the reference's forces.
    """
    psi = np.arctan2(o.sin_psi, o.cos_psi) - o.psi_e
    v_x, v_y, u_dot, v_dot, _ = rates(psi, o.u_R, o.v_R, o.r_R, (o.F_uR, 0.0, o.F_rR), vehicle.coefficients, np)
    a_x, a_y = to_world(u_dot - o.v_R * o.r_R, v_dot + o.u_R * o.r_R, np.cos(psi), np.sin(psi))
    return Motion(psi, v_x, v_y, a_x, a_y)


@dataclass(frozen=True)
class WaterPlan:
    """The planner of section III in the water frame, one control period at a time.

    Its memory: the number of periods so far, (N,); the two last accelerations of the reference, (N, 2, 2); the sine of
    the sideslip and the rest of its equation, see `planner.sideslip_rest`, (N, 2).
    """

    vehicle: Vehicle

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return np.zeros(n), np.zeros((n, 2, 2)), np.zeros((n, 2))

    def update(
        self, memory: Memory, motion: Motion, current: tuple[Array, Array], dt: Array
    ) -> tuple[Memory, WaterReference]:
        """Return the memory one period later and the reference at this instant.

        Args:
            memory: as `start` or the last call returned it.
            motion: of the reference over ground.
            current: V_x, V_y [m/s] of the water in the world, as it is believed to be now and to remain.
            dt: control period [s], shape (N,).
        """
        count, past, sideslip = memory
        fresh = count == 0
        acceleration = np.stack((motion.a_x, motion.a_y), axis=1)
        past = np.where(fresh[:, None, None], acceleration[:, None], past)
        along = self._along(motion, _jerk(acceleration, past, dt), current)
        w, rest = self._step(along, sideslip, fresh, dt)
        plan = assemble(np.zeros(1), np.zeros((2, 1, 1)), along, w[None], self.vehicle)
        reference = WaterReference(*(row[0] for row in (plan.psi, plan.u, plan.v, plan.r, plan.F_u, plan.F_r)))
        past = np.stack((acceleration, past[:, 0]), axis=1)
        return (count + 1, past, np.stack((w, rest), axis=1)), reference

    def _along(self, motion: Motion, jerk: Array, current: tuple[Array, Array]) -> PathRates:
        """Return speed, direction and their rates through the water, shape (1, N): a time axis of one instant."""
        speed, strength = np.hypot(motion.v_x, motion.v_y), np.hypot(*current)
        share = np.minimum(1.0, LARGEST_CURRENT * speed / np.maximum(strength, 1e-9))
        velocity = motion.v_x - share * current[0], motion.v_y - share * current[1]
        zero = np.zeros_like(speed)
        along = path_rates(np.array(((zero, zero), velocity, (motion.a_x, motion.a_y), (jerk[:, 0], jerk[:, 1])))[:, :, None])
        hardest = -HARDEST_BRAKING * self.vehicle.d22 / self.vehicle.m22 * along.v_p
        return replace(along, v_p_dot=np.maximum(along.v_p_dot, hardest))

    def _step(self, along: PathRates, sideslip: Array, fresh: NDArray[np.bool_], dt: Array) -> tuple[Array, Array]:
        """Return w = sin(gamma), one period later, and the rest of its equation.

        By the exponential Runge-Kutta formula of second order (Cox and Matthews 2002, eq. 22): the stiff term exactly.
        """
        Dm = self.vehicle.m22 - self.vehicle.m11
        terms = [dt / Dm * term[0] for term in sideslip_terms(along, self.vehicle)]
        limit = math.sin(LARGEST_SIDESLIP)
        z = self.vehicle.d22 / Dm * dt
        decay = np.exp(-z)
        first, second = (1 - decay) / z, (z - 1 + decay) / (z * z)
        guess = decay * sideslip[:, 0] + first * sideslip[:, 1]
        w = guess + second * (sideslip_rest(*terms, np.clip(guess, -limit, limit), np.sqrt) - sideslip[:, 1])
        if fresh.any():
            w = np.where(fresh, slow_sideslip(along, self.vehicle), w)
        w = np.clip(w, -limit, limit)
        return w, sideslip_rest(*terms, w, np.sqrt)


def _jerk(acceleration: Array, past: Array, dt: Array) -> Array:
    """Return the rate of the acceleration, shape (N, 2), by the backward difference of second order."""
    return (1.5 * acceleration - 2 * past[:, 0] + 0.5 * past[:, 1]) / dt[:, None]
