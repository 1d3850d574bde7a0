"""Section III: the dynamically feasible reference for a path, in the sideslip form.

A vehicle without a side thruster cannot choose its heading on a path: (2b) fixes the sideslip gamma between hull and
velocity, see `auv_gym.planning.sideslip`. Sideslip and path give states and forces.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.actuators import fin_share
from auv_gym.physics.namespaces import ARRAYS, Array, Number
from auv_gym.physics.vehicle import Coefficients, Vehicle
from auv_gym.planning.feasibility import check_feasible, check_forces, check_rates
from auv_gym.planning.paths import Path, evaluate_paths
from auv_gym.planning.sideslip import ORDER, RATES, PathRates, in_sideslip, rates_along, sine_of_sideslip

RUN_IN = 12.0  # integrated before the first sample, in memories Dm/d22; the small start error fades by exp(-12)
MAX_STEP = 0.4  # largest integration step, in memories Dm/d22
MAX_RESPONSE = 0.1  # largest integration step times the rate at which the rest responds to w; unstable above 0.3
MAX_REFINEMENT = 128  # of the step for that reason
MAX_SIDESLIP = math.radians(80.0)  # beyond it a vehicle drifts rather than travels
MAX_SAMPLES = 2**21  # of a path or several at once, which bounds time and memory
MARGIN = 8  # how much finer than its samples a path may need to be looked at before several are planned one by one


@dataclass(frozen=True, eq=False)
class Reference:
    """What keeps the vehicle on its path: one entry per time, arrays of shape (T,), or (T, N) for N paths."""

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
    path: Path | Sequence[Path],
    vehicle: Vehicle,
    times: Array,
    force_limits: tuple[float, float] | None = None,
    fin: float = 0.0,
) -> Reference:
    """Return the reference that keeps the vehicle on the path at the given times, section III.

    Args:
        path: any path that is three times differentiable in time, or N of them at once.
        vehicle: the vehicle that is to follow it, in still water.
        times: evenly spaced times [s], shape (T,), T >= 2, inside the path's domain.
        force_limits: largest |F_u| [N] and |F_r| [N m]; unchecked if None.
        fin: of the fins [kg], see `actuators.Actuators`; they give |F_r| up to fin u^2 only.

    Returns:
        The reference, its fields of shape (T,), or (T, N) for a sequence of paths.

    Raises:
        ValueError: the times are not an evenly spaced, increasing, finite grid inside the path's domain, or the plan
            would need more than `MAX_SAMPLES` samples.
        InfeasibleReferenceError: the speed passes through zero, braking is faster than the sway drag allows, the
            sideslip exceeds `MAX_SIDESLIP`, or the open-loop forces exceed their limits.
    """
    paths = path if isinstance(path, Sequence) else (path,)
    times = _checked_times(times, paths)
    if isinstance(path, Sequence) and len(path) * len(times) > MAX_SAMPLES // MARGIN:
        return _side_by_side([plan(p, vehicle, times, force_limits, fin) for p in path])
    memory, fading = vehicle.coefficients.slip_mass / vehicle.d22, _fading(vehicle, paths, times)
    spacing = float(times[-1] - times[0]) / (len(times) - 1)
    substeps = max(math.ceil(spacing / (MAX_STEP * memory)), math.ceil(ORDER / (len(times) - 1)))
    run_in, *others = {min(RUN_IN * m, float(times[0] - p.start)) for m, p in zip(fading, paths, strict=True)}
    if others:  # each as it would be alone
        return _side_by_side([plan(p, vehicle, times, force_limits, fin) for p in paths])
    fine = _look_along(path, vehicle, times, substeps, run_in)
    refinement = min(math.ceil(fine.h * _response(fine.along, vehicle) / MAX_RESPONSE), MAX_REFINEMENT)
    if refinement > 1:
        if isinstance(path, Sequence):
            return _side_by_side([plan(p, vehicle, times, force_limits, fin) for p in paths])
        fine = _look_along(path, vehicle, times, substeps * refinement, run_in)
    w = sine_of_sideslip(fine.along, vehicle, fine.h)
    _check_sideslip(w, fine)
    kept = PathRates(*(getattr(fine.along, name)[fine.rows] for name in RATES))
    reference = assemble(times, fine.position[:, fine.rows], kept, w[fine.rows], vehicle)
    if force_limits is not None:
        F_u_max, F_r_max = force_limits
        torque = F_r_max * np.asarray(fin_share(reference.u, fin, F_r_max, ARRAYS))
        check_forces(reference.F_u, reference.F_r, (F_u_max, torque), times, fine.position[:, fine.rows])
    return reference


class _Fine(NamedTuple):
    """A path on the grid that the sideslip is integrated on, `lead` steps of h [s] before the first time."""

    times: Array  # [s]
    position: Array  # [m]
    along: PathRates
    h: float
    lead: int
    rows: slice  # of the plan's own times


def _check_sideslip(w: Array, fine: _Fine) -> None:
    """Raise InfeasibleReferenceError where a sideslip, whose sine is given, exceeds `MAX_SIDESLIP`."""
    limit = f"{math.degrees(MAX_SIDESLIP):.0f} degrees"
    check_feasible(
        np.abs(w[fine.lead :]) < math.sin(MAX_SIDESLIP),
        lambda _: f"the sideslip exceeds {limit}, the path turns too fast for the sway drag",
        fine.times[fine.lead :],
        fine.position[:, fine.lead :],
    )


def _look_along(path: Path | Sequence[Path], vehicle: Vehicle, times: Array, substeps: int, run_in: float) -> _Fine:
    """Return the path on a grid `substeps` times as fine as the plan's, which begins `run_in` [s] earlier."""
    h = float(times[-1] - times[0]) / (len(times) - 1) / substeps
    lead, several = int(run_in / h), len(path) if isinstance(path, Sequence) else 1
    if not (samples := (lead + (len(times) - 1) * substeps) * several) <= MAX_SAMPLES:
        raise ValueError(
            f"the plan would need {samples} samples of the path, at most {MAX_SAMPLES} are made: fewer steps, a path "
            "that turns more slowly, or a vehicle with a longer memory (m22 - m11)/d22 need fewer"
        )
    fine = times[0] + h * np.arange(-lead, (len(times) - 1) * substeps + 1)
    fine[-1] = times[-1]  # not an ulp past the path's end
    derivatives = evaluate_paths(path, fine) if isinstance(path, Sequence) else path.derivatives(fine)
    along = rates_along(derivatives)
    check_rates(along.v_p, along.beta, along.v_p_dot, vehicle, fine, derivatives[0])
    return _Fine(fine, derivatives[0], along, h, lead, slice(lead, None, substeps))


