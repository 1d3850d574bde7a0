"""The tracking law in the water frame, with the current from a Luenberger observer.

The commanded forces drive a copy of the nominal model. The difference between the measured ground velocity and the
velocity of the copy is attributed to the current: with nu = measured - (u, v) - R(psi)^T c,

    (u, v)' = model + l1 nu,    c' = l2 R(psi) nu.

On one axis with drag d = d11/m11 (or d22/m22) the poles are the roots of s^2 + (d + l1 + l2) s + d l2. For fast poles
l1 is negative: the copy moves away from the measurement, so that the estimate of the current can follow. The gains here
are those of the discrete-time observer with the poles exp(-fast dt) and exp(-slow dt) for every period dt. An error of
the model's drag is attributed to the current.
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
from baselines.estimation.water_frame import PlannedReference, Sea, plan_in_water, reference_motion, water_errors


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
    """Memory of the observer, then of the planner, see `water_frame.PlannedReference`."""

    started: Number  # 0 at the start of an episode, else 1
    u: Number  # [m/s] of the copy, relative to the water
    v: Number  # [m/s]
    psi: Number  # [rad] measured
    r: Number  # [rad/s] measured
    V_x: Number  # [m/s] estimated current c in the world
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
    """Return the memory, and F_u [N], F_r [N m]; see `traced.LawEquation`."""
    observer = observer_update(o, before, (g.fast, g.slow), vehicle, ns)
    _, _, _, psi, r, V_x, V_y = observer
    motion = reference_motion(o, vehicle, ns)
    plan, R = plan_in_water(PlannedReference(*before[len(observer) :]), motion, Sea(V_x, V_y), o.dt, vehicle, ns)
    V_u, V_v = to_body(V_x, V_y, o.cos_psi, o.sin_psi)
    errors = water_errors((o.e_x, o.e_y, psi, o.u_R + o.u_e - V_u, o.v_R + o.v_e - V_v, r), R, ns)
    law = undamped_symbols((g.k, g.cu, g.c, g.cr, g.reference_speed))
    return ObserverMemory._make((*observer, *plan)), tracking_forces(errors, cast(Vehicle, vehicle), law, ns)


def observer_update(
    o: Observation, before: ObserverMemory, poles: tuple[Number, Number], coefficients: Coefficients, ns: Namespace
) -> tuple[Number, ...]:
    """Return the rows of the observer in `ObserverMemory` after one more observation.

    Args:
        o: the observation in SI units.
        before: zeros at the start of an episode, or as the last call returned it.
        poles: fast and slow [1/s].
        coefficients: of the vehicle.
        ns: the namespace of the numbers.
    """
    c = coefficients
    load = (o.a_u * o.F_u_max, 0.0, o.a_r * o.F_r_max)
    _, _, _, u, v, _ = rk4_step((0.0, 0.0, before.psi, before.u, before.v, before.r), load, c, o.dt, ns=ns)
    measured_u, measured_v = o.u_R + o.u_e, o.v_R + o.v_e
    u, v = (ns.where(before.started > 0.0, a, b) for a, b in ((u, measured_u), (v, measured_v)))
    V_u, V_v = to_body(before.V_x, before.V_y, o.cos_psi, o.sin_psi)
    nu_u, nu_v = measured_u - u - V_u, measured_v - v - V_v
    copy_u, follow_u = sampled_gains(c.d11 / c.m11, poles, o.dt, ns)
    copy_v, follow_v = sampled_gains(c.d22 / c.m22, poles, o.dt, ns)
    x, y = to_world(follow_u * nu_u, follow_v * nu_v, o.cos_psi, o.sin_psi)
    corrected = u + copy_u * nu_u, v + copy_v * nu_v, before.V_x + x, before.V_y + y
    u, v, V_x, V_y = (ns.clip(velocity, -V, V) for velocity in corrected)  # finite even if the vehicle spins
    psi = ns.arctan2(o.sin_psi, o.cos_psi)
    return ns.where(before.started > 0.0, before.started, 1.0), u, v, psi, o.r_R + o.r_e, V_x, V_y


def sampled_gains(drag: Number, poles: tuple[Number, Number], dt: Number, ns: Namespace) -> tuple[Number, Number]:
    """Return the discrete-time gains of the innovation nu on an axis, for the copy's velocity and for the current.

    Args:
        drag: linear drag over the inertia [1/s].
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
