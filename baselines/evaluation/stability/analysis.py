"""Local stability: eigenvalues of the tracking loop linearised about steady motion on a circle or a straight line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import brentq

from auv_gym.dynamics import Force, rates
from auv_gym.errors import to_body
from auv_gym.namespaces import ARRAYS, Namespace, Number
from auv_gym.paths import Circle, Line
from auv_gym.planner import plan
from auv_gym.policy import Policy
from auv_gym.task import encode
from auv_gym.vehicle import Vehicle
from baselines.control.backstepping import Backstepping, Gains, backstepping_errors, tracking_forces

Array = NDArray[np.float64]
Feedback = Callable[[Sequence[Array]], Force]
"""F_u [N], F_r [N m] of the first eleven terms of an observation, rows of shape (N,)."""
Law = Callable[[Sequence[Number], Vehicle, Gains, Namespace], Force]
"""F_u [N], F_r [N m] of the terms of an observation, as `backstepping.tracking_forces`."""

STEP = 1e-6
"""Half width of the central differences, in SI units: their error is about 1e-10."""
COARSE_STEP = 1e-3
"""The same for a policy, whose actions have single precision: an error of about 1e-4."""
LIMITS = 1024.0
"""Limits [N] and [N m] that a policy is told where it is to be linearised: far from any force."""
LONGEST_PERIOD = 5.0
"""Longest control period [s] that is looked at."""


@dataclass(frozen=True)
class Linearisation:
    """The loop about steady motion: e' = A e + B f with errors e in the body frame, and the feedback f = K e."""

    A: Array  # shape (6, 6)
    B: Array  # shape (6, 2)
    K: Array  # shape (2, 6)

    @property
    def eigenvalues(self) -> NDArray[np.complex128]:
        """The six eigenvalues [1/s] of the continuous loop, the least stable first."""
        values = np.linalg.eigvals(self.A + self.B @ self.K).astype(np.complex128)
        return values[np.lexsort((values.imag, -values.real))]

    def held(self, period: float) -> Array:
        """Return the matrix from one control instant to the next, shape (6, 6), with the forces held in between."""
        block = np.zeros((8, 8))
        block[:6] = np.hstack((self.A, self.B))
        step = expm(block * period)
        return np.asarray(step[:6, :6] + step[:6, 6:] @ self.K)

    def largest_period(self) -> float:
        """Return the period [s] at which the held loop turns unstable first; 0 if it always is, inf if not by 5 s."""

        def growth(period: float) -> float:
            return float(np.abs(np.linalg.eigvals(self.held(period))).max()) - 1

        if self.eigenvalues[0].real >= 0:
            return 0.0
        grid = np.linspace(0.02, LONGEST_PERIOD, 250)
        unstable = np.flatnonzero([growth(T) > 0 for T in grid.tolist()])
        if len(unstable) == 0:
            return float("inf")
        k = int(unstable[0])
        return 0.0 if k == 0 else float(brentq(growth, grid[k - 1], grid[k], xtol=1e-6))


def linearise(
    vehicle: Vehicle, feedback: Feedback, speed: float, turn_rate: float, step: float = STEP
) -> Linearisation:
    """Return the loop linearised about steady motion, by central differences.

    Args:
        vehicle: the vehicle, known exactly.
        feedback: the forces.
        speed: path speed v_p [m/s], positive.
        turn_rate: omega [rad/s], counter-clockwise; 0 for a straight line.
        step: half width of the differences, in SI units.
    """
    path = Circle(speed, turn_rate) if turn_rate else Line(speed)
    return linearise_about(vehicle, feedback, plan(path, vehicle, np.array([0.0, 1.0])).table[0, 3:].tolist(), step)


