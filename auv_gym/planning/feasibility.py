"""Feasibility conditions of a reference for an underactuated vehicle."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.effects.actuators import fin_share
from auv_gym.physics.namespaces import ARRAYS, Array, Namespace, Number, wrap_angle
from auv_gym.physics.vehicle import Coefficients, Vehicle
from auv_gym.planning.sideslip import MAX_SIDESLIP

MIN_SPEED = 1e-3  # [m/s] smallest speed of a path


class InfeasibleReferenceError(ValueError):
    """The vehicle cannot follow the reference.

    Attributes:
        condition: the violated condition, in words and numbers.
        time: the first time at which it is violated [s].
        place: the position at that time, (x, y) or (x, y, z) [m].
    """

    def __init__(self, condition: str, time: float, place: tuple[float, ...]) -> None:
        names, numbers = ", ".join("xyz"[: len(place)]), ", ".join(f"{x:.6g}" for x in place)
        super().__init__(f"infeasible at t = {time:.6g} s, ({names}) = ({numbers}) m: {condition}")
        self.condition, self.time, self.place = condition, time, place

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.condition, self.time, self.place)  # for pickle


def check_feasible(valid: NDArray[np.bool_], condition: Callable[[int], str], times: Array, positions: Array) -> None:
    """Raise InfeasibleReferenceError for the first time at which `valid`, shape (T,), is False."""
    if not valid.all():
        k = int(np.argmin(valid))
        raise InfeasibleReferenceError(condition(k), float(times[k]), tuple(float(row[k]) for row in positions))


def moving(v_p: Number) -> Number:
    """Return whether a speed [m/s] is at least `MIN_SPEED`."""
    return v_p >= MIN_SPEED


def gradual(turn: Number, ns: Namespace) -> Number:
    """Return whether the change of direction [rad] between two samples is below 90 degrees."""
    return abs(wrap_angle(turn, ns)) < 0.5 * math.pi


def braking(v_p: Number, v_p_dot: Number, c: Vehicle | Coefficients) -> tuple[Number, Number]:
    """Return the relative deceleration [1/s] of a path and its limit, below which the sideslip equation is stable."""
    return -v_p_dot / v_p, (c.d22 + c.Y_uv * v_p) / c.m22


def sideslip_allowed(w: Number) -> Number:
    """Return whether a sideslip is below `MAX_SIDESLIP`, for its sine."""
    return abs(w) < math.sin(MAX_SIDESLIP)


def torque_limit(u: Number, limits: Sequence[Number], ns: Namespace) -> Number:
    """Return the largest torque [N m] at a surge speed [m/s], for the limits F_u_max [N], F_r_max [N m], fin [kg]."""
    _, F_r_max, fin = limits
    return F_r_max * fin_share(u, fin, F_r_max, ns)


def check_rates(v_p: Array, beta: Array, v_p_dot: Array, vehicle: Vehicle, times: Array, positions: Array) -> None:
    """Raise InfeasibleReferenceError where the speed passes through zero or the deceleration exceeds its limit.

    The limit is that of linear drag and lift. A vehicle with cross terms has no such limit: its sideslip is checked.
    """
    check_moving(v_p, gradual(np.diff(beta, prepend=beta[:1]), ARRAYS), times, positions)
    if not vehicle.has_cross_terms:
        check_braking(v_p, v_p_dot, vehicle, times, positions)


def check_moving(v_p: Array, is_gradual: NDArray[np.bool_], times: Array, positions: Array) -> None:
    """Raise InfeasibleReferenceError where the speed passes through zero or the direction is not `gradual`."""
    check_feasible(moving(v_p), lambda k: f"the path stops, v_p = {v_p[k]:.3g} m/s", times, positions)
    sharp = "the path turns by more than 90 degrees within one sample: it reverses, or its points are noisy"
    check_feasible(is_gradual, lambda _: sharp, times, positions)


def check_braking(v_p: Array, v_p_dot: Array, vehicle: Vehicle, times: Array, positions: Array) -> None:
    """Raise InfeasibleReferenceError where the deceleration exceeds the limit of linear drag and lift."""
    rate, limit = braking(v_p, v_p_dot, vehicle)
    drag = "(d22 + Y_uv v_p)/m22" if vehicle.Y_uv else "d22/m22"

    def condition(k: int) -> str:
        return f"braking -v_p'/v_p = {rate[k]:.4g} 1/s is not below {drag} = {limit[k]:.4g} 1/s"

    check_feasible(rate < limit, condition, times, positions)


def check_sideslip(w: Array, times: Array, positions: Array) -> None:
    """Raise InfeasibleReferenceError where the sideslip exceeds `MAX_SIDESLIP`, for its sine."""
    limit = f"{math.degrees(MAX_SIDESLIP):.0f} degrees"
    condition = f"the sideslip exceeds {limit}, the path turns too fast for the sway drag"
    check_feasible(sideslip_allowed(w), lambda _: condition, times, positions)


def check_forces(F_u: Array, F_r: Array, u: Array, limits: Sequence[float], times: Array, positions: Array) -> None:
    """Raise InfeasibleReferenceError where the open-loop forces exceed their limits, see `torque_limit`."""
    check_force("F_u", "N", F_u, np.full_like(u, limits[0]), times, positions)
    check_force("F_r", "N m", F_r, torque_limit(u, limits, ARRAYS), times, positions)


def check_force(name: str, unit: str, force: Array, limit: Array, times: Array, positions: Array) -> None:
    """Raise InfeasibleReferenceError where a force exceeds its limit, which may be one number."""
    most = np.broadcast_to(limit, force.shape)

    def condition(k: int) -> str:
        return f"{name} = {force[k]:.4g} {unit} is beyond its limit of {most[k]:.4g} {unit}"

    check_feasible(np.abs(force) <= most, condition, times, positions)


PLANE_TERMS = ("u_R", "m/s"), ("v_R", "m/s"), ("r_R", "rad/s"), ("F_uR", "N"), ("F_rR", "N m")
"""Name and unit of each column of a reference in the plane that is bounded."""


def check_bounds(columns: Array, most: Sequence[float], terms: Sequence[tuple[str, str]] = PLANE_TERMS) -> None:
    """Raise ValueError if a velocity or force of a reference, shape (T, terms), exceeds its bound."""
    for (name, unit), value, bound in zip(terms, np.abs(columns).max(axis=0).tolist(), most, strict=True):
        if not value <= bound:
            raise ValueError(f"reference {name} reaches {value:.4g} {unit}; it must be at most {bound:g} {unit}")
