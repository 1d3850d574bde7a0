"""Local stability: eigenvalues of the tracking loop linearised about steady motion on a circle or a straight line."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from auv_gym.dynamics import Force, rates
from auv_gym.errors import to_body
from auv_gym.namespaces import ARRAYS, Namespace, Number
from auv_gym.paths import Circle, Line
from auv_gym.planner import plan
from auv_gym.vehicle import Vehicle
from baselines.backstepping import Gains, backstepping_errors, tracking_forces

Array = NDArray[np.float64]
Law = Callable[[Sequence[Number], Vehicle, Gains, Namespace], Force]
"""F_u [N], F_r [N m] of the terms of an observation, as `backstepping.tracking_forces`."""

STEP = 1e-6
"""Half width of the central differences, in SI units: their error is about 1e-10."""


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
    path = Circle(speed, turn_rate) if turn_rate else Line(speed)
    u_R, v_R, r_R, F_uR, F_rR = plan(path, vehicle, np.array([0.0, 1.0])).table[0, 3:].tolist()

    def error_rates(e: Array) -> Array:
        """The autonomous error system in the body frame, for errors of shape (6, N)."""
        e_x, e_y, psi_e, u_e, v_e, r_e = e
        F_u, F_r = law((*e, u_R, v_R, r_R, F_uR, F_rR), vehicle, gains, ARRAYS)
        u, v, r = u_R + u_e, v_R + v_e, r_R + r_e
        _, _, u_dot, v_dot, r_dot = rates(psi_e, u, v, r, (F_u, 0.0, F_r), vehicle.coefficients, np)
        along, across = to_body(u_R, v_R, np.cos(psi_e), np.sin(psi_e))  # the reference's velocity in the body frame
        return np.stack((u - along + r * e_y, v - across - r * e_x, r_e, u_dot, v_dot, r_dot))

    shifts = STEP * np.eye(6)
    jacobian = (error_rates(shifts) - error_rates(-shifts)) / (2 * STEP)
    eigenvalues = np.linalg.eigvals(jacobian).astype(np.complex128)
    return eigenvalues[np.lexsort((eigenvalues.imag, -eigenvalues.real))]


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
