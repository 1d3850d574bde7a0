"""Local stability: eigenvalues of the closed loop, linearised about steady motion on a circle or a straight line."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from auv_gym.physics.dynamics import Force
from auv_gym.physics.namespaces import ARRAYS, Namespace, Number
from auv_gym.physics.vehicle import Vehicle
from baselines.control.backstepping import Gains, backstepping_errors, tracking_forces
from baselines.control.linearisation import linearise

ExaminedLaw = Callable[[Sequence[Number], Vehicle, Gains, Namespace], Force]
"""Returns F_u [N], F_r [N m] for the terms of an observation, as `backstepping.tracking_forces`."""


def closed_loop_eigenvalues(
    vehicle: Vehicle, gains: Gains, speed: float, turn_rate: float, law: ExaminedLaw = tracking_forces
) -> NDArray[np.complex128]:
    """Return the six eigenvalues [1/s] of the closed loop about steady motion, the least stable first.

    Args:
        vehicle: the true vehicle, which is also the nominal one.
        gains: of the law.
        speed: path speed v_p [m/s], positive.
        turn_rate: omega [rad/s], counter-clockwise; 0 for a straight line.
        law: the feedback.
    """
    return linearise(vehicle, lambda o: law(o, vehicle, gains, ARRAYS), speed, turn_rate).eigenvalues


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
