"""Section V in continuous time: the vehicle under the tracking law, with exact measurements, no hold and no limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from scipy.integrate import solve_ivp

from auv_gym.physics.dynamics import Force, State, state_rates
from auv_gym.physics.errors import to_body, tracking_errors
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.vehicle import Vehicle
from auv_gym.planning.paths import Circle
from auv_gym.planning.planner import plan
from baselines.control.backstepping import Gains, tracking_forces


@dataclass(frozen=True)
class SteadyCircle:
    """The reference on a circle in closed form: heading linear in time, constant velocities and forces."""

    path: Circle
    psi0: float  # [rad] heading at t = 0
    velocities: tuple[float, float, float]  # u_R, v_R [m/s], r_R [rad/s]
    forces: tuple[float, float]  # F_uR [N], F_rR [N m]

    @classmethod
    def of(cls, path: Circle, vehicle: Vehicle) -> SteadyCircle:
        """Return the reference of a vehicle on the circle."""
        first = plan(path, vehicle, np.array([0.0, 1.0])).table[0].tolist()
        return cls(path, first[2], tuple(first[3:6]), tuple(first[6:8]))

    def state(self, t: Array) -> State:
        """Return x, y, psi, u, v, r at times t of shape (T,); each has that shape or is a constant."""
        x, y = self.path.derivatives(t)[0]
        return x, y, self.psi0 + self.velocities[2] * t, *self.velocities


@dataclass(frozen=True)
class Response:
    """Trajectories of the closed loop from N starts at T times."""

    t: Array  # [s], shape (T,)
    state: Array  # x, y, psi, u, v, r, shape (6, N, T)
    reference: Array  # x, y [m], shape (2, T)
    errors: Array  # x_e, y_e [m], psi_e [rad], u_e, v_e [m/s], r_e [rad/s], shape (6, N, T)
    force: Array  # F_u [N], F_r [N m], shape (2, N, T)

    @property
    def position_error(self) -> Array:
        """Distance to the reference [m], shape (N, T)."""
        return np.asarray(np.hypot(self.errors[0], self.errors[1]))


def feedback(state: State, reference: SteadyCircle, t: Any, vehicle: Vehicle, gains: Gains) -> tuple[State, Force]:
    """Return the tracking errors (section IV.A) and the force of the law with exact measurements, for arrays."""
    target = reference.state(t)
    errors = tracking_errors(state, target, ARRAYS)
    x_e, y_e, psi_e, u_e, v_e, r_e = errors
    e_x, e_y = to_body(x_e, y_e, np.cos(state[2]), np.sin(state[2]))
    observation = (e_x, e_y, psi_e, u_e, v_e, r_e, *reference.velocities, *reference.forces)
    return errors, tracking_forces(observation, vehicle, gains, ARRAYS)


def closed_loop_response(
    starts: Array,
    path: Circle,
    vehicle: Vehicle,
    gains: Gains,
    times: Array,
    method: str = "DOP853",
    rtol: float = 1e-12,
    atol: float = 1e-14,
) -> Response:
    """Return the response of the closed loop from rest.

    Args:
        starts: initial errors x_e, y_e [m], psi_e [rad], shape (3, N).
        path: the circle to follow.
        vehicle: the vehicle, known exactly.
        gains: gains of the law.
        times: sampling times [s], increasing from 0, shape (T,).
        method: integrator of `scipy.integrate.solve_ivp`, which integrates all starts together.
        rtol: relative tolerance of the integrator.
        atol: absolute tolerance of the integrator.
    """
    reference = SteadyCircle.of(path, vehicle)
    n = starts.shape[1]
    pose = np.array([float(value) for value in reference.state(np.zeros(()))[:3]])
    initial = np.concatenate((pose[:, None] + starts, np.zeros((3, n))))

    def rates(t: float, flat: Array) -> Array:
        state = cast(State, tuple(flat.reshape(6, n)))
        _, (F_u, F_r) = feedback(state, reference, np.asarray(t), vehicle, gains)
        return np.concatenate(state_rates(state, (F_u, 0.0, F_r), vehicle.coefficients, ns=np))

    span = (float(times[0]), float(times[-1]))
    solution = solve_ivp(rates, span, initial.ravel(), method, times, rtol=rtol, atol=atol)
    state = solution.y.reshape(6, n, len(times))
    errors, force = feedback(cast(State, tuple(state)), reference, times, vehicle, gains)
    return Response(times, state, np.stack(reference.state(times)[:2]), np.stack(errors), np.stack(force))


def last_outside(t: Array, error: Array, bound: float) -> float:
    """Return the last time [s] at which |error| exceeds the bound; 0 if it never does. Shapes (T,)."""
    outside = np.flatnonzero(np.abs(error) > bound)
    return float(t[outside[-1]]) if len(outside) else 0.0
