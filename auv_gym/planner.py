"""Section III: the dynamically feasible reference for a path, in the sideslip form.

A vehicle without a side thruster cannot choose its heading on a path: (2b) fixes the sideslip gamma between hull and
velocity. With w = sin(gamma) = v_R / v_p, the paper's (8)-(15) become one scalar equation without the singularity that
(15) has at v_R = 0,

    w' = -(d22/Dm) w - [(m22 v_p'/v_p + Y_vv v_p |w|) w + m11 omega sqrt(1 - w^2)] / Dm,     Dm = m22 - m11,

whose first term fades within Dm/d22 (0.5 s for the paper's vehicle). That term is integrated exactly, the smooth rest
by an Adams-Bashforth formula: exponential time differencing (S. M. Cox and P. C. Matthews, J. Comput. Phys.
176:430-455, 2002).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.dynamics import rates
from auv_gym.namespaces import ARRAYS, FLOATS, Number, wrap_angle
from auv_gym.paths import Path, evaluate
from auv_gym.vehicle import Vehicle

Array = NDArray[np.float64]

MIN_SPEED = 1e-3  # [m/s] below this a path counts as standing still
RUN_IN = 12.0  # integrated before the first sample, in memories Dm/d22; the small start error fades by exp(-12)
MAX_STEP = 0.4  # largest integration step, in memories Dm/d22
MAX_RESPONSE = 0.1  # largest integration step times the rate at which the rest responds to w; unstable above 0.3
MAX_REFINEMENT = 128  # of the step for that reason
MAX_SIDESLIP = math.radians(80.0)  # beyond it a vehicle drifts rather than travels
ORDER = 4  # samples in each integration formula
FEW = 8  # paths that are planned faster one by one, on floats, than together, on arrays


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


@dataclass(frozen=True, eq=False)
class PathRates:
    """Speed, direction and their rates along a path, arrays of one shape."""

    v_p: Array  # [m/s] (3)
    beta: Array  # [rad] (4), by atan2
    omega: Array  # [rad/s] (5)
    v_p_dot: Array  # [m/s^2] (6)
    omega_dot: Array  # [rad/s^2]
    v_p_ddot: Array  # [m/s^3]


def path_rates(derivatives: Array) -> PathRates:
    """Return speed, direction and their rates from position and three time derivatives, shape (4, 2, ...)."""
    (x1, y1), (x2, y2), (x3, y3) = derivatives[1:]
    v_p = np.hypot(x1, y1)
    with np.errstate(divide="ignore", invalid="ignore"):  # a standstill is reported by `plan`, with its place
        omega = (x1 * y2 - y1 * x2) / v_p**2
        v_p_dot = (x1 * x2 + y1 * y2) / v_p
        omega_dot = (x1 * y3 - y1 * x3) / v_p**2 - 2 * omega * v_p_dot / v_p
        v_p_ddot = (x1 * x3 + y1 * y3) / v_p + v_p * omega**2
    return PathRates(v_p, np.arctan2(y1, x1), omega, v_p_dot, omega_dot, v_p_ddot)


def plan(
    path: Path | Sequence[Path], vehicle: Vehicle, times: Array, force_limits: tuple[float, float] | None = None
) -> Reference:
    """Return the reference that keeps the vehicle on the path at the given times, section III.

    Args:
        path: any path that is three times differentiable in time, or N of them at once.
        vehicle: the vehicle that is to follow it, in still water.
        times: evenly spaced times [s], shape (T,), T >= 2, inside the path's domain.
        force_limits: largest |F_u| [N] and |F_r| [N m]; unchecked if None.

    Returns:
        The reference, its fields of shape (T,), or (T, N) for a sequence of paths.

    Raises:
        ValueError: the times are not an evenly spaced, increasing, finite grid inside the path's domain.
        InfeasibleReferenceError: the speed passes through zero, braking is faster than the sway drag allows, the
            sideslip exceeds `MAX_SIDESLIP`, or the open-loop forces exceed their limits.
    """
    paths = path if isinstance(path, Sequence) else (path,)
    times = _checked_times(times, paths)
    if isinstance(path, Sequence) and len(path) <= FEW:
        return _side_by_side([plan(p, vehicle, times, force_limits) for p in path])
    memory = (vehicle.m22 - vehicle.m11) / vehicle.d22
    spacing = float(times[-1] - times[0]) / (len(times) - 1)
    substeps = max(math.ceil(spacing / (MAX_STEP * memory)), math.ceil(ORDER / (len(times) - 1)))
    run_in, *others = {min(RUN_IN * memory, float(times[0] - p.start)) for p in paths}
    for finest in (False, True):
        h = spacing / substeps
        lead = int(run_in / h)
        fine = times[0] + h * np.arange(-lead, (len(times) - 1) * substeps + 1)
        fine[-1] = times[-1]  # not an ulp past the path's end
        derivatives = evaluate(path, fine) if isinstance(path, Sequence) else path.derivatives(fine)
        along = path_rates(derivatives)
        _check_rates(along, vehicle, partial(_check, times=fine, positions=derivatives[0]))
        refinement = min(math.ceil(h * _response(along, vehicle) / MAX_RESPONSE), MAX_REFINEMENT)
        if isinstance(path, Sequence) and (others or refinement > 1):  # each as it would be alone
            return _side_by_side([plan(p, vehicle, times, force_limits) for p in paths])
        if finest or refinement <= 1:
            break
        substeps *= refinement
    w = _sine_of_sideslip(along, vehicle, h)
    limit = math.degrees(MAX_SIDESLIP)
    _check(
        np.abs(w[lead:]) < math.sin(MAX_SIDESLIP),
        lambda _: f"the sideslip exceeds {limit:.0f} degrees, the path turns too fast for the sway drag",
        fine[lead:],
        derivatives[0][:, lead:],
    )
    rows = slice(lead, None, substeps)
    kept = PathRates(*(getattr(along, field.name)[rows] for field in fields(PathRates)))
    reference = assemble(times, derivatives[0][:, rows], kept, w[rows], vehicle)
    if force_limits is not None:
        _check_forces(reference, force_limits)
    return reference


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


Index = tuple[int, ...]


def _check(valid: NDArray[np.bool_], condition: Callable[[Index], str], times: Array, positions: Array) -> None:
    """Raise InfeasibleReferenceError for the first time at which `valid`, shape (T,) or (T, N), does not hold."""
    if not valid.all():
        index = tuple(int(i) for i in np.argwhere(~valid)[0])
        x, y = (float(row[index]) for row in positions)
        raise InfeasibleReferenceError(condition(index), float(times[index[0]]), (x, y))


def _check_rates(along: PathRates, vehicle: Vehicle, check: Callable[..., None]) -> None:
    moving = along.v_p >= MIN_SPEED
    moving[1:] &= np.abs(wrap_angle(np.diff(along.beta, axis=0), ARRAYS)) < 0.5 * math.pi  # no turn on the spot
    check(moving, lambda k: f"the speed passes through zero, here v_p = {along.v_p[k]:.3g} m/s")
    braking = -along.v_p_dot / along.v_p
    limit = vehicle.d22 / vehicle.m22
    check(braking < limit, lambda k: f"braking -v_p'/v_p = {braking[k]:.4g} 1/s is not below d22/m22 = {limit:.4g} 1/s")


def _check_forces(reference: Reference, limits: tuple[float, float]) -> None:
    positions = np.stack((reference.x, reference.y))
    for name, unit, force, limit in (("F_u", "N", reference.F_u, limits[0]), ("F_r", "N m", reference.F_r, limits[1])):
        text = f"{name} = {{:.4g}} {unit} is beyond its limit of {limit:.4g} {unit}"
        _check(np.abs(force) <= limit, lambda k, text=text, force=force: text.format(force[k]), reference.t, positions)  # type: ignore[misc]


def _response(along: PathRates, vehicle: Vehicle) -> float:
    """Return the largest rate [1/s] at which the rest of the equation for w responds to w, with gamma quasi-steady."""
    a, turn = along.v_p_dot / along.v_p, vehicle.m11 * np.abs(along.omega)
    tan = np.minimum(turn / (vehicle.d22 + vehicle.m22 * a), math.tan(MAX_SIDESLIP))
    drag = 2 * vehicle.Y_vv * along.v_p * tan / np.sqrt(1 + tan * tan)
    return float((vehicle.m22 * np.abs(a) + turn * tan + drag).max()) / (vehicle.m22 - vehicle.m11)


@np.errstate(over="ignore", invalid="ignore")  # past 90 degrees, where the caller refuses
def _sine_of_sideslip(along: PathRates, vehicle: Vehicle, h: float) -> Array:
    """Integrate the equation of the module's docstring for w over samples h [s] apart, along axis 0."""
    Dm = vehicle.m22 - vehicle.m11
    z = vehicle.d22 / Dm * h
    floats = along.v_p.ndim == 1
    slope, square, turn = (
        (h / Dm * term).tolist() if floats else h / Dm * term for term in sideslip_terms(along, vehicle)
    )
    sqrt = (FLOATS if floats else ARRAYS).sqrt
    inputs = list(zip(slope, square, turn, strict=True))
    start = slow_sideslip(along, vehicle)
    w: list[Any] = [start.item() if floats else start] * ORDER
    decay = math.exp(-z)
    first = [(k, math.exp(-k * z), _weights(z, 0, k)) for k in range(1, ORDER)]
    for _ in range(12):  # the first samples jointly: a fixed point of the integral over their interpolant
        terms = [sideslip_rest(*inputs[k], w[k], sqrt) for k in range(ORDER)]
        for k, fade, (c0, c1, c2, c3) in first:
            w[k] = fade * w[0] + c0 * terms[0] + c1 * terms[1] + c2 * terms[2] + c3 * terms[3]
    c3, c2, c1, c0 = _weights(z, 1 - ORDER, 1)
    n3, n2, n1, _ = terms
    last = w[-1]
    for a, q, b in inputs[ORDER - 1 : -1]:
        n0 = sideslip_rest(a, q, b, last, sqrt)
        last = decay * last + c0 * n0 + c1 * n1 + c2 * n2 + c3 * n3
        w.append(last)
        n3, n2, n1 = n2, n1, n0
    return np.array(w)


