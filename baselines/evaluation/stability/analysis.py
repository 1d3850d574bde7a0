"""Local stability: eigenvalues of the tracking loop linearised about steady motion on a circle or a straight line."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from auv_gym.physics.dynamics import Force
from auv_gym.physics.namespaces import ARRAYS, Array, Namespace, Number
from auv_gym.physics.vehicle import Vehicle
from auv_gym.task.observation import encode
from auv_gym.task.policy import Policy
from baselines.control.backstepping import Backstepping, Gains, backstepping_errors, tracking_forces
from baselines.control.linearisation import FINE_STEP, Feedback, Linearisation, linearise
from baselines.similar import SimilarLaw

ExaminedLaw = Callable[[Sequence[Number], Vehicle, Gains, Namespace], Force]
"""F_u [N], F_r [N m] of the terms of an observation, as `backstepping.tracking_forces`."""

COARSE_STEP = 1e-3
"""Half width of the differences of a policy, whose actions have single precision: an error of about 1e-4."""
_LIMITS = 1024.0
"""Limits [N] and [N m] that a policy is told where it is to be linearised: far from any force."""


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
    if isinstance(policy, (Backstepping, SimilarLaw)):  # in double precision
        return lambda o: policy.forces(o, ARRAYS), FINE_STEP

    def feedback(o: Sequence[Array]) -> Force:
        n = len(o[0])
        one, zero, limit = np.ones(n), np.zeros(n), np.full(n, _LIMITS)
        rest = (one, zero, limit, limit, o[9] / _LIMITS, o[10] / _LIMITS, np.full(n, dt))
        actions, memory = policy.predict(encode((*o, *rest), ARRAYS, span=1).T, None, np.ones(n, dtype=bool))
        if memory is not None:
            raise ValueError("it has a memory; the map is of policies without one")
        F_u, F_r = _LIMITS * np.asarray(actions, dtype=np.float64).T
        return F_u, F_r

    return feedback, COARSE_STEP


def closed_loop_eigenvalues(
    vehicle: Vehicle, gains: Gains, speed: float, turn_rate: float, law: ExaminedLaw = tracking_forces
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
    vehicle: Vehicle, gains: Gains, speed: float, turn_rate: float, law: ExaminedLaw = tracking_forces
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
