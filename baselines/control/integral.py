"""The tracking law with integral action: what a constant current or load leaves of the position error is integrated.

The law (21), (22), (34), (40), (47) gets e + diag(surge, 1) R(psi)^T xi in place of its position error e, where
xi' = rate R(psi) e. In the body frame xi is the internal model of what is constant in the world, as a current is: on a
straight line the error vanishes, where the law alone keeps an offset, and in a slow turn it almost does. A current
along the hull takes a little thrust, the same current across it a whole crab angle: hence the smaller share of surge.
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

INTEGRAL_GAINS = ("rate", "horizon", "surge")
"""[1/s] of the integral; [s] bound of error and integral as a travel time of the reference; [1] share of surge."""
PRINTED_GAINS = (*LAW_GAINS, *INTEGRAL_GAINS)  # names of the gains of the law as printed
NORMALISED_GAINS = (*LAW_GAINS, "reference_speed", *INTEGRAL_GAINS)  # of the law normalised with the speed


class IntegralLaw:
    """The tracking law with integral action, a `Controller`; its memory is xi, shape (N, 2) [m]."""

    def __init__(self, gains: Mapping[str, float], vehicle: Vehicle) -> None:
        """Make the law; with a gain `reference_speed` in its speed-normalised form."""
        law = {name: value for name, value in gains.items() if name not in INTEGRAL_GAINS}
        self.gains = Gains(**law)
        self.rate, self.horizon, self.surge = (gains[name] for name in INTEGRAL_GAINS)
        self.vehicle = vehicle

    def start(self, n: int) -> Memory:
        """Return the memory at the start of n episodes."""
        return (np.zeros((n, 2)),)

    def forces(self, o: Observation, memory: Memory, extra: Array) -> tuple[Array, Array, Memory]:
        """Return F_u [N], F_r [N m], shape (N,), and the memory to hand in next."""
        (past_xi,) = memory
        xi = integrated(past_xi.T, o, self.rate, self.horizon)
        eta_x, eta_y = seen_from_body(xi, o)
        e_x, e_y, *rest = bounded_error(o, self.horizon, ARRAYS)
        F_u, F_r = tracking_forces((e_x + self.surge * eta_x, e_y + eta_y, *rest), self.vehicle, self.gains, ARRAYS)
        return F_u, F_r, (xi.T,)


def integrated(xi: Array, o: Observation, rate: float, horizon: float) -> Array:
    """Return xi, shape (2, N) [m], one control period later: xi' = rate R(psi) e, in the world frame.

    Against windup: the error e is the bounded one, see `backstepping.bounded_error`; xi stays in the same bound, the
    distance that the reference travels in `horizon` [s]; and xi is held while an actuator is at its limit.

    Args:
        xi: the integral so far, shape (2, N).
        o: the observation, fields of shape (N,).
        rate: [1/s].
        horizon: [s].
    """
    e_x, e_y, *_ = bounded_error(o, horizon, ARRAYS)
    moves = (np.abs(o.a_u) < 1.0) & (np.abs(o.a_r) < 1.0)
    grown: Array = xi + rate * o.dt * moves * np.array(to_world(e_x, e_y, o.cos_psi, o.sin_psi))
    bound = horizon * reference_speed(o.u_R, o.v_R, ARRAYS)
    shrunk: Array = grown * np.minimum(1.0, bound / np.maximum(np.hypot(*grown), math.ulp(1.0)))
    return shrunk


def seen_from_body(xi: Array, o: Observation) -> Array:
    """Return R(psi)^T xi, shape (2, N) [m]."""
    x, y = xi
    return np.array(to_body(x, y, o.cos_psi, o.sin_psi))
