"""Local stability: eigenvalues of the closed loop, linearised about steady motion on a circle or a straight line."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from auv_gym.physics.dynamics import Force
from auv_gym.physics.namespaces import ARRAYS, Array, Namespace, Number
from auv_gym.physics.vehicle import Vehicle
from auv_gym.planning.paths import Circle, Line
from auv_gym.planning.planner import plan
from baselines.control.backstepping import Gains, backstepping_errors, tracking_forces
from baselines.control.linearisation import error_dynamics

Feedback = Callable[[Sequence[Array]], Force]
"""Returns F_u [N], F_r [N m] for the first eleven terms of an observation, rows of shape (N,)."""
ExaminedLaw = Callable[[Sequence[Number], Vehicle, Gains, Namespace], Force]
"""Returns F_u [N], F_r [N m] for the terms of an observation, as `backstepping.tracking_forces`."""
_STEP = 1e-6
"""Half width of the central differences of a feedback, in SI units; their error is about 1e-10."""


def loop_eigenvalues(vehicle: Vehicle, feedback: Feedback, speed: float, turn_rate: float) -> NDArray[np.complex128]:
    """Return the six eigenvalues [1/s] of the loop with a feedback about steady motion, the least stable first.

    Args:
        vehicle: the vehicle, for which the motion is planned as well.
        feedback: the forces.
        speed: path speed v_p [m/s], positive.
        turn_rate: omega [rad/s], counter-clockwise; 0 for a straight line.
    """
    path = Circle(speed, turn_rate) if turn_rate else Line(speed)
    u_R, v_R, r_R, F_uR, F_rR = plan(path, vehicle, np.array([0.0, 1.0])).table[0, 3:].tolist()
    A, B = error_dynamics(vehicle, u_R, v_R, r_R)
    reference = [np.full(len(A), value) for value in (u_R, v_R, r_R, F_uR, F_rR)]
    e = _STEP * np.eye(len(A))
    above, below = (np.stack(feedback((*errors, *reference))) for errors in (e, -e))
    values = np.linalg.eigvals(A + B @ (above - below) / (2 * _STEP)).astype(np.complex128)
    return values[np.lexsort((values.imag, -values.real))]


def closed_loop_eigenvalues(
    vehicle: Vehicle, gains: Gains, speed: float, turn_rate: float, law: ExaminedLaw = tracking_forces
) -> NDArray[np.complex128]:
    """Return the `loop_eigenvalues` of a law, whose nominal vehicle is the true one."""
    return loop_eigenvalues(vehicle, lambda o: law(o, vehicle, gains, ARRAYS), speed, turn_rate)


def spectral_abscissa(
    vehicle: Vehicle, gains: Gains, speed: float, turn_rate: float, law: ExaminedLaw = tracking_forces
) -> float:
    """Return the largest real part [1/s] of `closed_loop_eigenvalues`; it is negative for a stable loop."""
    return float(closed_loop_eigenvalues(vehicle, gains, speed, turn_rate, law)[0].real)


def first_instability(vehicle: Vehicle, gains: Gains, low: float, high: float) -> float:
    """Return the speed [m/s] in [low, high] at which motion on straight lines becomes unstable.

    Raises:
        ValueError: the loop is stable at both ends of the interval, or unstable at both.
    """
    return float(brentq(lambda speed: spectral_abscissa(vehicle, gains, speed, 0.0), low, high, xtol=1e-7))


def derived_sign_forces(o: Sequence[Number], vehicle: Vehicle, gains: Gains, ns: Namespace) -> Force:
    """Return F_u [N], F_r [N m] of the law with + g z_v instead of - z_v in (47).

    This is the term in z_v that follows from a derivation of (46).
    """
    F_u, F_r = tracking_forces(o, vehicle, gains, ns)
    _, z_v, _, g = backstepping_errors(o, vehicle.m11 / vehicle.m22, gains, ns)
    return F_u, F_r + vehicle.m33 * (1 + g) * z_v