def sideslip_terms(along: PathRates, vehicle: Vehicle) -> tuple[Array, Array, Array]:
    """Return what multiplies w, |w| w and sqrt(1 - w^2) in the bracket of the module's docstring."""
    return vehicle.m22 * along.v_p_dot / along.v_p, vehicle.Y_vv * along.v_p, vehicle.m11 * along.omega


def sideslip_rest(slope: Number, square: Number, turn: Number, w: Number, sqrt: Callable[[Number], Number]) -> Number:
    """Return minus the bracket for its `sideslip_terms`, all of them scaled by the same factor."""
    return -(slope + square * abs(w)) * w - turn * sqrt(abs(1 - w * w))  # abs: past 90 degrees


def slow_sideslip(along: PathRates, vehicle: Vehicle) -> Any:
    """Return w at the first sample free of the fast transient: two passes of m11 omega + D tan(gamma) = -Dm gamma'."""
    a = along.v_p_dot[0] / along.v_p[0]
    linear, turn = vehicle.d22 + vehicle.m22 * a, vehicle.m11 * along.omega[0]
    slope = np.sqrt(linear**2 + 4 * vehicle.Y_vv * along.v_p[0] * abs(turn))  # of D tan(gamma) by tan(gamma)
    tan = -2 * turn / (linear + slope)
    D_dot = vehicle.m22 * (along.v_p_ddot[0] / along.v_p[0] - a * a)
    gamma_dot = -(vehicle.m11 * along.omega_dot[0] + D_dot * tan) / (slope * (1 + tan * tan))
    tan -= (vehicle.m22 - vehicle.m11) * gamma_dot / slope
    return np.asarray(tan / np.sqrt(1 + tan * tan))


