"""Section V in continuous time: the vehicle under the tracking law, with exact measurements, no hold and no limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from scipy.integrate import solve_ivp

from auv_gym.physics.dynamics import Force, State, state_rates
from auv_gym.physics.errors import to_body, tracking_errors
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.planning.paths import PAPER_CIRCLE
from auv_gym.planning.planner import plan
from baselines.control.backstepping import GAINS, tracking_forces

TIMES = np.linspace(0.0, 100.0, 10001)
"""Sampling times of the closed loop [s], with the range of the paper's figures."""


@dataclass(frozen=True)
class ClosedLoopResponse:
    """Trajectories of the closed loop from N starts at the T `TIMES`."""

    state: Array  # x, y, psi, u, v, r, shape (6, N, T)
    errors: Array  # x_e, y_e [m], psi_e [rad], u_e, v_e [m/s], r_e [rad/s], shape (6, N, T)
    force: Array  # F_u [N], F_r [N m], shape (2, N, T)

    @property
    def position_error(self) -> Array:
        """Distance to the reference [m], shape (N, T)."""
        return np.asarray(np.hypot(self.errors[0], self.errors[1]))


def closed_loop_response(
    starts: Array, method: str = "DOP853", rtol: float = 1e-12, atol: float = 1e-14
) -> ClosedLoopResponse:
    """Return the response of the closed loop from rest, on the paper's circle with the paper's vehicle and gains.

    Args:
        starts: initial errors x_e, y_e [m], psi_e [rad], shape (3, N).
        method: integrator of `scipy.integrate.solve_ivp`, which integrates all starts together.
        rtol: relative tolerance of the integrator.
        atol: absolute tolerance of the integrator.
    """
    n = starts.shape[1]
    _, _, psi0, u_R, v_R, r_R, F_uR, F_rR = plan(PAPER_CIRCLE, PAPER_VEHICLE, np.array([0.0, 1.0])).table[0].tolist()

    def reference(t: Any) -> State:
        x, y = PAPER_CIRCLE.derivatives(t)[0]
        return x, y, psi0 + r_R * t, u_R, v_R, r_R

    def feedback(state: State, t: Any) -> tuple[State, Force]:
        """Return the tracking errors (section IV.A) and the force of the law."""
        errors = tracking_errors(state, reference(t), ARRAYS)
        e_x, e_y = to_body(errors[0], errors[1], np.cos(state[2]), np.sin(state[2]))
        observation = (e_x, e_y, *errors[2:], u_R, v_R, r_R, F_uR, F_rR)
        return errors, tracking_forces(observation, PAPER_VEHICLE, GAINS["paper"], ARRAYS)

    def rates(t: float, flat: Array) -> Array:
        state = cast(State, tuple(flat.reshape(6, n)))
        _, (F_u, F_r) = feedback(state, np.asarray(t))
        return np.concatenate(state_rates(state, (F_u, 0.0, F_r), PAPER_VEHICLE.coefficients, ns=np))

    pose = np.array([float(value) for value in reference(np.zeros(()))[:3]])
    initial = np.concatenate((pose[:, None] + starts, np.zeros((3, n))))
    solution = solve_ivp(rates, (TIMES[0], TIMES[-1]), initial.ravel(), method, TIMES, rtol=rtol, atol=atol)
    state = solution.y.reshape(6, n, len(TIMES))
    errors, force = feedback(cast(State, tuple(state)), TIMES)
    return ClosedLoopResponse(state, np.stack(errors), np.stack(force))


def last_outside(error: Array, bound: float) -> float:
    """Return the last of `TIMES` at which |error| exceeds the bound; 0 if it never does. Shape (T,)."""
    outside = np.flatnonzero(np.abs(error) > bound)
    return float(TIMES[outside[-1]]) if len(outside) else 0.0
