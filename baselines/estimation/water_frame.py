"""The reference as seen from the water: what keeps the vehicle on its path in a current, re-planned at every step.

In a current c that is constant in the world the vehicle moves relative to the water as it would in still water. Its
path there has the velocity p_R' - c and the higher derivatives of p_R, and the planner gives heading and forces
for it; where the current changes, its rate is subtracted too. A sway force on the hull enters the equation of the
sideslip and is planned for as well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from auv_gym.physics.dynamics import rates
from auv_gym.physics.errors import to_world
from auv_gym.physics.namespaces import ARRAYS, Namespace, Number, wrap_angle
from auv_gym.physics.vehicle import Coefficients
from auv_gym.planning.sideslip import (
    PathRates,
    in_sideslip,
    path_rates,
    sideslip_rest,
    sideslip_step,
    sideslip_terms,
    steady_sideslip,
)
from auv_gym.task.observation import Observation

LARGEST_CURRENT = 0.85
"""Largest current that is planned for, as a share of the reference's speed: forward motion needs one below 1."""
_HARDEST_BRAKING = 0.95
"""Largest braking -v_p'/v_p through the water, as a share of d22/m22, beyond which the sideslip grows without bound."""
_LARGEST_SINE = math.sin(1.2)
"""Sine of the largest sideslip, 1.2 rad."""


class ReferenceMotion(NamedTuple):
    """How the reference moves over ground, in the world."""

    psi: Number  # [rad]
    v_x: Number  # [m/s]
    v_y: Number  # [m/s]
    a_x: Number  # [m/s^2]
    a_y: Number  # [m/s^2]


class Sea(NamedTuple):
    """What acts on the vehicle, as it is believed to be."""

    V_x: Number  # [m/s] current, in the world
    V_y: Number  # [m/s]
    V_x_rate: Number = 0.0  # [m/s^2]
    V_y_rate: Number = 0.0
    Y: Number = 0.0  # [N] sway force on the hull
    Y_rate: Number = 0.0  # [N/s]


class WaterReference(NamedTuple):
    """The reference relative to the water, the fields of an `Observation`."""

    psi: Number  # [rad]
    u_R: Number  # [m/s]
    v_R: Number  # [m/s]
    r_R: Number  # [rad/s]
    F_uR: Number  # [N] (16a)
    F_rR: Number  # [N m] (16b)


def reference_motion(o: Observation, coefficients: Coefficients, ns: Namespace) -> ReferenceMotion:
    """Return how the reference moves at this instant; the coefficients are those of the vehicle it was planned for.

    The measured heading less the heading error is the reference's heading, free of noise but for a low-pass. The
    accelerations are those of (2) under the reference's forces.
    """
    psi = ns.arctan2(o.sin_psi, o.cos_psi) - o.psi_e
    v_x, v_y, u_dot, v_dot, _ = rates(psi, o.u_R, o.v_R, o.r_R, (o.F_uR, 0.0, o.F_rR), coefficients, ns)
    a_x, a_y = to_world(u_dot - o.v_R * o.r_R, v_dot + o.u_R * o.r_R, ns.cos(psi), ns.sin(psi))
    return ReferenceMotion(psi, v_x, v_y, a_x, a_y)


class PlannedReference(NamedTuple):
    """What the planner remembers."""

    count: Number  # of the periods so far
    a_x: Number  # [m/s^2] last acceleration of the reference, in the world
    a_y: Number
    before_x: Number  # [m/s^2] the one before
    before_y: Number
    w: Number  # sine of the sideslip
    rest: Number  # the rest of its equation, see `sideslip.sideslip_rest`, times the period


