"""The tracking law in the water frame, with the current from a simple observer.

A copy of the vehicle's model is driven by the commanded forces. What the measured ground velocity exceeds the copy's by
is taken for the current: with nu = measured - (u, v) - R(psi)^T c,

    (u, v)' = model + l1 nu,    c' = l2 R(psi) nu.

On one axis with drag d = d11/m11 (or d22/m22) the poles are the roots of s^2 + (d + l1 + l2) s + d l2. Fast ones make
l1 negative: the copy then runs away from what is measured, so that the current may follow. The gains here are those of
the sampled observer, whose poles are exp(-fast dt) and exp(-slow dt) for every period dt. A wrong model's drag is
mistaken for current.
"""

from __future__ import annotations

from typing import NamedTuple, cast

from auv_gym.physics.dynamics import rk4_step
from auv_gym.physics.errors import to_body, to_world
from auv_gym.physics.namespaces import Namespace, Number
from auv_gym.physics.vehicle import Coefficients, Vehicle
from auv_gym.task.observation import Observation, V
from baselines.control.backstepping import tracking_forces
from baselines.control.ekf_law import undamped_symbols
from baselines.control.traced import TracedController, TracedLaw
from baselines.estimation.water_frame import PlannedReference, Sea, planned, reference_motion, water_errors


class ObserverGains(NamedTuple):
    """Gains of the law, see `backstepping.undamped`, and the observer's poles."""

    k: Number  # [1/s]
    cu: Number  # [1/s]
    c: Number  # [1/s]
    cr: Number  # [1/s]
    reference_speed: Number  # [m/s]
    fast: Number  # [1/s]
    slow: Number  # [1/s]


class ObserverMemory(NamedTuple):
    """What is remembered: of the observer, then of the planner, see `water_frame.PlannedReference`."""

    begun: Number  # 1 once it has run, 0 before
    u: Number  # [m/s] of the copy, relative to the water
    v: Number  # [m/s]
    psi: Number  # [rad] measured
    r: Number  # [rad/s] measured
    V_x: Number  # [m/s] the current c in the world
    V_y: Number  # [m/s]
    count: Number
    a_x: Number
    a_y: Number
    before_x: Number
    before_y: Number
    w: Number
    rest: Number


def current_observer(
    o: Observation, before: ObserverMemory, g: ObserverGains, vehicle: Coefficients, ns: Namespace
) -> tuple[ObserverMemory, tuple[Number, Number]]:
    """Return what is remembered, and F_u [N], F_r [N m]; see `traced.LawEquation`."""
    seen = observed(o, before, (g.fast, g.slow), vehicle, ns)
    _, _, _, psi, r, V_x, V_y = seen
    motion = reference_motion(o, vehicle, ns)
    plan, R = planned(PlannedReference(*before[len(seen) :]), motion, Sea(V_x, V_y), o.dt, vehicle, ns)
    V_u, V_v = to_body(V_x, V_y, o.cos_psi, o.sin_psi)
    errors = water_errors((o.e_x, o.e_y, psi, o.u_R + o.u_e - V_u, o.v_R + o.v_e - V_v, r), R, ns)
    law = undamped_symbols((g.k, g.cu, g.c, g.cr, g.reference_speed))
    return ObserverMemory._make((*seen, *plan)), tracking_forces(errors, cast(Vehicle, vehicle), law, ns)


def observed(
    o: Observation, before: ObserverMemory, poles: tuple[Number, Number], coefficients: Coefficients, ns: Namespace
) -> tuple[Number, ...]:
    """Return the first rows of `ObserverMemory`, the observer's, after one more observation.

    Args:
        o: the observation in SI units.
        before: zeros at the start of an episode, or as the last call returned it.
        poles: fast and slow [1/s].
        coefficients: of the vehicle.
        ns: the namespace of the numbers.
    """
    c = coefficients
    load = (o.a_u * o.F_u_max, 0.0, o.a_r * o.F_r_max)
    hull = (0.0, 0.0, before.psi, before.u, before.v, before.r)
    _, _, _, u, v, _ = rk4_step(hull, load, c, o.dt, ns=ns)
    measured_u, measured_v = o.u_R + o.u_e, o.v_R + o.v_e
    u, v = (ns.where(before.begun > 0.0, a, b) for a, b in ((u, measured_u), (v, measured_v)))
    V_u, V_v = to_body(before.V_x, before.V_y, o.cos_psi, o.sin_psi)
    nu_u, nu_v = measured_u - u - V_u, measured_v - v - V_v
    copy_u, follow_u = sampled_gains(c.d11 / c.m11, poles, o.dt, ns)
    copy_v, follow_v = sampled_gains(c.d22 / c.m22, poles, o.dt, ns)
    x, y = to_world(follow_u * nu_u, follow_v * nu_v, o.cos_psi, o.sin_psi)
    found = u + copy_u * nu_u, v + copy_v * nu_v, before.V_x + x, before.V_y + y
    u, v, V_x, V_y = (ns.clip(velocity, -V, V) for velocity in found)  # finite even where the vehicle spins
    psi = ns.arctan2(o.sin_psi, o.cos_psi)
    return ns.where(before.begun > 0.0, before.begun, 1.0), u, v, psi, o.r_R + o.r_e, V_x, V_y


def sampled_gains(drag: Number, poles: tuple[Number, Number], dt: Number, ns: Namespace) -> tuple[Number, Number]:
    """Return what nu adds on an axis to the copy's velocity and to the current in a period.

    Args:
        drag: over the inertia [1/s].
        poles: fast and slow [1/s].
        dt: control period [s].
        ns: the namespace of the numbers.
    """
    a, (fast, slow) = ns.exp(-drag * dt), (ns.exp(-pole * dt) for pole in poles)
    follow = (1 - fast) * (1 - slow) / (1 - a)
    return 1 - fast * slow / a - follow, follow


class CurrentObserver(TracedController):
    """The controller; its gains are the fields of `ObserverGains`."""

    law = TracedLaw(current_observer, ObserverGains, ObserverMemory)
