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

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple, cast

import numpy as np

from auv_gym.codegen.graph import SYMBOLS, Symbol
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.dynamics import rk4_step
from auv_gym.physics.errors import to_body, to_world
from auv_gym.physics.namespaces import Array, Namespace, Number
from auv_gym.physics.vehicle import Coefficients, Vehicle
from auv_gym.task.observation import Observation, V
from baselines.control.backstepping import UNDAMPED_GAINS, Gains, tracking_forces
from baselines.control.ekf_law import undamped_symbols
from baselines.estimation.kalman import VEHICLE_ROWS, repeated
from baselines.estimation.water_frame import Planned, Sea, planned, reference_motion, water_errors
from baselines.policy import Memory

OBSERVER_GAINS = (*UNDAMPED_GAINS, "fast", "slow")
"""Names of the gains: the law's, see `backstepping.undamped`, and the observer's poles [1/s]."""


class Observed(NamedTuple):
    """What the observer remembers."""

    begun: Number  # 1 once it has run, 0 before
    u: Number  # [m/s] of the copy, relative to the water
    v: Number  # [m/s]
    psi: Number  # [rad] measured
    r: Number  # [rad/s] measured
    V_x: Number  # [m/s] the current c in the world
    V_y: Number  # [m/s]


class CurrentObserver:
    """The law with its observer, a `Controller`.

    Its memory: the rows of an `Observed`, shape (N, 7); those of the planner, a `water_frame.Planned`, shape (N, 7).
    """

    def __init__(self, gains: Mapping[str, float], vehicle: Vehicle) -> None:
        """Make the controller; its gains are named in `OBSERVER_GAINS`."""
        self._known = np.array((*vehicle.coefficients, *(gains[name] for name in OBSERVER_GAINS)))[:, None]

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return np.zeros((len(Observed._fields), n)).T, np.zeros((len(Planned._fields), n)).T

    def forces(self, o: Observation, memory: Memory, extra: Array) -> tuple[Array, Array, Memory]:
        """Return F_u [N], F_r [N m], shape (N,), and the memory to hand in next."""
        seen, plan = memory
        terms = np.array(o)
        known = repeated(self._known, terms.shape[1])
        found = observer_kernel()(o=terms, known=known, seen=seen.T, plan=plan.T)
        F_u, F_r = found["force"]
        return F_u, F_r, (found["seen"].T, found["plan"].T)


@cache
def observer_kernel() -> Kernel:
    """Return the kernel of observer and law, which takes observation, vehicle and gains, and what is remembered."""

    def equation(
        o: Sequence[Symbol], known: Sequence[Symbol], seen: Sequence[Symbol], plan: Sequence[Symbol]
    ) -> Mapping[str, Sequence[Any]]:
        coefficients, (*gains, fast, slow) = Coefficients(*known[:VEHICLE_ROWS]), known[VEHICLE_ROWS:]
        terms, ns = Observation(*o), SYMBOLS
        after = observed(terms, Observed(*seen), (fast, slow), coefficients, ns)
        following, force = _law_forces(terms, after, Planned(*plan), coefficients, undamped_symbols(gains), ns)
        return {"seen": after, "plan": following, "force": force}

    rows = {"o": len(Observation._fields), "known": VEHICLE_ROWS + len(OBSERVER_GAINS)}
    rows |= {"seen": len(Observed._fields), "plan": len(Planned._fields)}
    return Kernel.traced(equation, rows, structural=True, blocked=True)


def _law_forces(
    o: Observation, seen: Observed, plan: Planned, coefficients: Coefficients, gains: Gains, ns: Namespace
) -> tuple[Planned, tuple[Number, Number]]:
    """Return what the planner remembers, and F_u [N], F_r [N m].

    Args:
        o: the observation in SI units.
        seen: the observer with it.
        plan: what the planner remembers.
        coefficients: of the vehicle.
        gains: of the law.
        ns: the namespace of the numbers.
    """
    motion, sea = reference_motion(o, coefficients, ns), Sea(seen.V_x, seen.V_y)
    plan, R = planned(plan, motion, sea, o.dt, coefficients, ns)
    V_u, V_v = to_body(seen.V_x, seen.V_y, o.cos_psi, o.sin_psi)
    errors = water_errors((o.e_x, o.e_y, seen.psi, o.u_R + o.u_e - V_u, o.v_R + o.v_e - V_v, seen.r), R, ns)
    return plan, tracking_forces(errors, cast(Vehicle, coefficients), gains, ns)


def observed(
    o: Observation, before: Observed, poles: tuple[Number, Number], coefficients: Coefficients, ns: Namespace
) -> Observed:
    """Return the observer after one more observation.

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
    return Observed(ns.where(before.begun > 0.0, before.begun, 1.0), u, v, psi, o.r_R + o.r_e, V_x, V_y)


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
