"""The reference as seen from the water: what keeps the vehicle on its path in a current, re-planned at every step.

In a current c that is constant in the world the vehicle moves relative to the water as it would in still water. Its
path there has the velocity p_R' - c and the higher derivatives of p_R, and the planner gives heading and forces
for it; where the current changes, its rate is subtracted too. A sway force on the hull enters the equation of the
sideslip and is planned for as well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.dynamics import rates
from auv_gym.errors import to_world
from auv_gym.namespaces import ARRAYS, wrap_angle
from auv_gym.planner import PathRates, assemble, path_rates, sideslip_rest, sideslip_step, sideslip_terms, slow_sideslip
from auv_gym.task import Observation
from auv_gym.vehicle import Vehicle
from baselines.policy import Array, Memory

LARGEST_CURRENT = 0.85
"""Largest current that is planned for, as a share of the reference's speed: forward motion needs one below 1."""
HARDEST_BRAKING = 0.95
"""Largest braking -v_p'/v_p through the water, as a share of d22/m22, beyond which the sideslip grows without bound."""
LARGEST_SINE = math.sin(1.2)
"""Sine of the largest sideslip, 1.2 rad."""


class Motion(NamedTuple):
    """How the reference moves over ground, in the world: rows of shape (N,)."""

    psi: Array  # [rad]
    v_x: Array  # [m/s]
    v_y: Array  # [m/s]
    a_x: Array  # [m/s^2]
    a_y: Array  # [m/s^2]


class Sea(NamedTuple):
    """What acts on the vehicle, as it is believed to be: rows of shape (N,)."""

    V_x: Array  # [m/s] current, in the world
    V_y: Array  # [m/s]
    V_x_rate: Array | float = 0.0  # [m/s^2]
    V_y_rate: Array | float = 0.0
    Y: Array | float = 0.0  # [N] sway force on the hull
    Y_rate: Array | float = 0.0  # [N/s]


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

    def update(self, memory: Memory, motion: Motion, sea: Sea, dt: Array) -> tuple[Memory, WaterReference]:
        """Return the memory one period later and the reference at this instant.

        Args:
            memory: as `start` or the last call returned it.
            motion: of the reference over ground.
            sea: what acts on the vehicle; the current's rate is taken to remain as it is.
            dt: control period [s], shape (N,).
        """
        count, past, sideslip = memory
        fresh = count == 0
        acceleration = np.stack((motion.a_x, motion.a_y), axis=1)
        past = np.where(fresh[:, None, None], acceleration[:, None], past)
        along = self._along(motion, _jerk(acceleration, past, dt), sea)
        w, rest = self._step(along, sea.Y, sideslip, fresh, dt)
        plan = assemble(np.zeros(1), np.zeros((2, 1, 1)), along, w[None], self.vehicle, (sea.Y, sea.Y_rate))
        reference = WaterReference(*(row[0] for row in (plan.psi, plan.u, plan.v, plan.r, plan.F_u, plan.F_r)))
        past = np.stack((acceleration, past[:, 0]), axis=1)
        return (count + 1, past, np.stack((w, rest), axis=1)), reference

    def _along(self, motion: Motion, jerk: Array, sea: Sea) -> PathRates:
        """Return speed, direction and their rates through the water, shape (1, N): a time axis of one instant."""
        speed, strength = np.hypot(motion.v_x, motion.v_y), np.hypot(sea.V_x, sea.V_y)
        share = np.minimum(1.0, LARGEST_CURRENT * speed / np.maximum(strength, 1e-9))
        velocity = motion.v_x - share * sea.V_x, motion.v_y - share * sea.V_y
        acceleration = motion.a_x - sea.V_x_rate, motion.a_y - sea.V_y_rate
        position = np.zeros((2, len(speed)))
        along = path_rates(np.array((position, velocity, acceleration, jerk.T))[:, :, None])
        return braked(along, HARDEST_BRAKING * self.vehicle.d22 / self.vehicle.m22)

    def _step(
        self, along: PathRates, Y: Array | float, sideslip: Array, fresh: NDArray[np.bool_], dt: Array
    ) -> tuple[Array, Array]:
        """Return w = sin(gamma), one period later, and the rest of its equation."""
        Dm = self.vehicle.m22 - self.vehicle.m11
        slope, square, turn = (dt / Dm * term[0] for term in sideslip_terms(along, self.vehicle))
        push = dt / Dm * Y / along.v_p[0]

        def rest_of(w: Array) -> Array:
            return np.asarray(push + sideslip_rest(slope, square, turn, w, np.sqrt))

        last_w, last_rest = sideslip.T
        w, rest = sideslip_step(last_w, last_rest, rest_of, self.vehicle.d22 / Dm * dt, LARGEST_SINE)
        if fresh.any():
            w = np.where(fresh, np.clip(slow_sideslip(along, self.vehicle), -LARGEST_SINE, LARGEST_SINE), w)
            rest = rest_of(w)
        return w, rest


def braked(along: PathRates, hardest: float) -> PathRates:
    """Return the rates along a path through the water with a braking -v_p'/v_p [1/s] of at most `hardest`."""
    return replace(along, v_p_dot=np.maximum(along.v_p_dot, -hardest * along.v_p))


def _jerk(acceleration: Array, past: Array, dt: Array) -> Array:
    """Return the rate of the acceleration, shape (N, 2), by the backward difference of second order."""
    last, second = past.transpose(1, 0, 2)
    return np.asarray((1.5 * acceleration - 2 * last + 0.5 * second) / dt[:, None])


def water_errors(state: Sequence[Array], reference: WaterReference) -> tuple[Array, ...]:
    """Return the first eleven terms of an `Observation` as the water's frame has them, for the tracking law.

    Args:
        state: position error e_x, e_y [m] in the body frame, psi [rad], u, v [m/s] relative to the water, r [rad/s].
        reference: what the vehicle should do there.
    """
    e_x, e_y, psi, u, v, r = state
    psi_R, u_R, v_R, r_R, *forces = reference
    return e_x, e_y, wrap_angle(psi - psi_R, ARRAYS), u - u_R, v - v_R, r - r_R, u_R, v_R, r_R, *forces
