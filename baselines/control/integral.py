"""The tracking law with integral action on the position error, against a constant current or load.

The law (21), (22), (34), (40), (47) uses e + diag(surge, 1) R(psi)^T xi instead of its position error e, with
xi' = rate R(psi) e. The integral xi is constant in the world, as a steady current is: it is an internal model of the
disturbance. On a straight line the steady-state error is zero, in a slow turn it is small; the law alone has an offset.
A current along the vehicle requires little additional thrust, but the same current across it requires a crab angle.
This is why surge has a smaller share of the integral.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from auv_gym.physics.errors import to_body, to_world
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.vehicle import Vehicle
from auv_gym.task.observation import Observation
from baselines.control.backstepping import LAW_GAINS, Gains, bounded_error, tracking_forces
from baselines.policy import Memory, reference_speed

_INTEGRAL = ("rate", "horizon", "surge")
"""Rate of the integral [1/s]; bound of error and integral as a travel time of the reference [s]; share of surge [1]."""
INTEGRAL_GAINS = (*LAW_GAINS, "reference_speed", *_INTEGRAL)
"""Names of the gains: those of the speed-normalised law, and those of the integral."""


class IntegralLaw:
    """The tracking law with integral action, a `Controller`; its memory is xi, shape (N, 2) [m]."""

    def __init__(self, gains: Mapping[str, float], vehicle: Vehicle) -> None:
        """Make the law; the names of its gains are `INTEGRAL_GAINS`."""
        self.gains = Gains(**{name: value for name, value in gains.items() if name not in _INTEGRAL})
        self.rate, self.horizon, self.surge = (gains[name] for name in _INTEGRAL)
        self.vehicle = vehicle

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return (np.zeros((n, 2)),)

    def forces(self, o: Observation, memory: Memory, extra: Array) -> tuple[Array, Array, Memory]:
        """Return F_u [N], F_r [N m], shape (N,), and the memory for the next call."""
        (past_xi,) = memory
        xi = next_integral(past_xi.T, o, self.rate, self.horizon)
        eta_x, eta_y = in_body_frame(xi, o)
        e_x, e_y, *rest = bounded_error(o, self.horizon, ARRAYS)
        F_u, F_r = tracking_forces((e_x + self.surge * eta_x, e_y + eta_y, *rest), self.vehicle, self.gains, ARRAYS)
        return F_u, F_r, (xi.T,)


def next_integral(xi: Array, o: Observation, rate: float, horizon: float) -> Array:
    """Return xi, shape (2, N) [m], one control period later: xi' = rate R(psi) e, in the world frame.

    There are three measures against windup: e is the bounded error, see `backstepping.bounded_error`; |xi| has the same
    bound, the distance that the reference travels in `horizon` [s]; and xi is constant while an actuator is at its
    limit.

    Args:
        xi: the integral so far, shape (2, N).
        o: the observation, fields of shape (N,).
        rate: [1/s].
        horizon: [s].
    """
    e_x, e_y, *_ = bounded_error(o, horizon, ARRAYS)
    free = (np.abs(o.a_u) < 1.0) & (np.abs(o.a_r) < 1.0)
    total: Array = xi + rate * o.dt * free * np.array(to_world(e_x, e_y, o.cos_psi, o.sin_psi))
    bound = horizon * reference_speed(o.u_R, o.v_R, ARRAYS)
    bounded: Array = total * np.minimum(1.0, bound / np.maximum(np.hypot(*total), math.ulp(1.0)))
    return bounded


def in_body_frame(xi: Array, o: Observation) -> Array:
    """Return R(psi)^T xi, shape (2, N) [m]."""
    x, y = xi
    return np.array(to_body(x, y, o.cos_psi, o.sin_psi))
