"""The integral of the position error in space, as `baselines.control.integral` in the plane."""

from __future__ import annotations

import math

import numpy as np

from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.task.space import Observation, in_world
from baselines.space.backstepping import bounded_error, squared, wanted


def speed(o: Observation) -> Array:
    """Return the speed [m/s] of the reference, shape (N,)."""
    return np.asarray(ARRAYS.sqrt(squared(wanted(o), ARRAYS)))


def bounded(o: Observation, horizon: float) -> Array:
    """Return the bounded position error in the body frame, shape (3, N) [m], see `backstepping.bounded_error`."""
    return np.array(bounded_error(o[:10], wanted(o), horizon, ARRAYS)[:3])


def next_integral(xi: Array, o: Observation, rate: float, horizon: float) -> Array:
    """Return xi, shape (3, N) [m], one control period later, with the measures against windup of the plane."""
    free = (np.abs(o.a_u) < 1.0) & (np.abs(o.a_q) < 1.0) & (np.abs(o.a_r) < 1.0)
    e = bounded(o, horizon)
    total: Array = xi + rate * o.dt * free * np.array(in_world(e, o))
    size = np.sqrt((total * total).sum(axis=0))
    shrunk: Array = total * np.minimum(1.0, horizon * speed(o) / np.maximum(size, math.ulp(1.0)))
    return shrunk