def planned(
    memory: PlannedReference, motion: ReferenceMotion, sea: Sea, dt: Number, coefficients: Coefficients, ns: Namespace
) -> tuple[PlannedReference, WaterReference]:
    """Return the memory one control period later and the reference in the water frame at this instant.

    Args:
        memory: zeros at the start of an episode, or as the last call returned it.
        motion: of the reference over ground.
        sea: what acts on the vehicle; the current's rate is taken to remain as it is.
        dt: control period [s].
        coefficients: of the vehicle.
        ns: the namespace of the numbers.
    """
    held_out = memory.count <= 0.0
    x_1, x_2 = (ns.where(held_out, motion.a_x, a_x) for a_x in (memory.a_x, memory.before_x))
    y_1, y_2 = (ns.where(held_out, motion.a_y, a_y) for a_y in (memory.a_y, memory.before_y))
    # The rate of the acceleration, by the backward difference of second order.
    jerk = (1.5 * motion.a_x - 2 * x_1 + 0.5 * x_2) / dt, (1.5 * motion.a_y - 2 * y_1 + 0.5 * y_2) / dt
    along = _along(motion, jerk, sea, coefficients, ns)
    w, rest = _sideslip(memory, along, sea.Y, held_out, dt, coefficients, ns)
    psi, u, v, r, F_u, F_r, _ = in_sideslip(along, w, coefficients, (sea.Y, sea.Y_rate), ns)
    after = PlannedReference(memory.count + 1.0, motion.a_x, motion.a_y, x_1, y_1, w, rest)
    return after, WaterReference(psi, u, v, r, F_u, F_r)


def _along(
    motion: ReferenceMotion, jerk: Sequence[Number], sea: Sea, coefficients: Coefficients, ns: Namespace
) -> PathRates:
    """Return speed, direction and their rates through the water."""
    speed, strength = ns.hypot(motion.v_x, motion.v_y), ns.hypot(sea.V_x, sea.V_y)
    share = ns.clip(LARGEST_CURRENT * speed / ns.clip(strength, 1e-9, math.inf), -math.inf, 1.0)
    velocity = motion.v_x - share * sea.V_x, motion.v_y - share * sea.V_y
    acceleration = motion.a_x - sea.V_x_rate, motion.a_y - sea.V_y_rate
    along = path_rates(((0.0, 0.0), velocity, acceleration, jerk), ns)
    drag = coefficients.d22 + coefficients.Y_uv * along.v_p
    return braked(along, _HARDEST_BRAKING * drag / coefficients.m22, ns)


def _sideslip(
    memory: PlannedReference,
    along: PathRates,
    Y: Number,
    held_out: Number,
    dt: Number,
    coefficients: Coefficients,
    ns: Namespace,
) -> tuple[Number, Number]:
    """Return w = sin(gamma), one period later, and the rest of its equation."""
    Dm = coefficients.slip_mass
    terms = [dt / Dm * term for term in sideslip_terms(along, coefficients)]
    push = dt / Dm * Y / along.v_p

    def rest_of(w: Number) -> Number:
        return push + sideslip_rest(terms, w, ns.sqrt)

    w, rest = sideslip_step(memory.w, memory.rest, rest_of, coefficients.d22 / Dm * dt, _LARGEST_SINE, ns)
    first = ns.clip(steady_sideslip(along, coefficients, ns), -_LARGEST_SINE, _LARGEST_SINE)
    return ns.where(held_out, first, w), ns.where(held_out, rest_of(first), rest)


def braked(along: PathRates, hardest: Number, ns: Namespace = ARRAYS) -> PathRates:
    """Return the rates along a path through the water with a braking -v_p'/v_p [1/s] of at most `hardest`."""
    return replace(along, v_p_dot=ns.clip(along.v_p_dot, -hardest * along.v_p, math.inf))


def water_errors(state: Sequence[Number], reference: WaterReference, ns: Namespace) -> tuple[Number, ...]:
    """Return the first eleven terms of an `Observation` as the water's frame has them, for the tracking law.

    Args:
        state: position error e_x, e_y [m] in the body frame, psi [rad], u, v [m/s] relative to the water, r [rad/s].
        reference: what the vehicle should do there.
        ns: the namespace of the numbers.
    """
    e_x, e_y, psi, u, v, r = state
    psi_R, u_R, v_R, r_R, *forces = reference
    return e_x, e_y, wrap_angle(psi - psi_R, ns), u - u_R, v - v_R, r - r_R, u_R, v_R, r_R, *forces