def _side_by_side(references: Sequence[Reference]) -> Reference:
    columns = (np.stack([getattr(R, field.name) for R in references], axis=1) for field in fields(Reference)[1:])
    return Reference(references[0].t, *columns)


def _checked_times(times: Array, paths: Sequence[Path]) -> Array:
    times = np.asarray(times, dtype=np.float64)
    if times.ndim != 1 or len(times) < 2 or not np.isfinite(times).all():
        raise ValueError(f"times must be a vector of two or more finite numbers, got {times!r}")
    steps = np.diff(times)
    if steps.min() <= 0 or steps.max() - steps.min() > 1e-6 * steps[0]:
        raise ValueError(f"times must increase in even steps, got steps of {steps.min():.6g} ... {steps.max():.6g} s")
    for path in paths:
        if times[0] < path.start or times[-1] > path.end:
            raise ValueError(
                f"times {times[0]:.6g} ... {times[-1]:.6g} s leave the path's domain, "
                f"{path.start:.6g} ... {path.end:.6g} s"
            )
    return times


def _fading(vehicle: Vehicle, paths: Sequence[Path], times: Array) -> list[float]:
    """Return the times [s] within which a sideslip fades at the start of paths, lift included."""
    speeds = [float(np.hypot(*path.derivatives(times[:1])[1, :, 0])) if vehicle.Y_uv else 0.0 for path in paths]
    return [vehicle.coefficients.slip_mass / (vehicle.d22 + vehicle.Y_uv * speed) for speed in speeds]


