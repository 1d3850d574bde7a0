"""The dynamically feasible reference of a path, by section III of the paper in terms of the sideslip.

A vehicle without a side thruster cannot choose its heading on a path: (2b) determines the sideslip gamma, see
`auv_gym.planning.sideslip`. The path and the sideslip determine the states and forces.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from auv_gym.codegen.kernel import address
from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import Vehicle
from auv_gym.planning.crossed import motion, sideslips, steady_sideslips
from auv_gym.planning.feasibility import check_bounds, check_feasible, check_forces, check_rates, check_sideslip
from auv_gym.planning.kernels import FAMILIES, FIXED_POINT, LIMIT_ROWS, VEHICLE_ROWS, driver, planning_kernels
from auv_gym.planning.paths import Path, RandomSmooth, unstack
from auv_gym.planning.sideslip import ORDER, RATES, PathRates, formula_weights

RUN_IN = 12.0  # time constants Dm/d22 integrated before the first sample; the initial error decays by exp(-12)
MAX_STEP = 0.4  # largest integration step, in time constants Dm/d22
MAX_RESPONSE = 0.1  # largest integration step times `sideslip.response`; the integration is unstable above 0.3
_NO_BALANCE = "no yaw rate balances the sway force of the cross terms"
_FINER = 2  # samples in a step of a vehicle with cross terms, see `crossed`
_CROSSED_RESPONSE = 0.05  # `MAX_RESPONSE` of a vehicle with cross terms
_SLOWEST = 10.0  # `Vehicle.time` of a vehicle with cross terms that count as a time constant in the run-in
MAX_REFINEMENT = 128  # largest refinement of the step for `MAX_RESPONSE`
MAX_SAMPLES = 2**21  # largest number of samples of a path, which bounds time and memory
_CODES: dict[type, int] = {family: code for code, family in enumerate([*FAMILIES, RandomSmooth])}
"""The codes of the families in the driver."""
_BY_DERIVATIVES = -1  # the code of a path whose derivatives are computed in Python
_SCALE, _WEIGHTS = VEHICLE_ROWS + 7, VEHICLE_ROWS + 8 + LIMIT_ROWS  # indices in the settings of the driver
BETA = RATES.index("beta")  # index of the direction among the rates of a path


@dataclass(frozen=True, eq=False)
class Reference:
    """States and open-loop forces of the vehicle on its path: arrays of shape (T,), or (T, N) for N paths."""

    t: Array  # [s], shape (T,)
    x: Array  # [m]
    y: Array  # [m]
    psi: Array  # [rad] heading, continuous in time
    u: Array  # [m/s]
    v: Array  # [m/s]
    r: Array  # [rad/s]
    F_u: Array  # [N] open-loop force (16a)
    F_r: Array  # [N m] open-loop torque (16b)
    gamma: Array  # [rad] sideslip atan2(v, u), (8)
    v_p: Array  # [m/s] speed (3)
    omega: Array  # [rad/s] turn rate of the path (5)

    @cached_property
    def table(self) -> Array:
        """x, y, psi, u, v, r, F_u, F_r, shape (T, 8) or (T, 8, N)."""
        return np.stack((self.x, self.y, self.psi, self.u, self.v, self.r, self.F_u, self.F_r), axis=1)


def plan(
    path: Path,
    vehicle: Vehicle,
    times: Array,
    force_limits: tuple[float, float] | None = None,
    fin: float = 0.0,
) -> Reference:
    """Return the reference with which the vehicle follows the path at the given times, by section III of the paper.

    Args:
        path: a path that is three times differentiable in time.
        vehicle: the vehicle, in still water.
        times: evenly spaced times [s], shape (T,), T >= 2, inside the path's domain.
        force_limits: largest |F_u| [N] and |F_r| [N m]; unchecked if None.
        fin: parameter of the fins [kg], see `actuators.Actuators`; they give |F_r| up to fin u^2 only.

    Returns:
        The reference, its fields of shape (T,).

    Raises:
        ValueError: the times are not an evenly spaced, increasing, finite grid inside the path's domain, the plan needs
            more than `MAX_SAMPLES` samples, or the derivatives of a path do not have the shape that `Path` defines.
        InfeasibleReferenceError: the speed passes through zero, braking is faster than the sway drag allows, the
            sideslip exceeds `MAX_SIDESLIP`, or the open-loop forces exceed their limits.
    """
    return Planner(vehicle, checked_grid(times, path), force_limits, fin).plan(path)


class Planner:
    """Plans paths of one vehicle for the same times.

    Args:
        vehicle: see `plan`.
        times: see `plan`; they are not checked.
        force_limits: see `plan`.
        fin: see `plan`.
        most: largest |u|, |v| [m/s], |r| [rad/s], |F_u| [N] and |F_r| [N m] of a `table`.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        times: Array,
        force_limits: tuple[float, float] | None = None,
        fin: float = 0.0,
        most: Sequence[float] = (math.inf,) * 5,
    ) -> None:
        self.vehicle, self.times, self.most = vehicle, times, most
        self._limits = (math.inf, math.inf, 0.0) if force_limits is None else (*force_limits, fin)
        self._coefficients = np.array(vehicle.coefficients)
        self._crossed = vehicle.has_cross_terms
        self._slip_mass = vehicle.coefficients.slip_mass
        self._period = float(times[-1] - times[0]) / (len(times) - 1)
        time_constant = self._slip_mass / vehicle.d22
        self._substeps = max(math.ceil(self._period / (MAX_STEP * time_constant)), math.ceil(ORDER / (len(times) - 1)))
        if self._crossed:
            self._substeps *= _FINER
        self._grids: dict[tuple[int, int], _Grid] = {}

    def plan(self, path: Path) -> Reference:
        """Return the reference of a path.

        Raises:
            ValueError: the plan needs more than `MAX_SAMPLES` samples.
            InfeasibleReferenceError: see `plan`.
        """
        rest = np.empty((3, len(self.times)))
        if (table := self._compiled(path, rest)) is None:
            table, rest = self._in_python(path)
        return Reference(self.times, *table.T, *rest)

    def table(self, path: Path, *, many: bool = True) -> Array:
        """Return the `Reference.table` of a path, shape (T, 8).

        Args:
            path: see `plan`.
            many: see `kernels.driver`.

        Raises:
            ValueError: see `plan`, or the reference exceeds `most`.
            InfeasibleReferenceError: see `plan`.
        """
        if (table := self._compiled(path, many=many)) is None:
            table, _ = self._in_python(path)
            check_bounds(table[:, 3:], self.most)
        return table

    def tables(self, paths: Any, n: int) -> list[Array | None]:
        """Return the `table` of each of n paths of one family, combined by `stack`; None if it raises an error."""
        function, code = driver(), self._code(paths)
        if function is None or self._crossed:
            return [self._table_or_none(path) for path in unstack(paths, n)]
        if code == _BY_DERIVATIVES or self.vehicle.Y_uv:
            return [self._compiled(path) for path in unstack(paths, n)]
        columns = _numbers(paths)
        rows, grid = np.empty((n, len(columns))), self._grid(paths)
        for column, number in zip(rows.T, columns, strict=True):
            column[:] = number
        if grid.samples > MAX_SAMPLES:
            return [None] * n
        tables: list[Array | None] = []
        first, settings = address(rows), address(grid.settings)
        for j in range(n):
            table = np.empty((len(self.times), 8))
            result = function(code, first + j * rows.strides[0], None, settings, address(table), None)
            tables.append(table if result == 0 else self._compiled(unstack(paths, n)[j]) if result > 0 else None)
        return tables

    def _table_or_none(self, path: Path) -> Array | None:
        with suppress(ValueError):
            return self.table(path)
        return None

    def _code(self, path: Path) -> int:
        """Return the code of the family in the driver, which integrates a `RandomSmooth` from t = 0 on."""
        code = _CODES.get(type(path), _BY_DERIVATIVES)
        return _BY_DERIVATIVES if code == len(FAMILIES) and self.times[0] != 0 else code

    def _compiled(self, path: Path, rest: Array | None = None, *, many: bool = True) -> Array | None:
        """Return a `Reference.table`, and write gamma, v_p, omega to `rest`.

        Return None without a compiler, for a vehicle with cross-flow, and for a path that cannot be followed;
        `_in_python` then raises the error.
        """
        if self._crossed or (function := driver(many)) is None:
            return None
        code, derivatives = self._code(path), None
        numbers = np.array([0.0, 0.0, 0.0] if code == _BY_DERIVATIVES else _numbers(path))
        table, grid = np.empty((len(self.times), 8)), self._grid(path)
        while grid.samples <= MAX_SAMPLES:
            if code == _BY_DERIVATIVES:
                derivatives = _derivatives(path, grid.times(self.times))
            result = function(code, *map(address, (numbers, derivatives, grid.settings, table, rest)))
            if result <= 0:
                return None if result else table
            grid = self._grid(path, min(result, MAX_REFINEMENT))
        return None

    def _grid(self, path: Path, refinement: int = 1) -> _Grid:
        """Return the samples for a path; they begin before the first time if the path's domain does."""
        damping, h = self.vehicle.d22, self._period / (self._substeps * refinement)
        if lift := self.vehicle.Y_uv:  # it reduces the time constant of the sideslip
            damping += lift * float(np.hypot(*path.derivatives(self.times[:1])[1, :, 0]))
        run_in = RUN_IN * min(self._slip_mass / damping, _SLOWEST * self.vehicle.time if self._crossed else math.inf)
        even = 2 if self._crossed else 1  # a vehicle with cross terms needs an even number of samples
        lead = even * int(min(run_in, float(self.times[0] - path.start)) / h / even)
        if (grid := self._grids.get((lead, refinement))) is None:
            substeps, scale = self._substeps * refinement, h / self._slip_mass
            numbers = self.times[0], self.times[-1], h, lead, len(self.times), substeps
            bounds = h / MAX_RESPONSE if refinement == 1 else 0.0, scale, *self._limits, *self.most
            settings = np.array([*self._coefficients, *numbers, *bounds, *formula_weights(self.vehicle.d22 * scale)])
            grid = self._grids[lead, refinement] = _Grid(h, lead, substeps, len(self.times), settings)
        return grid

    def _in_python(self, path: Path) -> tuple[Array, Array]:
        """Return the table and gamma, v_p, omega of `_compiled`, by the same kernels.

        Raises:
            ValueError: see `plan`.
            InfeasibleReferenceError: see `plan`.
        """
        k, grid = planning_kernels(), self._grid(path)
        position, along, terms, response = self._along_path(path, grid)
        acting, limit = np.array(self.vehicle.acting), MAX_RESPONSE
        if self._crossed:
            (_, response), limit = steady_sideslips(along, acting), _CROSSED_RESPONSE
            response = response[np.isfinite(response)]  # elsewhere no yaw rate balances the forces
        refinement = min(math.ceil(grid.h / limit * response.max(initial=0.0)), MAX_REFINEMENT)
        if refinement > 1:
            grid = self._grid(path, refinement)
            position, along, terms, _ = self._along_path(path, grid)
        times, lead, every = grid.times(self.times), grid.lead, 2 if self._crossed else 1
        if self._crossed:
            w = sideslips(along, float(steady_sideslips(along[:, :1], acting)[0][0]), acting, grid.h)
        else:
            w = self._sideslip(along, terms, grid.settings[_WEIGHTS:])
        check_sideslip(w[lead // every :], times[lead::every], position[:, lead::every])
        beta = along[BETA : BETA + 1]
        turns = k["turns"](beta=beta[:, :-1], next_beta=beta[:, 1:])["turns"]
        beta[:, lead + 1 :] -= 2 * math.pi * np.cumsum(turns[:, lead:], axis=1)
        instants = np.s_[:, lead :: grid.substeps]
        w = w[lead // every :: grid.substeps // every]
        if self._crossed:
            (*planned, gamma), there = motion(along[instants], w, acting)
            check_feasible(there, lambda _: _NO_BALANCE, self.times, position[instants])
        else:
            limits = np.array([*self._limits, *self.most])
            results = k["motion"](along=along[instants], w=w[None], coefficients=self._coefficients, limits=limits)
            planned, gamma = [*results["motion"]], results["gamma"][0]
        _, u, _, _, F_u, F_r = planned
        check_forces(F_u, F_r, u, self._limits, self.times, position[instants])
        rates = PathRates(*along[instants])
        table = np.ascontiguousarray(np.vstack((position[instants], planned)).T)
        return table, np.vstack((gamma, rates.v_p, rates.omega))

    def _along_path(self, path: Path, grid: _Grid) -> tuple[Array, Array, Array, Array]:
        """Return position, `PathRates`, terms of the sideslip and its response at the samples, rows of shape (T,)."""
        if grid.samples > MAX_SAMPLES:
            raise ValueError(
                f"the plan needs {grid.samples} samples of the path; at most {MAX_SAMPLES} are allowed. Fewer steps, "
                "a path that turns more slowly, or a vehicle with a longer time constant (m22 - m11)/d22 need fewer"
            )
        times = grid.times(self.times)
        derivatives, scale = _derivatives(path, times), grid.settings[_SCALE : _SCALE + 1]
        results = planning_kernels()["along_path"](
            derivatives=derivatives, pose=np.zeros(3), scale=scale, coefficients=self._coefficients
        )
        along = PathRates(*results["along"])
        check_rates(along.v_p, along.beta, along.v_p_dot, self.vehicle, times, results["position"])
        return results["position"], results["along"], results["terms"], results["response"]

    def _sideslip(self, along: Array, terms: Array, weights: Array) -> Array:
        """Return w at the samples, by integrating the equation of `sideslip`.

        Beyond 90 degrees it may be nan, which `check_sideslip` refuses.
        """
        k, split = planning_kernels(), (ORDER - 1) * (ORDER + 1)
        start = k["steady"](along=along[:, :1], coefficients=self._coefficients)["w"]
        first = k["first_samples"](
            FIXED_POINT,
            u=np.tile(start, (ORDER, 1)),
            inputs=terms[:, :ORDER].T.reshape(-1, 1),
            weights=weights[:split, None],
        )
        u = np.empty((terms.shape[1], 1, 1))
        u[:ORDER, 0] = first["u"]
        history = np.concatenate((first["u"][-1:], first["rest"][-2::-1]))
        inputs = np.ascontiguousarray(terms.T)[:, :, None]
        step = k["recursion"].bound(history=history, weights=weights[split:, None], inputs=inputs, u=u[1:])
        step(ORDER - 1, len(u) - ORDER)  # step n computes u_(n+1)
        return u.ravel()


def _numbers(path: Any) -> list[Any]:
    """Return the arguments of the compiled formulas of a path, or of several that are stacked: the pose comes first."""
    return [path.x0, path.y0, path.heading, *path.numbers]


class _Grid(NamedTuple):
    """The samples of the integration of the sideslip."""

    h: float  # [s] integration step
    lead: int  # number of samples before the first time of the plan
    substeps: int  # number of steps from one time of the plan to the next
    instants: int  # number of times of the plan
    settings: Array  # argument c of `plan` in driver.c

    @property
    def samples(self) -> int:
        """Number of integration steps."""
        return self.lead + (self.instants - 1) * self.substeps

    def times(self, plan: Array) -> Array:
        """Return the times of the samples [s], for the times of the plan [s]."""
        times: Array = plan[0] + self.h * np.arange(-self.lead, (self.instants - 1) * self.substeps + 1)
        times[-1] = plan[-1]  # exactly, since rounding could exceed the end of the path
        return times


def checked_derivatives(path: Any, times: Array, axes: int = 2) -> Array:
    """Return the `derivatives` of a path at T times; raise ValueError unless their shape is (4, axes, T)."""
    derivatives = np.asarray(path.derivatives(times), dtype=np.float64)
    if derivatives.shape != (shape := (4, axes, len(times))):
        raise ValueError(
            f"{type(path).__name__}.derivatives returns an array of shape {derivatives.shape} for {len(times)} times; "
            f"it must be {shape}"
        )
    return derivatives


def _derivatives(path: Path, times: Array) -> Array:
    """Return the `Path.derivatives` at T times as an array of shape (8, T)."""
    return np.ascontiguousarray(checked_derivatives(path, times).reshape(8, -1))


def checked_grid(times: Array, path: Any) -> Array:
    """Return the times of a plan as an array; raise ValueError unless they are even steps in the domain of a path."""
    times = np.asarray(times, dtype=np.float64)
    if times.ndim != 1 or len(times) < 2 or not np.isfinite(times).all():
        raise ValueError(f"times must be a vector of two or more finite numbers, got {times!r}")
    steps = np.diff(times)
    if steps.min() <= 0 or steps.max() - steps.min() > 1e-6 * steps[0]:
        raise ValueError(f"times must increase in even steps, got steps of {steps.min():.6g} ... {steps.max():.6g} s")
    if times[0] < path.start or times[-1] > path.end:
        raise ValueError(
            f"times {times[0]:.6g} ... {times[-1]:.6g} s leave the path's domain, {path.start:.6g} ... {path.end:.6g} s"
        )
    return times
