"""The contents of a picture, and the camera."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from auv_gym.physics.namespaces import Array
from auv_gym.rendering.canvas import ARROW_LENGTH, ARROW_MEMORY, CAMERA_TIME, NEAR_EXTENT


class View(NamedTuple):
    """The contents of a picture in SI units. All numbers are finite; the limits are positive and may be infinite."""

    time: float  # [s]; a smaller one than before begins a new episode
    state: tuple[float, float, float, float, float, float]  # x, y [m], psi [rad], u, v [m/s] over ground, r [rad/s]
    reference: tuple[float, float, float]  # x, y [m], psi [rad]
    path: Array  # (n, 2) [m] positions of the reference in order of time
    travelled: int  # index of the present reference in the path
    trail: Array  # (m, 2) [m] past positions, oldest first
    current: tuple[float, float]  # V_x, V_y [m/s] in the world
    force: tuple[float, ...]  # F_u [N], F_r [N m] of the actuators; in space F_u, F_q, F_r
    force_limits: tuple[float, ...]  # of the same
    position_error: float  # [m]
    title: str  # name of the scenario


def elapsed_between(last: View | None, view: View) -> float:
    """Return the time since the last picture [s]; inf for a first picture and for a new episode."""
    if last is None or view.time < last.time:
        return math.inf
    moved = (*view.state, *view.reference) != (*last.state, *last.reference)
    return math.inf if moved and view.time == last.time else view.time - last.time


class Camera:
    """The map from the world [m] to the picture [units]; it follows vehicle and reference smoothly."""

    def __init__(self, extent: Array) -> None:
        self.extent = extent  # (2,) width and height [units]
        self.center = np.zeros(2)  # [m]
        self.scale = 1.0  # [units/m]
        self.unit_speed = 0.0  # [m/s] of an arrow of length `ARROW_LENGTH`
        self._offset = np.zeros(2)  # [m] from the vehicle to the centre
        self._log_extent = 0.0  # log of half the picture's height [m]

    def update(self, view: View, elapsed: float) -> None:
        """Move the camera to a view that is `elapsed` [s] after the last one; without smoothing if it is inf."""
        gain = 1.0 - math.exp(-elapsed / CAMERA_TIME)
        vehicle, reference = np.array(view.state[:2]), np.array(view.reference[:2])
        gap = reference - vehicle
        self._offset = self._offset + gain * (0.5 * gap - self._offset)
        self.center = vehicle + self._offset
        wanted = math.log(max(NEAR_EXTENT, float(np.hypot(*gap))))
        self._log_extent += gain * (wanted - self._log_extent)
        farthest = max(np.hypot(*self._offset), np.hypot(*(gap - self._offset)))
        half_height = max(math.exp(self._log_extent), 1.3 * float(farthest))  # both are always in the picture
        self.scale = 0.5 * float(self.extent.min()) / half_height
        recent = self.unit_speed * math.exp(-elapsed / ARROW_MEMORY)
        self.unit_speed = max(math.hypot(*view.state[3:5]), math.hypot(*view.current), recent, 0.02)

    def look(self, center: tuple[float, float], half_height: float, unit_speed: float) -> None:
        """Set the centre [m], half the height of the picture [m], and the speed of an arrow of full length [m/s]."""
        self.center = np.array(center)
        self.scale = 0.5 * float(self.extent.min()) / half_height
        self.unit_speed = unit_speed

    def project(self, points: ArrayLike) -> Array:
        """Return points in the world, (..., 2) [m], as points in the picture, (..., 2) [units], y downwards."""
        offset: Array = (np.asarray(points, dtype=np.float64) - self.center) * self.scale
        return 0.5 * self.extent + offset * (1.0, -1.0)

    def arrow(self, velocity: ArrayLike) -> Array:
        """Return a velocity (2,) [m/s] as an arrow (2,) [units]."""
        return np.asarray(velocity, dtype=np.float64) * (1.0, -1.0) * ARROW_LENGTH / self.unit_speed

    def lattice(self, axis: int, spacing: float) -> NDArray[np.int64]:
        """Return the integers whose multiples of `spacing` [m] are visible along an axis."""
        half = 0.5 * self.extent[axis] / self.scale
        low, high = (self.center[axis] - half) / spacing, (self.center[axis] + half) / spacing
        return np.arange(math.floor(low), math.ceil(high) + 1, dtype=np.int64)
