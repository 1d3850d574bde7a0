"""What an underactuated vehicle cannot follow, and where."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import ARRAYS, Array, wrap_angle
from auv_gym.physics.vehicle import Vehicle

MIN_SPEED = 1e-3  # [m/s] below this a path counts as standing still


class InfeasibleReferenceError(ValueError):
    """An underactuated vehicle of these parameters cannot follow the path on time.

    Attributes:
        condition: what is violated, in words and numbers.
        time: when it is first violated [s].
        place: where, (x, y) [m].
    """

    def __init__(self, condition: str, time: float, place: tuple[float, float]) -> None:
        super().__init__(f"infeasible at t = {time:.6g} s, (x, y) = ({place[0]:.6g}, {place[1]:.6g}) m: {condition}")
        self.condition, self.time, self.place = condition, time, place

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.condition, self.time, self.place)  # as pickle needs it: on to another process


Index = tuple[int, ...]


def check_feasible(valid: NDArray[np.bool_], condition: Callable[[Index], str], times: Array, positions: Array) -> None:
    """Raise InfeasibleReferenceError for the first time at which `valid`, shape (T,) or (T, N), does not hold."""
    if not valid.all():
        index = tuple(int(i) for i in np.argwhere(~valid)[0])
        x, y = (float(row[index]) for row in positions)
        raise InfeasibleReferenceError(condition(index), float(times[index[0]]), (x, y))


def check_rates(v_p: Array, beta: Array, v_p_dot: Array, vehicle: Vehicle, times: Array, positions: Array) -> None:
    """Raise InfeasibleReferenceError where a path stands still, turns on the spot, or brakes faster than drag can."""
    moving = v_p >= MIN_SPEED
    moving[1:] &= np.abs(wrap_angle(np.diff(beta, axis=0), ARRAYS)) < 0.5 * math.pi  # no turn on the spot
    check_feasible(moving, lambda k: f"the speed passes through zero, here v_p = {v_p[k]:.3g} m/s", times, positions)
    braking = -v_p_dot / v_p
    limit = (vehicle.d22 + vehicle.Y_uv * v_p) / vehicle.m22
    drag = "(d22 + Y_uv v_p)/m22" if vehicle.Y_uv else "d22/m22"

    def says(k: Index) -> str:
        return f"braking -v_p'/v_p = {braking[k]:.4g} 1/s is not below {drag} = {limit[k]:.4g} 1/s"

    check_feasible(braking < limit, says, times, positions)


def check_forces(F_u: Array, F_r: Array, limits: tuple[float, float | Array], times: Array, positions: Array) -> None:
    """Raise InfeasibleReferenceError where the open-loop forces exceed their limits, which may change with time."""
    for name, unit, force, limit in (("F_u", "N", F_u, limits[0]), ("F_r", "N m", F_r, limits[1])):
        most = np.broadcast_to(limit, force.shape)

        def says(k: Index, name: str = name, unit: str = unit, force: Array = force, most: Array = most) -> str:
            return f"{name} = {force[k]:.4g} {unit} is beyond its limit of {most[k]:.4g} {unit}"

        check_feasible(np.abs(force) <= most, says, times, positions)