def linearise_about(
    vehicle: Vehicle, feedback: Feedback, reference: Sequence[float], step: float = STEP
) -> Linearisation:
    """Return the loop linearised about an instant of any reference, steady or not: what the reference does cancels.

    Args:
        vehicle: the vehicle, known exactly.
        feedback: the forces.
        reference: u_R, v_R [m/s], r_R [rad/s], F_uR [N], F_rR [N m].
        step: half width of the differences, in SI units.
    """
    u_R, v_R, r_R, F_uR, F_rR = reference

    def forces(e: Array) -> Array:
        steady = (np.full(e.shape[1], value) for value in (u_R, v_R, r_R, F_uR, F_rR))
        return np.stack(feedback((*e, *steady)))

    def error_rates(e: Array, f: Array) -> Array:
        """The autonomous error system in the body frame, for errors (6, N) and forces (2, N), but for a constant."""
        e_x, e_y, psi_e, u_e, v_e, r_e = e
        u, v, r = u_R + u_e, v_R + v_e, r_R + r_e
        _, _, u_dot, v_dot, r_dot = rates(psi_e, u, v, r, (f[0], 0.0, f[1]), vehicle.coefficients, np)
        along, across = to_body(u_R, v_R, np.cos(psi_e), np.sin(psi_e))  # the reference's velocity in the body frame
        return np.stack((u - along + r * e_y, v - across - r * e_x, r_e, u_dot, v_dot, r_dot))

    e, f = step * np.eye(6), step * np.eye(2)
    still, steady = np.zeros((6, 2)), np.array([[F_uR], [F_rR]])
    held = np.repeat(steady, 6, axis=1)
    return Linearisation(
        A=(error_rates(e, held) - error_rates(-e, held)) / (2 * step),
        B=(error_rates(still, steady + f) - error_rates(still, steady - f)) / (2 * step),
        K=(forces(e) - forces(-e)) / (2 * step),
    )


def linearise_policy(vehicle: Vehicle, policy: Policy, speed: float, turn_rate: float, dt: float) -> Linearisation:
    """Return the loop of a policy without memory, see `linearise`; dt is the control period that it is told [s].

    Raises:
        ValueError: the policy has a memory, which this linearisation does not describe.
    """
    feedback, step = feedback_of(policy, dt)
    return linearise(vehicle, feedback, speed, turn_rate, step)


def feedback_of(policy: Policy, dt: float) -> tuple[Feedback, float]:
    """Return the forces of a policy without memory, and the half width of differences that suits its precision.

    Args:
        policy: the policy; the forces raise ValueError where it has a memory.
        dt: control period that it is told [s].
    """
    if isinstance(policy, Backstepping):  # in double precision
        return lambda o: policy.forces(o, ARRAYS), STEP

    def feedback(o: Sequence[Array]) -> Force:
        n = len(o[0])
        one, zero, limit = np.ones(n), np.zeros(n), np.full(n, LIMITS)
        rest = (one, zero, limit, limit, o[9] / LIMITS, o[10] / LIMITS, np.full(n, dt))
        actions, memory = policy.predict(encode((*o, *rest), ARRAYS).T, None, np.ones(n, dtype=bool))
        if memory is not None:
            raise ValueError("it has a memory; the map is of policies without one")
        F_u, F_r = LIMITS * np.asarray(actions, dtype=np.float64).T
        return F_u, F_r

    return feedback, COARSE_STEP


def closed_loop_eigenvalues(
    vehicle: Vehicle, gains: Gains, speed: float, turn_rate: float, law: Law = tracking_forces
) -> NDArray[np.complex128]:
    """Return the six eigenvalues [1/s] of the loop about steady motion, the least stable first.

    Args:
        vehicle: the vehicle, known exactly.
        gains: of the law.
        speed: path speed v_p [m/s], positive.
        turn_rate: omega [rad/s], counter-clockwise; 0 for a straight line.
        law: the feedback.
    """
    return linearise(vehicle, lambda o: law(o, vehicle, gains, ARRAYS), speed, turn_rate).eigenvalues


def spectral_abscissa(
    vehicle: Vehicle, gains: Gains, speed: float, turn_rate: float, law: Law = tracking_forces
) -> float:
    """Return the largest real part [1/s] of `closed_loop_eigenvalues`: negative where the loop is stable."""
    return float(closed_loop_eigenvalues(vehicle, gains, speed, turn_rate, law)[0].real)


def first_instability(vehicle: Vehicle, gains: Gains, low: float, high: float) -> float:
    """Return the speed [m/s] in [low, high] at which straight lines turn unstable.

    Raises:
        ValueError: the loop is as stable at one end as at the other.
    """
    return float(brentq(lambda speed: spectral_abscissa(vehicle, gains, speed, 0.0), low, high, xtol=1e-7))


def derived_sign_forces(o: Sequence[Number], vehicle: Vehicle, gains: Gains, ns: Namespace) -> Force:
    """Return the law with + g z_v in place of - z_v in (47), as the term in z_v derived for (46) would have it."""
    F_u, F_r = tracking_forces(o, vehicle, gains, ns)
    _, z_v, _, g = backstepping_errors(o, vehicle.m11 / vehicle.m22, gains, ns)
    return F_u, F_r + vehicle.m33 * (1 + g) * z_v
