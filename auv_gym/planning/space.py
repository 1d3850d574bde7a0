"""The dynamically feasible reference of a path in space.

A vehicle without lateral thrusters cannot choose its axis on a path. The two lateral equations determine the turn rates
q and r at each instant: what acceleration across the axis the path needs is what the vehicle has, `state_rates` without
load. Newton's method finds them. They give two differential equations, theta' = q and psi' = r / cos(theta), which are
integrated with classical Runge-Kutta steps over two samples. For a level path of a body of revolution it is the
equation of the sideslip in the plane, see `auv_gym.planning.sideslip`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache, cached_property
from typing import Any, TypeVar

import numpy as np

from auv_gym.codegen.derivatives import directional
from auv_gym.codegen.graph import SYMBOLS, Symbol
from auv_gym.codegen.kernel import Kernel
from auv_gym.effects.space import MAX_PITCH
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.space import ROWS, SPACE_ROWS, Limits, SpaceVehicle, axes, state_rates
from auv_gym.planning.feasibility import (
    check_bounds,
    check_braking,
    check_feasible,
    check_force,
    check_moving,
    torque_limit,
)
from auv_gym.planning.paths.space import SpacePath
from auv_gym.planning.planner import MAX_SAMPLES, RUN_IN, checked_derivatives, checked_grid
from auv_gym.planning.sideslip import MAX_SIDESLIP

T = TypeVar("T")
_MAX_STEP = 0.1  # largest integration step, in time constants of the fastest transient
_CHOSEN = 64  # instants of the plan, at least, at which the time constants are computed
_SLOWEST = 10.0  # `Vehicle.time` that count as at most one time constant in the run-in
_FASTEST = 20.0  # largest rate of a transient per `Vehicle.time` that the step follows; faster ones are not feasible
_STAGE_ITERATIONS = 2  # of Newton's method in a stage, which starts at the turn rates of the stage before it
_LAST_ITERATIONS = 6  # of Newton's method at the times of the plan
_ITERATIONS = 20  # of Newton's method for the steady angles
_TOLERANCE = 1e-9  # largest residual of the balance [m/s^2], as a share of the accelerations of the vehicle
_NEGLIGIBLE = 1e-13  # [m/s^2] residual that is always allowed
_NO_LOAD = (0.0, 0.0, 0.0, 0.0, 0.0)
_LEVEL = 1e-3  # largest slope of a path that counts as level
_LARGEST_CHANGE = 0.1  # [rad] in one iteration for the steady angles: |v| v has hardly a slope at v = 0
_TOGETHER = 32  # paths that are integrated together, which bounds the memory
_BOUNDED = [
    (f"{name}_R", unit) for name, unit in (("u", "m/s"), ("v", "m/s"), ("w", "m/s"), ("q", "rad/s"), ("r", "rad/s"))
] + [("F_uR", "N"), ("F_qR", "N m"), ("F_rR", "N m")]
_PITCH_INERTIA = ROWS + 2  # index in `SpaceVehicle.acting`


@dataclass(frozen=True, eq=False)
class SpaceReference:
    """States and open-loop forces of the vehicle on its path, arrays of shape (T,), with the signs of `space.State`."""

    t: Array  # [s]
    x: Array  # [m]
    y: Array  # [m]
    z: Array  # [m]
    theta: Array  # [rad]
    psi: Array  # [rad] continuous in time
    u: Array  # [m/s]
    v: Array  # [m/s]
    w: Array  # [m/s]
    q: Array  # [rad/s]
    r: Array  # [rad/s]
    F_u: Array  # [N]
    F_q: Array  # [N m]
    F_r: Array  # [N m]

    @cached_property
    def table(self) -> Array:
        """x, y, z, theta, psi, u, v, w, q, r, F_u, F_q, F_r, shape (T, 13)."""
        _, *columns = fields(self)
        return np.stack([getattr(self, column.name) for column in columns], axis=1)


def plan(path: SpacePath, vehicle: SpaceVehicle, times: Array, limits: Limits | None = None) -> SpaceReference:
    """Return the reference with which the vehicle follows a path in space, in still water.

    Args:
        path: three times differentiable in time.
        vehicle: the vehicle.
        times: evenly spaced times [s], shape (T,), T >= 2, inside the path's domain.
        limits: of the actuators; None: unchecked.

    Raises:
        ValueError: the times are not an evenly spaced, increasing, finite grid inside the path's domain, the plan needs
            more than `MAX_SAMPLES` samples, or `path.derivatives` returns an array of another shape.
        InfeasibleReferenceError: the path stops or reverses, brakes faster than the drag of one plane allows, or climbs
            below the `reversal_speed` of the fins; no turn rates balance the lateral forces; the angle between axis and
            velocity exceeds `MAX_SIDESLIP`, or the pitch `MAX_PITCH`; the fins cannot hold the pitch, or a force is
            beyond its limit.
    """
    times = checked_grid(times, path)
    return SpacePlanner(vehicle, times, limits).plan(path)


class SpacePlanner:
    """Plans the references of paths at given times.

    Args:
        vehicle: see `plan`.
        times: see `plan`.
        limits: see `plan`.
        most: largest |u|, |v|, |w| [m/s], |q|, |r| [rad/s], |F_u| [N], |F_q|, |F_r| [N m] of a reference.
    """

    def __init__(
        self, vehicle: SpaceVehicle, times: Array, limits: Limits | None = None, most: Sequence[float] = ()
    ) -> None:
        self.vehicle, self.times, self._limits, self._most = vehicle, times, limits, most
        self._row = np.array(vehicle.acting)
        self._period = float(times[-1] - times[0]) / (len(times) - 1)

    def plan(self, path: SpacePath) -> SpaceReference:
        """Return the reference of a path; raises as `table`."""
        return SpaceReference(self.times, *self.table(path).T)

    def table(self, path: SpacePath, *, many: bool = True) -> Array:
        """Return the `SpaceReference.table` of a path, shape (T, 13).

        Raises:
            ValueError: see `plan`, or the reference exceeds `most`.
            InfeasibleReferenceError: see `plan`.
        """
        del many
        (planned,) = self._planned([path])
        if isinstance(planned, ValueError):
            raise planned
        return planned

    def tables(self, paths: Sequence[SpacePath]) -> list[Array | None]:
        """Return the `table` of each path, None if it raises an error; in less time than one by one."""
        tables: list[Array | None] = []
        for first in range(0, len(paths), _TOGETHER):
            planned = self._planned(paths[first : first + _TOGETHER])
            tables += [None if isinstance(table, ValueError) else table for table in planned]
        return tables

    def _planned(self, paths: Sequence[SpacePath]) -> list[Array | ValueError]:
        """Return the table of each path or its error. Paths with the same grid are integrated together."""
        done: dict[int, Array | ValueError] = {}
        grids: dict[tuple[int, int], list[int]] = {}
        for k, path in enumerate(paths):
            if isinstance(grid := _tried(self._grid, path), ValueError):
                done[k] = grid
            else:
                grids.setdefault(grid, []).append(k)
        for grid, members in grids.items():
            done |= zip(members, self._integrated([paths[k] for k in members], *grid), strict=True)
        return [done[k] for k in range(len(paths))]

    def _grid(self, path: SpacePath) -> tuple[int, int]:
        """Return the integration steps in a period, and those before the first time, for the transients on a path.

        Steps and run-in are rounded up to powers of two, so that few grids are in use.

        Raises:
            ValueError: the plan needs too many samples, or `path.derivatives` returns an array of another shape.
        """
        chosen = self.times[:: max(1, len(self.times) // _CHOSEN)]
        fast, slow = _rates(steady_axis(checked_derivatives(path, chosen, 3), self._row)[1])
        time, instants = self.vehicle.horizontal.time, len(self.times)
        substeps = _power(self._period * min(fast, _FASTEST / time) / _MAX_STEP)
        run_in = _power(RUN_IN * min(1 / slow, _SLOWEST * time) / self._period)
        lead = min(run_in * substeps, int(min(float(self.times[0] - path.start) / self._period, 1e9) * substeps))
        if (samples := 2 * (lead + (instants - 1) * substeps)) > MAX_SAMPLES:
            raise ValueError(
                f"the plan needs {samples} samples of the path; at most {MAX_SAMPLES} are allowed. Fewer times, or a "
                "vehicle with less drag for its inertia, need fewer"
            )
        return substeps, lead

    def _integrated(self, paths: Sequence[SpacePath], substeps: int, lead: int) -> list[Array | ValueError]:
        """Return the table of each path or its error, for the grid that the paths have."""
        times, h = self.times, self._period / substeps
        steps = lead + (len(times) - 1) * substeps
        samples: Array = times[0] + 0.5 * h * np.arange(-2 * lead, 2 * (steps - lead) + 1)
        samples[-1] = times[-1]  # exactly, since rounding could exceed the end of the path
        derivatives = np.stack([checked_derivatives(path, samples, 3) for path in paths], axis=-1)
        turning = self._turning(derivatives, h)[:, lead:]
        each = ((derivatives[..., k], turning[..., k]) for k in range(len(paths)))
        return [_tried(self._checked, *one, samples, lead, substeps) for one in each]

    def _turning(self, derivatives: Array, h: float) -> Array:
        """Return theta, psi, q, r at every second sample, shape (4, n, N), from the steady angles on."""
        path, n = derivatives[1:3].reshape(6, *derivatives.shape[2:]), derivatives.shape[-1]
        first, _ = steady_axis(derivatives[:, :, 0], self._row)
        stages = np.concatenate((path[:, :-2:2], path[:, 1::2], path[:, 2::2]))
        samples = np.ascontiguousarray(stages.transpose(1, 0, 2))
        step = np.full((1, n), h)
        after = axis_step()(len(samples), turning=first, times=samples, vehicle=self._row, step=step)["after"]
        return np.concatenate((first[:, None], after.transpose(1, 0, 2)), axis=1)

    def _checked(self, derivatives: Array, turning: Array, samples: Array, lead: int, substeps: int) -> Array:
        """Return the table of a path for its derivatives and angles at the samples; raise the errors of `table`."""
        times, turning = self.times, turning.copy()
        _check_path(derivatives, self.vehicle, samples)
        inside = derivatives[..., 2 * lead :: 2]
        ahead = math.atan2(inside[1, 1, 0], inside[1, 0, 0])
        turning[1] -= 2 * math.pi * np.round((turning[1, 0] - ahead) / (2 * math.pi))  # full turns of the run-in
        _check_angles(turning, inside, samples[2 * lead :: 2])
        instants = inside[..., ::substeps]
        flat = np.ascontiguousarray(instants[1:].reshape(9, -1))
        results = axis_motion()(path=flat, turning=np.ascontiguousarray(turning[:, ::substeps]), vehicle=self._row)
        reference = SpaceReference(times, *instants[0], *results["motion"])
        no_balance = "no turn rates balance the lateral forces"
        check_feasible(results["there"][0] > 0, lambda _: no_balance, times, instants[0])
        if self._limits is not None:
            _check_forces(reference, self.vehicle, self._limits)
        table = np.ascontiguousarray(reference.table)
        if self._most:
            check_bounds(table[:, 5:], self._most, _BOUNDED)
        return table


def _tried(function: Callable[..., T], *arguments: Any) -> T | ValueError:
    """Return the result of a function, or its ValueError."""
    try:
        return function(*arguments)
    except ValueError as error:
        return error


def _check_path(derivatives: Array, vehicle: SpaceVehicle, times: Array) -> None:
    """Raise InfeasibleReferenceError where the path stops, reverses, brakes too fast, or climbs too slowly."""
    position, V, A, _ = derivatives
    v_p = np.sqrt((V * V).sum(axis=0))
    is_gradual = np.concatenate(([True], (V[:, 1:] * V[:, :-1]).sum(axis=0) > 0))
    check_moving(v_p, is_gradual, times, position)
    for plane in (vehicle.horizontal, vehicle.vertical):
        if not plane.has_cross_terms:
            check_braking(v_p, (V * A).sum(axis=0) / v_p, plane, times, position)
    slowest = vehicle.reversal_speed
    reversed_fins = (
        f"the path climbs or dives below {slowest:.3g} m/s, where the side force of the fins that hold a pitch exceeds "
        "the lift of that pitch: at that speed only level paths can be planned"
    )
    check_feasible((v_p > slowest) | (np.abs(V[2]) < _LEVEL * v_p), lambda _: reversed_fins, times, position)


def _check_angles(turning: Array, derivatives: Array, times: Array) -> None:
    """Raise InfeasibleReferenceError where the pitch, or the angle between axis and velocity, is too large."""
    theta, psi, *_ = turning
    position, V, *_ = derivatives
    largest = f"{math.degrees(MAX_PITCH):.0f} degrees"
    pitch = f"the pitch exceeds {largest}: the path is too steep, or hardly faster than the fins' reversal"
    check_feasible(np.abs(theta) < MAX_PITCH, lambda _: pitch, times, position)
    ahead = sum(a * b for a, b in zip(axes(theta, psi, ARRAYS)[0], V, strict=True))
    limit = f"{math.degrees(MAX_SIDESLIP):.0f} degrees"
    sideslip = (
        f"the angle between axis and velocity exceeds {limit}, the path turns too fast for the drag across the axis"
    )
    is_allowed = ahead > math.cos(MAX_SIDESLIP) * np.sqrt((V * V).sum(axis=0))
    check_feasible(is_allowed, lambda _: sideslip, times, position)


def _check_forces(R: SpaceReference, vehicle: SpaceVehicle, limits: Limits) -> None:
    """Raise InfeasibleReferenceError where the fins cannot hold the pitch, or a force exceeds its limit."""
    position = np.stack((R.x, R.y, R.z))
    F_u, F_q, F_r, fin_q, fin_r = limits
    pitch, yaw = (torque_limit(R.u, (F_u, most, fin), ARRAYS) for most, fin in ((F_q, fin_q), (F_r, fin_r)))
    pitch = np.broadcast_to(pitch, R.u.shape)
    weight = vehicle.stiffness * np.sin(R.theta)

    def condition(k: int) -> str:
        return (
            f"the restoring moment at a pitch of {math.degrees(R.theta[k]):.3g} degrees is {weight[k]:.4g} N m, and "
            f"the fins give at most {pitch[k]:.4g} N m at {R.u[k]:.3g} m/s: such a climb needs a higher speed"
        )

    check_feasible(np.abs(weight) <= pitch, condition, R.t, position)
    check_force("F_u", "N", R.F_u, np.full_like(R.u, F_u), R.t, position)
    check_force("F_q", "N m", R.F_q, pitch, R.t, position)
    check_force("F_r", "N m", R.F_r, yaw, R.t, position)


def _along(velocity: Array) -> Array:
    """Return pitch, heading, q and r of an axis along the velocity, for velocity and acceleration (2, 3, T)."""
    (x, y, z), (a, b, c) = velocity
    level = np.hypot(x, y)
    with np.errstate(divide="ignore", invalid="ignore"):  # `_check_path` reports a speed of zero
        turn = (x * b - y * a) / level**2
        pitch = (z * (x * a + y * b) / level - level * c) / (level**2 + z * z)
    theta = np.arctan2(-z, level)
    return np.array((theta, np.arctan2(y, x), pitch, turn * np.cos(theta)))


def steady_axis(derivatives: Array, row: Array) -> tuple[Array, Array]:
    """Return theta, psi, q, r at which the axis turns as the path does, shape (4, T), and how other angles decay.

    The second array, shape (T, 2, 2), has the derivatives of theta' and psi' by theta and psi.
    """
    path, first = np.ascontiguousarray(derivatives[1:3].reshape(6, -1)), _along(derivatives[1:3])
    results = _steady_iteration()(_ITERATIONS, path=path, turning=first, vehicle=row)
    return results["turning"], results["slopes"].T.reshape(-1, 2, 2)


def _rates(slopes: Array) -> tuple[float, float]:
    """Return the largest and the smallest rate [1/s] at which the influence of the first angles decays on a path."""
    rates = np.abs(np.linalg.eigvals(slopes[np.isfinite(slopes).all(axis=(1, 2))]).real)
    return float(rates.max(initial=1e-3)), float(rates.min(initial=1e3))


def _power(number: float) -> int:
    """Return the smallest power of two that is not below a number, at least 1."""
    return 1 << math.ceil(math.log2(max(number, 1.0)))


def _missing(path: Sequence[Any], turning: Sequence[Any], row: Sequence[Any]) -> tuple[list[Any], list[Any], list[Any]]:
    """Return the accelerations [m/s^2] to port and up that a path needs and the vehicle does not have.

    And u, v, w with their rates along the path, and `state_rates` without load.

    Args:
        path: velocity and acceleration in the world, six numbers.
        turning: theta, psi, q, r.
        row: `SpaceVehicle.acting`.
    """
    theta, psi, q, r = turning
    body = axes(theta, psi, SYMBOLS)
    u, v, w = (sum((a * b for a, b in zip(axis, path[:3], strict=True)), 0.0) for axis in body)
    a_u, a_v, a_w = (sum((a * b for a, b in zip(axis, path[3:6], strict=True)), 0.0) for axis in body)
    p = -r * SYMBOLS.sin(theta) / SYMBOLS.cos(theta)
    needed = [a_u - (q * w - r * v), a_v - (r * u - p * w), a_w - (p * v - q * u)]
    free = state_rates((0.0, 0.0, 0.0, theta, psi, u, v, w, q, r), _NO_LOAD, row, ns=SYMBOLS)
    return [needed[1] - free.v, needed[2] - free.w], [u, v, w, *needed], [*free]


def _newton(
    f: Any, x: Sequence[Symbol], fixed: Sequence[Symbol], iterations: int, most: float = math.inf
) -> tuple[list[Symbol], list[Symbol]]:
    """Return where two functions of two numbers are zero, and their derivatives there, row by row.

    An iteration changes a number by at most `most`. The nodes `fixed` count as constants.
    """
    a, b = x
    for k in range(iterations + 1):
        value = f(a, b)
        still = dict.fromkeys((symbol.index for symbol in fixed), 0.0)
        fa, ga = directional(value, {**still, a.index: 1.0, b.index: 0.0})
        fb, gb = directional(value, {**still, a.index: 0.0, b.index: 1.0})
        if k < iterations:
            a, b = (
                number - (change if math.isinf(most) else SYMBOLS.clip(change, -most, most))
                for number, change in zip((a, b), _solved((fa, fb, ga, gb), value), strict=True)
            )
    return [a, b], [fa, fb, ga, gb]


def _solved(matrix: Sequence[Any], right: Sequence[Any]) -> tuple[Any, Any]:
    """Return the solution of two linear equations."""
    (a, b, c, d), (e, f) = matrix, right
    determinant = a * d - b * c
    return (d * e - b * f) / determinant, (a * f - c * e) / determinant


def _turn_rates(
    path: Sequence[Any], turning: Sequence[Symbol], row: Sequence[Any], iterations: int
) -> tuple[list[Symbol], list[Symbol]]:
    """Return q, r at which no lateral force is missing, from those of a guess, and the derivatives there."""
    theta, psi, *guess = turning
    return _newton(lambda q, r: _missing(path, (theta, psi, q, r), row)[0], guess, (theta, psi), iterations)


@cache
def _steady_iteration() -> Kernel:
    """Return the kernel of an iteration of Newton's method for the angles at given turn rates, see `_steady`."""

    def equation(path: Any, turning: Any, vehicle: Any) -> Mapping[str, Sequence[Any]]:
        *angles, q, r = turning
        (theta, psi), by_angle = _newton(
            lambda a, b: _missing(path, (a, b, q, r), vehicle)[0], angles, (q, r), 1, _LARGEST_CHANGE
        )
        by_rate = _newton(lambda a, b: _missing(path, (theta, psi, a, b), vehicle)[0], (q, r), (theta, psi), 0)[1]
        (q_t, r_t), (q_p, r_p) = (_solved(by_rate, [-x for x in by_angle[k::2]]) for k in (0, 1))
        c, s = SYMBOLS.cos(theta), SYMBOLS.sin(theta)
        return {"turning": [theta, psi, q, r], "slopes": [q_t, q_p, r_t / c + r * s / (c * c), r_p / c]}

    return Kernel.traced(equation, {"path": 6, "turning": 4, "vehicle": SPACE_ROWS}, shared=["vehicle"])


