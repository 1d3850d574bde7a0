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

from collections.abc import Mapping
from functools import partial

import numpy as np

from auv_gym.dynamics import rk4_step
from auv_gym.errors import to_body, to_world
from auv_gym.namespaces import ARRAYS
from auv_gym.task import Observation, V
from auv_gym.vehicle import Vehicle
from baselines.control.backstepping import UNDAMPED_GAINS, tracking_forces, undamped
from baselines.estimation.water_frame import Sea, WaterPlan, reference_motion, water_errors
from baselines.gains.loading import tuned_policy
from baselines.policy import Array, Memory

OBSERVER_GAINS = (*UNDAMPED_GAINS, "fast", "slow")
"""Names of the gains: the law's, see `backstepping.undamped`, and the observer's poles [1/s]."""


class CurrentObserver:
    """The law with its observer, a `Controller`.

    Its memory: whether it has run, (N,); the copy's u, v and the measured psi, r, (N, 4); the current c in the world,
    (N, 2); then the memory of its `WaterPlan`.
    """

    def __init__(self, gains: Mapping[str, float], vehicle: Vehicle) -> None:
        """Make the controller; its gains are named in `OBSERVER_GAINS`."""
        self.gains = undamped(gains)
        self.vehicle, self.plan = vehicle, WaterPlan(vehicle)
        self._poles = gains["fast"], gains["slow"]
        self._drag = np.array((vehicle.d11 / vehicle.m11, vehicle.d22 / vehicle.m22))[:, None]

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return np.zeros(n), np.zeros((n, 4)), np.zeros((n, 2)), *self.plan.start(n)

    def forces(self, o: Observation, memory: Memory, extra: Array) -> tuple[Array, Array, Memory]:
        """Return F_u [N], F_r [N m], shape (N,), and the memory to hand in next."""
        begun, copy, current, *planned = memory
        (u, v), (V_x, V_y) = self.observe(o, begun, copy, current)
        motion = reference_motion(o, self.vehicle.coefficients)
        psi = motion.psi + o.psi_e
        plan, R = self.plan.update(tuple(planned), motion, Sea(V_x, V_y), o.dt)
        V_u, V_v = to_body(V_x, V_y, o.cos_psi, o.sin_psi)
        u_ground, v_ground = o.u_R + o.u_e, o.v_R + o.v_e
        errors = water_errors((o.e_x, o.e_y, psi, u_ground - V_u, v_ground - V_v, o.r_R + o.r_e), R)
        F_u, F_r = tracking_forces(errors, self.vehicle, self.gains, ARRAYS)
        copy = np.stack((u, v, psi, o.r_R + o.r_e), axis=1)
        return F_u, F_r, (np.ones_like(u), copy, np.stack((V_x, V_y), axis=1), *plan)

    def observe(self, o: Observation, begun: Array, copy: Array, current: Array) -> tuple[Array, Array]:
        """Return the copy's u, v and the current V_x, V_y [m/s] after one more observation, each of shape (2, N).

        Args:
            o: the observation.
            begun: whether the observer has run, shape (N,).
            copy: the copy's u, v [m/s] and the measured psi [rad], r [rad/s], shape (N, 4).
            current: V_x, V_y [m/s] as observed so far, shape (N, 2).
        """
        copy_gain, follow = self.sampled_gains(o.dt)
        u, v, psi, r = copy.T
        load = (o.a_u * o.F_u_max, 0.0, o.a_r * o.F_r_max)
        still = np.zeros_like(u)
        _, _, _, u, v, _ = rk4_step((still, still, psi, u, v, r), load, self.vehicle.coefficients, o.dt, ns=np)
        measured = np.array((o.u_R + o.u_e, o.v_R + o.v_e))
        model = np.where(begun, np.array((u, v)), measured)
        V_x, V_y = current.T
        nu = measured - model - np.array(to_body(V_x, V_y, o.cos_psi, o.sin_psi))
        pull_u, pull_v = follow * nu
        c = current.T + np.array(to_world(pull_u, pull_v, o.cos_psi, o.sin_psi))
        return np.clip(model + copy_gain * nu, -V, V), np.clip(c, -V, V)  # finite even where the vehicle spins

    def sampled_gains(self, dt: Array) -> tuple[Array, Array]:
        """Return what nu adds to the copy's u, v and to the current in a period of dt [s], each of shape (2, N)."""
        a, fast, slow = np.exp(-self._drag * dt), *(np.exp(-pole * dt) for pole in self._poles)
        follow = (1 - fast) * (1 - slow) / (1 - a)
        return 1 - fast * slow / a - follow, follow


make_current_observer = partial(tuned_policy, "current-observer", OBSERVER_GAINS, CurrentObserver)
"""Returns the controller as a policy; its arguments `gains` and `vehicle` are those of `tuned_policy`."""