def _response(along: PathRates, vehicle: Vehicle) -> float:
    """Return the largest rate [1/s] at which the rest of the equation for w responds to w, with gamma quasi-steady."""
    a, turn = along.v_p_dot / along.v_p, abs(vehicle.m11 - vehicle.Y_ur) * np.abs(along.omega)
    lift = vehicle.Y_uv * along.v_p
    tan = np.minimum(turn / (vehicle.d22 + vehicle.m22 * a + lift), math.tan(MAX_SIDESLIP))
    drag = 2 * vehicle.Y_vv * along.v_p * tan / np.sqrt(1 + tan * tan)
    return float((vehicle.m22 * np.abs(a) + turn * tan + drag + lift).max() / vehicle.coefficients.slip_mass)


def assemble(
    times: Array,
    position: Array,
    along: PathRates,
    w: Array,
    vehicle: Vehicle,
    sway_load: tuple[Number, Number] = (0.0, 0.0),
) -> Reference:
    """Return states, their rates and the forces (16) from the path and the sine of its sideslip.

    Args:
        times: as the plan keeps them [s].
        position: x, y of the path at those times [m].
        along: speed, direction and their rates along the path at those times.
        w: sine of the sideslip.
        vehicle: whose plan it is.
        sway_load: external force Y on the hull along its sway axis [N], in (2b), and its rate [N/s].
    """
    rows = np.array([getattr(along, name) for name in RATES])
    rows[BETA] = _continuous(rows[BETA])
    arrays = {"along": rows.reshape(len(rows), -1), "w": w.reshape(1, -1)}
    several = np.ndim(vehicle.m11) > 0
    arrays["coefficients"] = _spread(vehicle.coefficients, w) if several else np.array(vehicle.coefficients)
    if loaded := any(np.any(load) for load in sway_load):
        arrays["load"] = _spread(sway_load, w)
    motion = _motion_kernel(loaded, several)(**arrays)["motion"].reshape(-1, *w.shape)
    psi, u, v, r, F_u, F_r, gamma = motion
    return Reference(times, position[0], position[1], psi, u, v, r, F_u, F_r, gamma, along.v_p, along.omega)


def _spread(numbers: Sequence[Number], w: Array) -> Array:
    """Return a row for each of some numbers, one entry for each of w."""
    return np.array([np.broadcast_to(number, w.shape) for number in numbers]).reshape(len(numbers), -1)


def _continuous(angle: Array) -> Array:
    """Return angles [rad] without jumps by full turns along axis 0."""
    turns = np.round(np.diff(angle, axis=0) / (2 * math.pi))
    if turns.any():
        angle = angle.copy()
        angle[1:] -= 2 * math.pi * np.cumsum(turns, axis=0)
    return angle


BETA = RATES.index("beta")
"""The place of the path's direction among its rates."""


@cache
def _motion_kernel(loaded: bool, several: bool) -> Kernel:
    """Return `in_sideslip` as a kernel, with a sway load or without, for several vehicles or one."""

    def equation(along: Any, w: Any, coefficients: Any, load: Any = (0.0, 0.0)) -> dict[str, Any]:
        vehicle, (Y, Y_rate) = Coefficients(*coefficients), load
        return {"motion": in_sideslip(PathRates(*along), w[0], vehicle, (Y, Y_rate), SYMBOLS)}

    rows = {"along": len(RATES), "w": 1, "coefficients": len(Coefficients._fields)}
    shared = [] if several else ["coefficients"]
    return Kernel.traced(equation, {**rows, "load": 2} if loaded else rows, shared=shared)


def printed_surge_rate(u_R: float, v_p: float, v_p_dot: float, omega: float, vehicle: Vehicle) -> float:
    """Return u_R' [m/s^2] by (15) as printed, with its v_R^3 read as the norm v_p^3 as (15') confirms.

    For comparison only: it holds for clockwise curves (omega < 0) and is singular at u_R = v_p.
    """
    m11, m22, d22 = vehicle.m11, vehicle.m22, vehicle.d22
    root = math.sqrt(max(v_p * v_p - u_R * u_R, 0.0))
    bracket = d22 * u_R**2 * v_p - d22 * v_p**3 - m11 * omega * u_R * v_p * root
    return (bracket + m11 * u_R**2 * v_p_dot - m22 * v_p_dot * v_p**2) / (u_R * v_p * (m11 - m22))