@cache
def axis_step() -> Kernel:
    """Return one Runge-Kutta step of pitch and heading; turn rates of the last stage are the next guess."""

    def equation(turning: Any, times: Any, vehicle: Any, step: Any) -> Mapping[str, Sequence[Any]]:
        begin, middle, end = times[:6], times[6:12], times[12:]
        theta, psi, *guess = turning

        def slopes(path: Any, angles: Sequence[Any], guess: Sequence[Any]) -> tuple[list[Any], list[Any]]:
            rates, _ = _turn_rates(path, (*angles, *guess), vehicle, _STAGE_ITERATIONS)
            return [rates[0], rates[1] / SYMBOLS.cos(angles[0])], rates

        def moved(time: Any, slope: Sequence[Any]) -> list[Any]:
            return [theta + time * slope[0], psi + time * slope[1]]

        (h,) = step
        a, rates = slopes(begin, (theta, psi), guess)
        b, rates = slopes(middle, moved(0.5 * h, a), rates)
        c, rates = slopes(middle, moved(0.5 * h, b), rates)
        d, rates = slopes(end, moved(h, c), rates)
        mean = [(i + 2 * (j + k) + m) / 6 for i, j, k, m in zip(a, b, c, d, strict=True)]
        after = [*moved(h, mean), *rates]
        return {"turning": after, "after": after}

    sizes = {"turning": 4, "times": 18, "vehicle": SPACE_ROWS, "step": 1}
    return Kernel.traced(equation, sizes, ["times", "after"], shared=["vehicle"])


