"""Motion in space as motion in two planes, which are drawn like any other: from above and from the side."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.space import axes


class Plane(NamedTuple):
    """States of a vehicle at K times in a plane, and the whole reference."""

    states: Array  # (K, 6) x, y [m], psi [rad], u, v [m/s] over ground, r [rad/s]
    path: Array  # (n, 3) x, y [m], psi [rad] of the reference
    vectors: Array  # (K, 2) of the world


def two_planes(states: Array, path: Array, vectors: Array, first: int = 0) -> tuple[Plane, Plane]:
    """Return motion in space as seen from above and from the side.

    The side has as x the horizontal length of the reference's way, for a vehicle plus its error along the way; y is the
    height above the surface, and psi the pitch, positive nose up.

    Args:
        states: x, y, z [m], theta, psi [rad], u, v, w [m/s] over ground, q, r [rad/s], shape (K, 10).
        path: x, y, z [m], theta, psi [rad] of the reference at all n times, shape (n, 5).
        vectors: of the world, such as currents, shape (K, 3) or (1, 3).
        first: index of the first state's time in the path.
    """
    x, y, z, theta, psi, u, v, w, q, r = states.T
    x_R, y_R, z_R, theta_R, psi_R = path.T
    length = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(x_R), np.diff(y_R)))))
    way = np.gradient(path[:, :2], axis=0)
    way /= np.maximum(np.hypot(*way.T), 1e-12)[:, None]
    now = slice(first, first + len(states))
    ahead, port, up = axes(theta, psi, ARRAYS)
    x_dot, y_dot, z_dot = (a * u + b * v + c * w for a, b, c in zip(ahead, port, up, strict=True))

    def along(a: Array, b: Array) -> Array:
        return np.asarray(way[now, 0] * a + way[now, 1] * b)

    V_x, V_y, V_z = np.broadcast_to(vectors, (len(states), 3)).T
    flat = to_body(x_dot, y_dot, np.cos(psi), np.sin(psi))
    steep = to_body(along(x_dot, y_dot), z_dot, np.cos(theta), -np.sin(theta))
    s = length[now] + along(x - x_R[now], y - y_R[now])
    above = Plane(_rows(x, y, psi, *flat, r), _rows(x_R, y_R, psi_R), _rows(V_x, V_y))
    side = Plane(_rows(s, z, -theta, *steep, -q), _rows(length, z_R, -theta_R), _rows(along(V_x, V_y), V_z))
    return above, side


def _rows(*columns: Array) -> Array:
    return np.stack(columns, axis=1)