def sideslip_step(
    w: Array, rest: Array, rest_at: Callable[[Array], Array], z: Array | float, largest: float
) -> tuple[Array, Array]:
    """Return w, cut off at +-`largest`, and the rest of its equation one step of z memories later.

    By the exponential Runge-Kutta formula of second order (Cox and Matthews 2002, eq. 22): less exact than `plan`, but
    it needs no history, so that it can follow a sea that is only known as time goes by.

    Args:
        w: sine of the sideslip before the step.
        rest: the rest of the equation there, times the step.
        rest_at: the same as a function of w behind the step.
        z: the step in memories Dm/d22.
        largest: cut-off of w.
    """
    decay = np.exp(-z)
    guess = decay * w + (1 - decay) / z * rest
    correction = rest_at(np.clip(guess, -largest, largest)) - rest
    new = np.clip(guess + (z - 1 + decay) / (z * z) * correction, -largest, largest)
    return new, rest_at(new)


@lru_cache
def _weights(z: float, first: int, end: int) -> tuple[float, ...]:
    """Return c with  integral_0^end exp(-z (end - s)) n(s) ds = sum_j c_j n(first + j)  for cubic n."""
    nodes = range(first, first + ORDER)
    points, gauss = np.polynomial.legendre.leggauss(24)
    s = 0.5 * end * (points + 1)
    kernel = 0.5 * end * gauss * np.exp(-z * (end - s))
    return tuple(float(kernel @ np.prod([(s - m) / (j - m) for m in nodes if m != j], axis=0)) for j in nodes)


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
        position: likewise [m].
        along: speed, direction and their rates along the path.
        w: sine of the sideslip.
        vehicle: whose plan it is.
        sway_load: external force Y on the hull along its sway axis [N], in (2b), and its rate [N/s].
    """
    m11, m22, m33, _, d22, *_, Y_vv, _ = vehicle.coefficients
    v_p, beta, om, v_p_dot, om_dot, v_p_ddot = (getattr(along, field.name) for field in fields(PathRates))
    c = np.sqrt(1 - w * w)
    tan, gamma, a = w / c, np.arcsin(w), v_p_dot / v_p
    u, v = v_p * c, v_p * w  # (7), (8)
    D = d22 + Y_vv * np.abs(v) + m22 * a
    push = sway_load[0] / u
    gamma_dot = -(m11 * om + D * tan - push) / (m22 - m11)
    u_dot, v_dot = v_p_dot * c - v * gamma_dot, v_p_dot * w + u * gamma_dot  # (12)
    D_dot = Y_vv * np.sign(v) * v_dot + m22 * (v_p_ddot / v_p - a * a)
    push_dot = sway_load[1] / u + push * (tan * gamma_dot - a)
    gamma_ddot = -(m11 * om_dot + D_dot * tan + D * gamma_dot / c**2 - push_dot) / (m22 - m11)
    psi = np.unwrap(beta, axis=0) - gamma  # (10) with the signed sideslip
    r, r_dot = om - gamma_dot, om_dot - gamma_ddot  # (14)
    _, _, u_free, _, r_free = rates(psi, u, v, r, (0.0, 0.0, 0.0), vehicle.coefficients, np)
    F_u, F_r = m11 * (u_dot - u_free), m33 * (r_dot - r_free)  # (16)
    return Reference(times, position[0], position[1], psi, u, v, r, F_u, F_r, gamma, v_p, om)


def printed_surge_rate(u_R: float, v_p: float, v_p_dot: float, omega: float, vehicle: Vehicle) -> float:
    """Return u_R' [m/s^2] by (15) as printed, with its v_R^3 read as the norm v_p^3 as (15') confirms.

    For comparison only: it holds for clockwise curves (omega < 0) and is singular at u_R = v_p.
    """
    m11, m22, d22 = vehicle.m11, vehicle.m22, vehicle.d22
    root = math.sqrt(max(v_p * v_p - u_R * u_R, 0.0))
    bracket = d22 * u_R**2 * v_p - d22 * v_p**3 - m11 * omega * u_R * v_p * root
    return (bracket + m11 * u_R**2 * v_p_dot - m22 * v_p_dot * v_p**2) / (u_R * v_p * (m11 - m22))
