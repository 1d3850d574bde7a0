"""Integral of the position error, kept in the world frame, which a constant current is constant in."""

from __future__ import annotations

import math

import numpy as np

from auv_gym.physics.errors import to_body, to_world
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.task.observation import Observation
from baselines.control.backstepping import bounded_error
from baselines.policy import reference_speed


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
