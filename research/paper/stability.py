"""Local stability: the closed loop, linearised about steady motion on a circle or a straight line.

In continuous time it has eigenvalues. With a command that is held for a control period and actuators with a lag it has
a monodromy matrix: the errors after a period are this matrix times those before it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from auv_gym.effects.actuators import Response, respond
from auv_gym.physics.dynamics import Force, rk4_step
from auv_gym.physics.errors import to_body, to_world, tracking_errors
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
"""Half width of the central differences, in SI units; their error is about 1e-10."""
_SUBSTEPS = 10  # integration steps in a control period


def _motion(vehicle: Vehicle, speed: float, turn_rate: float, time: float = 1.0) -> Array:
    """Return the reference of a steady motion and the one a time [s] later, rows of `Reference.table`, shape (2, 8)."""
    path = Circle(speed, turn_rate) if turn_rate else Line(speed)
    return plan(path, vehicle, np.array([0.0, time])).table


def _slopes(function: Callable[[Array], Sequence[Array]], n: int) -> Array:
    """Return the derivatives of a function of n numbers at zero, shape (m, n); it maps rows of shape (N,) to rows."""
    steps = _STEP * np.eye(n)
    above, below = (np.stack(function(e)) for e in (steps, -steps))
    return np.asarray((above - below) / (2 * _STEP))


def loop_eigenvalues(vehicle: Vehicle, feedback: Feedback, speed: float, turn_rate: float) -> NDArray[np.complex128]:
    """Return the six eigenvalues [1/s] of the loop with a feedback about steady motion, the least stable first.

    Args:
        vehicle: the vehicle, for which the motion is planned as well.
        feedback: the forces.
        speed: path speed v_p [m/s], positive.
        turn_rate: omega [rad/s], counter-clockwise; 0 for a straight line.
    """
    reference = _motion(vehicle, speed, turn_rate)[0, 3:]
    A, B = error_dynamics(vehicle, *reference[:3].tolist())
    K = _slopes(lambda e: feedback((*e, *(np.full(len(A), value) for value in reference))), len(A))
    values = np.linalg.eigvals(A + B @ K).astype(np.complex128)
    return values[np.lexsort((values.imag, -values.real))]


def monodromy(
    vehicle: Vehicle, feedback: Feedback, speed: float, turn_rate: float, control_dt: float, lag: float
) -> Array:
    """Return the matrix (8, 8) that maps deviations from steady motion to those one control period later.

    They are e_x, e_y [m], psi_e [rad], u_e, v_e [m/s], r_e [rad/s], and those of the forces of the actuators [N],
    [N m]. In the frame of the reference the steps of a steady motion are equal, so that one step is enough. A step is
    that of the simulator, without limits: `actuators.respond` and `dynamics.rk4_step`.

    Args:
        vehicle: see `loop_eigenvalues`.
        feedback: the forces that are commanded and held.
        speed: see `loop_eigenvalues`.
        turn_rate: see `loop_eigenvalues`.
        control_dt: control period [s].
        lag: time constant [s] of both actuators.
    """
    now, then = _motion(vehicle, speed, turn_rate, control_dt)
    response = Response.of(lag, math.inf, math.inf, control_dt)

    def after(deviations: Array) -> Sequence[Array]:
        e_x, e_y, psi_e, *velocities, F_u, F_r = deviations
        psi = now[2] + psi_e
        x_e, y_e = to_world(e_x, e_y, np.cos(psi), np.sin(psi))
        state = now[0] + x_e, now[1] + y_e, psi, *(w_R + w for w_R, w in zip(now[3:6], velocities, strict=True))
        command = feedback((*deviations[:6], *(np.full(len(psi), value) for value in now[3:])))
        mean, force = respond((now[6] + F_u, now[7] + F_r), command, response, ARRAYS)
        for _ in range(_SUBSTEPS):
            state = rk4_step(state, (mean[0], 0.0, mean[1]), vehicle.acting, control_dt / _SUBSTEPS, ns=ARRAYS)
        x_e, y_e, *others = tracking_errors(state, tuple(then[:6]), ARRAYS)
        e_x, e_y = to_body(x_e, y_e, np.cos(state[2]), np.sin(state[2]))
        return e_x, e_y, *others, force[0] - then[6], force[1] - then[7]

    return _slopes(after, 8)


def held_abscissa(
    vehicle: Vehicle, gains: Gains, speed: float, turn_rate: float, control_dt: float, lag: float
) -> float:
    """Return the largest real part [1/s] of log(eigenvalue) / control_dt for the `monodromy` of the law.

    It is negative for a stable loop. As the control period and the lag go to zero it becomes `spectral_abscissa`.
    """
    matrix = monodromy(vehicle, lambda o: tracking_forces(o, vehicle, gains, ARRAYS), speed, turn_rate, control_dt, lag)
    return math.log(np.abs(np.linalg.eigvals(matrix)).max()) / control_dt


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
