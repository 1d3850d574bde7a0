"""Reference in the water frame: the motion that keeps the vehicle on its path in a current, planned at every step.

In a current c that is constant in the world, the vehicle moves relative to the water as it would in still water. Its
path through the water has the velocity p_R' - c and the higher derivatives of p_R. The planner computes heading and
forces for this path. The rate of a varying current is subtracted from the acceleration. A sway force on the vehicle
enters the equation of the sideslip.
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
"""Largest current of a plan, as a share of the reference's speed. Forward motion requires a share below 1."""
HARDEST_BRAKING = 0.95
"""Largest deceleration -v_p'/v_p through the water, as a share of d22/m22. Beyond d22/m22 the sideslip diverges."""
_LARGEST_SINE = math.sin(1.2)
"""Sine of the largest sideslip, 1.2 rad."""


class ReferenceMotion(NamedTuple):
    """Motion of the reference over ground, in the world."""

    psi: Number  # [rad]
    v_x: Number  # [m/s]
    v_y: Number  # [m/s]
    a_x: Number  # [m/s^2]
    a_y: Number  # [m/s^2]


class Sea(NamedTuple):
    """Estimated disturbances that the plan takes into account."""

    V_x: Number  # [m/s] current, in the world
    V_y: Number  # [m/s]
    V_x_rate: Number = 0.0  # [m/s^2]
    V_y_rate: Number = 0.0
    Y: Number = 0.0  # [N] sway force on the vehicle
    Y_rate: Number = 0.0  # [N/s]


class WaterReference(NamedTuple):
    """Reference relative to the water, named as the fields of an `Observation`."""

    psi: Number  # [rad]
    u_R: Number  # [m/s]
    v_R: Number  # [m/s]
    r_R: Number  # [rad/s]
    F_uR: Number  # [N] (16a)
    F_rR: Number  # [N m] (16b)


def reference_motion(o: Observation, coefficients: Coefficients, ns: Namespace) -> ReferenceMotion:
    """Return the motion of the reference at this instant; `coefficients` are of the vehicle for which it was planned.

    The heading of the reference is the measured heading minus the heading error. The measurement noise cancels, except
    for the effect of a low-pass filter. The accelerations follow from (2) with the reference's forces.
    """
    psi = ns.arctan2(o.sin_psi, o.cos_psi) - o.psi_e
    v_x, v_y, u_dot, v_dot, _ = rates(psi, o.u_R, o.v_R, o.r_R, (o.F_uR, 0.0, o.F_rR), coefficients, ns)
    a_x, a_y = to_world(u_dot - o.v_R * o.r_R, v_dot + o.u_R * o.r_R, ns.cos(psi), ns.sin(psi))
    return ReferenceMotion(psi, v_x, v_y, a_x, a_y)


class PlannedReference(NamedTuple):
    """Memory of the planner in the water frame."""

    count: Number  # number of control periods so far
    a_x: Number  # [m/s^2] last acceleration of the reference, in the world
    a_y: Number
    before_x: Number  # [m/s^2] acceleration before that one
    before_y: Number
    w: Number  # sine of the sideslip
    rest: Number  # nonlinear part of the sideslip equation, see `sideslip.sideslip_rest`, times the period


def plan_in_water(
    memory: PlannedReference, motion: ReferenceMotion, sea: Sea, dt: Number, coefficients: Coefficients, ns: Namespace
) -> tuple[PlannedReference, WaterReference]:
    """Return the planner's memory one control period later and the present reference in the water frame.

    Args:
        memory: zeros at the start of an episode, or as the last call returned it.
        motion: of the reference over ground.
        sea: the disturbances; the current's rate is taken as constant.
        dt: control period [s].
        coefficients: of the vehicle.
        ns: the namespace of the numbers.
    """
    first = memory.count <= 0.0
    x_1, x_2 = (ns.where(first, motion.a_x, a_x) for a_x in (memory.a_x, memory.before_x))
    y_1, y_2 = (ns.where(first, motion.a_y, a_y) for a_y in (memory.a_y, memory.before_y))
    # Backward difference of second order.
    jerk = (1.5 * motion.a_x - 2 * x_1 + 0.5 * x_2) / dt, (1.5 * motion.a_y - 2 * y_1 + 0.5 * y_2) / dt
    along = _rates_in_water(motion, jerk, sea, coefficients, ns)
    w, rest = _sideslip(memory, along, sea.Y, first, dt, coefficients, ns)
    psi, u, v, r, F_u, F_r, _ = in_sideslip(along, w, coefficients, (sea.Y, sea.Y_rate), ns)
    after = PlannedReference(memory.count + 1.0, motion.a_x, motion.a_y, x_1, y_1, w, rest)
    return after, WaterReference(psi, u, v, r, F_u, F_r)


def _rates_in_water(
    motion: ReferenceMotion, jerk: Sequence[Number], sea: Sea, coefficients: Coefficients, ns: Namespace
) -> PathRates:
    """Return speed and direction through the water, and their rates."""
    speed, strength = ns.hypot(motion.v_x, motion.v_y), ns.hypot(sea.V_x, sea.V_y)
    share = ns.clip(LARGEST_CURRENT * speed / ns.clip(strength, 1e-9, math.inf), -math.inf, 1.0)
    velocity = motion.v_x - share * sea.V_x, motion.v_y - share * sea.V_y
    acceleration = motion.a_x - sea.V_x_rate, motion.a_y - sea.V_y_rate
    along = path_rates(((0.0, 0.0), velocity, acceleration, jerk), ns)
    drag = coefficients.d22 + coefficients.Y_uv * along.v_p
    return with_limited_braking(along, HARDEST_BRAKING * drag / coefficients.m22, ns)


def _sideslip(
    memory: PlannedReference,
    along: PathRates,
    Y: Number,
    first: Number,
    dt: Number,
    coefficients: Coefficients,
    ns: Namespace,
) -> tuple[Number, Number]:
    """Return w = sin(gamma) one period later, and the nonlinear part of its equation times the period."""
    Dm = coefficients.slip_mass
    terms = [dt / Dm * term for term in sideslip_terms(along, coefficients)]
    push = dt / Dm * Y / along.v_p

    def rest_of(w: Number) -> Number:
        return push + sideslip_rest(terms, w, ns.sqrt)

    w, rest = sideslip_step(memory.w, memory.rest, rest_of, coefficients.d22 / Dm * dt, _LARGEST_SINE, ns)
    initial = ns.clip(steady_sideslip(along, coefficients, ns), -_LARGEST_SINE, _LARGEST_SINE)
    return ns.where(first, initial, w), ns.where(first, rest_of(initial), rest)


def with_limited_braking(along: PathRates, limit: Number, ns: Namespace = ARRAYS) -> PathRates:
    """Return the rates along a path through the water with a deceleration -v_p'/v_p [1/s] of at most `limit`."""
    return replace(along, v_p_dot=ns.clip(along.v_p_dot, -limit * along.v_p, math.inf))


def water_errors(state: Sequence[Number], reference: WaterReference, ns: Namespace) -> tuple[Number, ...]:
    """Return the first eleven terms of an `Observation` in the water frame, for the tracking law.

    Args:
        state: position error e_x, e_y [m] in the body frame, psi [rad], u, v [m/s] relative to the water, r [rad/s].
        reference: in the water frame.
        ns: the namespace of the numbers.
    """
    e_x, e_y, psi, u, v, r = state
    psi_R, u_R, v_R, r_R, *forces = reference
    return e_x, e_y, wrap_angle(psi - psi_R, ns), u - u_R, v - v_R, r - r_R, u_R, v_R, r_R, *forces