@cache
def axis_motion() -> Kernel:
    """Return the kernel of theta, psi, u, v, w, q, r, F_u, F_q, F_r on a path, and of whether the forces balance."""

    def equation(path: Any, turning: Any, vehicle: Any) -> Mapping[str, Sequence[Any]]:
        theta, psi, *_ = turning
        (q, r), matrix = _turn_rates(path, turning, vehicle, _LAST_ITERATIONS)
        missing, moving, free = _missing(path, (theta, psi, q, r), vehicle)
        u, v, w, u_dot, v_dot, w_dot = moving
        by_time = dict(zip((x.index for x in path[:6]), path[3:9], strict=True))
        by_time |= {theta.index: q, psi.index: r / SYMBOLS.cos(theta), q.index: 0.0, r.index: 0.0}
        q_dot, r_dot = _solved(matrix, [-one for one in directional(missing, by_time)])
        size = abs(v_dot) + abs(w_dot) + abs(r * u) + abs(q * u)
        there = abs(missing[0]) + abs(missing[1]) <= _TOLERANCE * size + _NEGLIGIBLE
        m11, m33, n33 = vehicle[0], vehicle[2], vehicle[_PITCH_INERTIA]
        forces = [m11 * (u_dot - free[5]), n33 * (q_dot - free[8]), m33 * (r_dot - free[9])]
        return {"motion": [theta, psi, u, v, w, q, r, *forces], "there": [SYMBOLS.where(there, 1.0, 0.0)]}

    return Kernel.traced(equation, {"path": 9, "turning": 4, "vehicle": SPACE_ROWS}, shared=["vehicle"])
