"""Gain-scheduled linear-quadratic control with integral action and an assumed actuator lag (LQI).

The error dynamics in the body frame are linearised about steady motion at (u_R, r_R). The position error is integrated
in the world frame, and the integral is rotated into the body frame. In this form the model is time-invariant, and one
Riccati equation gives the gain of a steady motion. Gains are computed once on a grid of speeds and turn rates and then
interpolated. H. Kwakernaak and R. Sivan, Linear Optimal Control Systems, 1972, sections 3.7 and 6.4; T. I. Fossen,
Handbook of Marine Craft Hydrodynamics and Motion Control, 2nd ed., 2021, section 16.1.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.vehicle import Vehicle
from auv_gym.task.observation import Observation
from baselines.control.backstepping import bounded_error
from baselines.control.integral import in_body_frame, next_integral
from baselines.control.linearisation import error_dynamics
from baselines.policy import Memory, first_order

if TYPE_CHECKING:  # SciPy is imported in the functions that use it, so that other policies load quickly
    from scipy.interpolate import RegularGridInterpolator

_SPEEDS = np.geomspace(0.05, 2.5, 14)  # [m/s] u_R of the grid of gains; outside of it the gain at its edge is used
_TURN_RATES = np.linspace(-0.18, 0.18, 7)  # [rad/s] r_R of the grid of gains

PREFERRED = np.array([float(f"{m}e{e}") for e in range(-4, 10) for m in (1, 1.25, 1.6, 2, 2.5, 3.15, 4, 5, 6.3, 8)])
"""Limits of actuators [N], [N m] for which gains are designed, the series R10 of ISO 3. The torque limit of fins varies
with the speed; rounding keeps the number of designs small."""

_STATES, _FORCES = 8, 2  # number of errors and integrals, number of forces
_INTEGRALS = slice(6, 8)  # behind e_x, e_y, psi_e, u_e, v_e, r_e
_POSITION, _VELOCITY, _HEADING_AND_VELOCITY = slice(0, 2), slice(3, 5), slice(2, 5)
_HEADING, _TURN = 2, 5


class LqiWeights(NamedTuple):
    """Weights of the cost rate, and assumptions about the actuators.

    The cost rate is |e|^2 + |xi|^2 + velocity^2 |R(psi) e'|^2 + (heading U psi_e)^2 + (turn r_e)^2, plus
    (effort a)^2 + (rate a')^2 for surge and for yaw. Here e [m] is the position error, e' its rate in the world, xi [m]
    its integral, U the speed, and a the command as a fraction of the actuator's limit (Bryson's rule).
    """

    velocity: float  # [s]
    heading: float  # [1]
    turn: float  # [m s]
    surge_effort: float  # [m]
    surge_rate: float  # [m s]
    yaw_effort: float  # [m]
    yaw_rate: float  # [m s]
    lag: float  # [s] assumed time constant of the actuators
    rate: float  # [1/s] of the integral, see `integral.next_integral`
    horizon: float  # [s] bound of error and integral as a travel time of the reference


def steady_sway(u_R: float, r_R: float, vehicle: Vehicle) -> float:
    """Return v_R [m/s] of a steady turn with linear drag, (5)."""
    return -vehicle.m11 * u_R * r_R / vehicle.d22


def sampled_model(u_R: float, r_R: float, vehicle: Vehicle, w: LqiWeights, dt: float) -> tuple[Array, Array]:
    """Return Phi (12, 12), Gamma (12, 2) of one control period with a constant command.

    The states are the six errors, xi in the body frame (2), the lagged forces (2) and the previous command (2).
    """
    A, B = error_dynamics(vehicle, u_R, steady_sway(u_R, r_R, vehicle), r_R)
    return sampled(A, B, np.array([[0.0, r_R], [-r_R, 0.0]]), w, dt)


def sampled(A: Array, B: Array, turning: Array, w: LqiWeights, dt: float) -> tuple[Array, Array]:
    """Return Phi, Gamma of one control period with a constant command, for any number of errors and actuators.

    The states are the errors, of which those of the position are the first, xi in the body frame, the lagged forces and
    the previous command.

    Args:
        A: error dynamics, shape (errors, errors).
        B: the same for the forces, shape (errors, forces).
        turning: matrix of xi' by xi, as the body frame turns, shape (axes, axes).
        w: the weights.
        dt: control period [s].
    """
    from scipy.linalg import expm

    (errors, forces), axes = B.shape, len(turning)
    states, n = errors + axes, errors + axes + forces
    M = np.zeros((n + forces, n + forces))  # continuous-time model without the previous command, and of the command
    M[:errors, :errors], M[:errors, states:n] = A, B
    M[errors:states, errors:states] = turning
    M[errors:states, :axes] = w.rate * np.eye(axes)  # xi' = rate R e in the world
    M[states:n, states:n], M[states:n, n:] = -np.eye(forces) / w.lag, np.eye(forces) / w.lag
    step = expm(dt * M)
    Phi, Gamma = np.zeros((n + forces, n + forces)), np.zeros((n + forces, forces))
    Phi[:n, :n], Gamma[:n], Gamma[n:] = step[:n, :n], step[:n, n:], np.eye(forces)
    return Phi, Gamma


def optimal_gain(
    u_R: float, r_R: float, vehicle: Vehicle, w: LqiWeights, dt: float, limits: tuple[float, float]
) -> Array:
    """Return K (2, 12) of command = -K z that minimises the cost of `LqiWeights`, z as in `sampled_model`.

    Args:
        u_R: [m/s].
        r_R: [rad/s].
        vehicle: the nominal one.
        w: the weights.
        dt: control period [s].
        limits: of the actuators, F_u [N] and F_r [N m].
    """
    Phi, Gamma = sampled_model(u_R, r_R, vehicle, w, dt)
    v_R = steady_sway(u_R, r_R, vehicle)
    weighted = np.zeros((_STATES, _STATES))  # errors times the roots of their weights
    weighted[_POSITION, _POSITION] = weighted[_INTEGRALS, _INTEGRALS] = np.eye(2)
    weighted[_HEADING, _HEADING], weighted[_TURN, _TURN] = w.heading * np.hypot(u_R, v_R), w.turn
    weighted[_VELOCITY, _HEADING_AND_VELOCITY] = w.velocity * np.array(
        [[-v_R, 1.0, 0.0], [u_R, 0.0, 1.0]]
    )  # (17), linearised
    return least_cost_gain(Phi, Gamma, weighted, w, dt, limits)


def least_cost_gain(
    Phi: Array, Gamma: Array, weighted: Array, w: LqiWeights, dt: float, limits: tuple[float, ...]
) -> Array:
    """Return K of command = -K z that minimises the cost of `LqiWeights`, for Phi, Gamma and z of `sampled`.

    Args:
        Phi: see `sampled`.
        Gamma: see `sampled`.
        weighted: matrix that multiplies errors and xi by the roots of their weights.
        w: the weights; each moment has those of yaw.
        dt: control period [s].
        limits: of the actuators, F_u [N], then the moments [N m].
    """
    from scipy.linalg import block_diag, solve_discrete_are

    forces, moments = len(limits), len(limits) - 1
    effort = np.diag(np.square(np.array([w.surge_effort, *[w.yaw_effort] * moments]) / limits))
    change = np.diag(np.square(np.array([w.surge_rate, *[w.yaw_rate] * moments]) / limits / dt))
    Q = block_diag(weighted.T @ weighted, np.zeros((forces, forces)), change)
    cross = np.vstack((np.zeros((len(weighted) + forces, forces)), -change))
    R = effort + change
    P = solve_discrete_are(Phi, Gamma, Q, R, s=cross)
    return np.asarray(np.linalg.solve(R + Gamma.T @ P @ Gamma, Gamma.T @ P @ Phi + cross.T))


def preferred(limits: Array) -> Array:
    """Return for each limit the number of `PREFERRED` with the nearest ratio; they differ by at most 13 %."""
    return PREFERRED[np.searchsorted(np.sqrt(PREFERRED[1:] * PREFERRED[:-1]), limits)]


@lru_cache(maxsize=64)
def gain_schedule(vehicle: Vehicle, w: LqiWeights, dt: float, limits: tuple[float, float]) -> RegularGridInterpolator:
    """Return K (N, 2, 12) as a function of points (N, 2) of u_R, r_R inside the grid; arguments as `optimal_gain`."""
    from scipy.interpolate import RegularGridInterpolator

    gains = [[optimal_gain(u, r, vehicle, w, dt, limits) for r in _TURN_RATES.tolist()] for u in _SPEEDS.tolist()]
    return RegularGridInterpolator((_SPEEDS, _TURN_RATES), np.array(gains))


class LQI:
    """Linear-quadratic control, a `Controller`; its memory is xi (N, 2) [m] and the lagged forces (N, 2) [N], [N m]."""

    def __init__(self, gains: Mapping[str, float], vehicle: Vehicle) -> None:
        """Make the controller; its gains are the fields of `LqiWeights`."""
        self.weights = LqiWeights(**gains)
        self.vehicle = vehicle

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return np.zeros((n, 2)), np.zeros((n, 2))

    def forces(self, o: Observation, memory: Memory, extra: Array) -> tuple[Array, Array, Memory]:
        """Return F_u [N], F_r [N m], shape (N,), and the memory for the next call."""
        w = self.weights
        past_xi, past_lagged = memory
        xi = next_integral(past_xi.T, o, w.rate, w.horizon)
        plan = np.array((o.F_uR, o.F_rR))
        previous = np.array((o.a_u * o.F_u_max, o.a_r * o.F_r_max))
        lagged = past_lagged.T + first_order(o.dt, w.lag) * (previous - past_lagged.T)
        e_x, e_y, psi_e, u_e, v_e, r_e, *_ = bounded_error(o, w.horizon, ARRAYS)
        z = np.array((e_x, e_y, psi_e, u_e, v_e, r_e, *in_body_frame(xi, o), *(lagged - plan), *(previous - plan)))
        F_u, F_r = plan - np.einsum("nij,jn->in", self._gain(o), z)
        return F_u, F_r, (xi.T, lagged.T)

    def _gain(self, o: Observation) -> Array:
        """Return K for each vehicle, shape (N, 2, 12); NaN if no gain exists for its limits and control period."""
        points = np.stack((o.u_R, o.r_R), axis=1)
        points = np.clip(points, (_SPEEDS[0], _TURN_RATES[0]), (_SPEEDS[-1], _TURN_RATES[-1]))
        K = np.full((len(points), _FORCES, _STATES + 2 * _FORCES), np.nan)
        designs = np.stack((o.dt, preferred(o.F_u_max), preferred(o.F_r_max)), axis=1)
        for dt, *limits in np.unique(designs, axis=0).tolist():
            rows = (designs == (dt, *limits)).all(axis=1)
            with suppress(ValueError, np.linalg.LinAlgError), np.errstate(all="ignore"):
                K[rows] = gain_schedule(self.vehicle, self.weights, dt, (limits[0], limits[1]))(points[rows])
        return K
