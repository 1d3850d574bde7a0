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
from functools import cache, cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.dynamics import rates
from auv_gym.feasibility import check, check_forces, check_rates
from auv_gym.namespaces import ARRAYS, Namespace, Number
from auv_gym.paths import Path, evaluate
from auv_gym.vehicle import Coefficients, Vehicle

Array = NDArray[np.float64]

RUN_IN = 12.0  # integrated before the first sample, in memories Dm/d22; the small start error fades by exp(-12)
MAX_STEP = 0.4  # largest integration step, in memories Dm/d22
MAX_RESPONSE = 0.1  # largest integration step times the rate at which the rest responds to w; unstable above 0.3
MAX_REFINEMENT = 128  # of the step for that reason
MAX_SIDESLIP = math.radians(80.0)  # beyond it a vehicle drifts rather than travels
ORDER = 4  # samples in each integration formula
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


@dataclass(frozen=True, eq=False)
class PathRates:
    """Speed, direction and their rates along a path, arrays of one shape or other numbers."""

    v_p: Number  # [m/s] (3)
    beta: Number  # [rad] (4), by atan2
    omega: Number  # [rad/s] (5)
    v_p_dot: Number  # [m/s^2] (6)
    omega_dot: Number  # [rad/s^2]
    v_p_ddot: Number  # [m/s^3]


def path_rates(derivatives: Any, ns: Namespace = ARRAYS) -> PathRates:
    """Return speed, direction and their rates from position and three time derivatives, shape (4, 2, ...)."""
    (x1, y1), (x2, y2), (x3, y3) = derivatives[1:]
    v_p = ns.hypot(x1, y1)
    with np.errstate(divide="ignore", invalid="ignore"):  # a standstill is reported by `plan`, with its place
        omega = (x1 * y2 - y1 * x2) / v_p**2
        v_p_dot = (x1 * x2 + y1 * y2) / v_p
        omega_dot = (x1 * y3 - y1 * x3) / v_p**2 - 2 * omega * v_p_dot / v_p
        v_p_ddot = (x1 * x3 + y1 * y3) / v_p + v_p * omega**2
    return PathRates(v_p, ns.arctan2(y1, x1), omega, v_p_dot, omega_dot, v_p_ddot)


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
        ValueError: the times are not an evenly spaced, increasing, finite grid inside the path's domain, or the plan
            would need more than `MAX_SAMPLES` samples.
        InfeasibleReferenceError: the speed passes through zero, braking is faster than the sway drag allows, the
            sideslip exceeds `MAX_SIDESLIP`, or the open-loop forces exceed their limits.
    """
    paths = path if isinstance(path, Sequence) else (path,)
    times = _checked_times(times, paths)
    if isinstance(path, Sequence) and len(path) * len(times) > MAX_SAMPLES // MARGIN:
        return _side_by_side([plan(p, vehicle, times, force_limits) for p in path])
    memory = (vehicle.m22 - vehicle.m11) / vehicle.d22
    spacing = float(times[-1] - times[0]) / (len(times) - 1)
    substeps = max(math.ceil(spacing / (MAX_STEP * memory)), math.ceil(ORDER / (len(times) - 1)))
    run_in, *others = {min(RUN_IN * memory, float(times[0] - p.start)) for p in paths}
    if others:  # each as it would be alone
        return _side_by_side([plan(p, vehicle, times, force_limits) for p in paths])
    fine = _look_along(path, vehicle, times, substeps, run_in)
    refinement = min(math.ceil(fine.h * _response(fine.along, vehicle) / MAX_RESPONSE), MAX_REFINEMENT)
    if refinement > 1:
        if isinstance(path, Sequence):
            return _side_by_side([plan(p, vehicle, times, force_limits) for p in paths])
        fine = _look_along(path, vehicle, times, substeps * refinement, run_in)
    w = _sine_of_sideslip(fine.along, vehicle, fine.h)
    _check_sideslip(w, fine)
    kept = PathRates(*(getattr(fine.along, field.name)[fine.rows] for field in fields(PathRates)))
    reference = assemble(times, fine.position[:, fine.rows], kept, w[fine.rows], vehicle)
    if force_limits is not None:
        check_forces(reference.F_u, reference.F_r, force_limits, times, fine.position[:, fine.rows])
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
    check(
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
    derivatives = evaluate(path, fine) if isinstance(path, Sequence) else path.derivatives(fine)
    rows = _along_kernel()(derivatives=derivatives.reshape(2 * len(derivatives), -1))["along"]
    along = PathRates(*rows.reshape(-1, *derivatives.shape[2:]))
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


def _response(along: PathRates, vehicle: Vehicle) -> float:
    """Return the largest rate [1/s] at which the rest of the equation for w responds to w, with gamma quasi-steady."""
    a, turn = along.v_p_dot / along.v_p, vehicle.m11 * np.abs(along.omega)
    tan = np.minimum(turn / (vehicle.d22 + vehicle.m22 * a), math.tan(MAX_SIDESLIP))
    drag = 2 * vehicle.Y_vv * along.v_p * tan / np.sqrt(1 + tan * tan)
    return float((vehicle.m22 * np.abs(a) + turn * tan + drag).max()) / (vehicle.m22 - vehicle.m11)


def _sine_of_sideslip(along: PathRates, vehicle: Vehicle, h: float) -> Array:
    """Integrate the equation of the module's docstring for w over samples h [s] apart, along axis 0.

    In the symbols of Cox and Matthews it is u' = c u + F(u, t) with u = w and c = -d22/Dm, and `F` below is h F:
    u_(n+1) = e^(c h) u_n + g_0 F_n + g_1 F_(n-1) + g_2 F_(n-2) + g_3 F_(n-3). Where it passes 90 degrees it may give
    what is no number, which the caller refuses.
    """
    Dm = vehicle.m22 - vehicle.m11
    z = vehicle.d22 / Dm * h  # -c h
    terms = np.stack([h / Dm * term for term in sideslip_terms(along, vehicle)], axis=1)
    inputs = np.ascontiguousarray(terms.reshape(len(terms), 3, -1))
    lanes = np.ones(inputs.shape[2])
    start = np.tile(slow_sideslip(along, vehicle).ravel(), (ORDER, 1))
    weights = [math.exp(-k * z) for k in range(1, ORDER)] + [g for k in range(1, ORDER) for g in _weights(z, 0, k)]
    opening = _opening()(
        FIXED_POINT, u=start, inputs=inputs[:ORDER].reshape(-1, len(lanes)), weights=np.outer(weights, lanes)
    )
    rates = np.outer((math.exp(-z), *_weights(z, 1 - ORDER, 1)), lanes)
    u = np.empty((len(inputs), 1, len(lanes)))
    u[:ORDER, 0] = opening["u"]
    history = np.concatenate((opening["u"][-1:], opening["rest"][-2::-1]))
    step = _recursion().bound(history=history, weights=rates, inputs=inputs, u=u[1:])  # from n it gives u_(n+1)
    step(ORDER - 1, len(inputs) - ORDER)
    return u.reshape(along.v_p.shape)


FIXED_POINT = 12  # iterations for the first samples, which settle within fewer


@cache
def _opening() -> Kernel:
    """Return one iteration for the first `ORDER` samples jointly: a fixed point of the integral over their interpolant.

    `inputs` are the terms of each sample; `weights` the decays to all but the first, then the weights of each.
    """

    def equation(u: Any, inputs: Any, weights: Any) -> dict[str, Any]:
        terms = (inputs[j : j + 3] for j in range(0, 3 * ORDER, 3))
        F = [sideslip_rest(a, q, b, w, SYMBOLS.sqrt) for (a, q, b), w in zip(terms, u, strict=True)]
        decays, rows = weights[: ORDER - 1], [weights[j : j + ORDER] for j in range(ORDER - 1, len(weights), ORDER)]
        after = [_plus(decay * u[0], row, F) for decay, row in zip(decays, rows, strict=True)]
        return {"u": (u[0], *after), "rest": F}

    return Kernel.traced(equation, {"u": ORDER, "inputs": 3 * ORDER, "weights": (ORDER - 1) * (ORDER + 1)})


@cache
def _recursion() -> Kernel:
    """Return one step of the formula; `history` is u_n, F_(n-1), F_(n-2), F_(n-3), `weights` decay and g_3 ... g_0."""

    def equation(history: Any, weights: Any, inputs: Any) -> dict[str, Any]:
        (u_n, *past), (a, q, b) = history, inputs
        F = [sideslip_rest(a, q, b, u_n, SYMBOLS.sqrt), *past]
        decay, *g = weights
        u = _plus(decay * u_n, g[::-1], F)
        return {"history": (u, *F[:-1]), "u": (u,)}

    return Kernel.traced(equation, {"history": ORDER, "weights": ORDER + 1, "inputs": 3}, ["inputs", "u"])


def _plus(total: Any, weights: Sequence[Any], F: Sequence[Any]) -> Any:
    for g, rest in zip(weights, F, strict=True):
        total = total + g * rest
    return total


def sideslip_terms(along: PathRates, vehicle: Vehicle | Coefficients) -> tuple[Number, Number, Number]:
    """Return what multiplies w, |w| w and sqrt(1 - w^2) in the bracket of the module's docstring."""
    return vehicle.m22 * along.v_p_dot / along.v_p, vehicle.Y_vv * along.v_p, vehicle.m11 * along.omega


def sideslip_rest(slope: Number, square: Number, turn: Number, w: Number, sqrt: Callable[[Number], Number]) -> Number:
    """Return minus the bracket for its `sideslip_terms`, all of them scaled by the same factor."""
    return -(slope + square * abs(w)) * w - turn * sqrt(abs(1 - w * w))  # abs: past 90 degrees


def slow_sideslip(along: PathRates, vehicle: Vehicle) -> Any:
    """Return the `steady_sideslip` of the first sample."""
    first = PathRates(*(getattr(along, field.name)[0] for field in fields(PathRates)))
    return np.asarray(steady_sideslip(first, vehicle, ARRAYS))


def steady_sideslip(along: PathRates, vehicle: Vehicle | Coefficients, ns: Namespace) -> Number:
    """Return w free of the fast transient: two passes of m11 omega + D tan(gamma) = -Dm gamma'."""
    a = along.v_p_dot / along.v_p
    linear, turn = vehicle.d22 + vehicle.m22 * a, vehicle.m11 * along.omega
    slope = ns.sqrt(linear**2 + 4 * vehicle.Y_vv * along.v_p * abs(turn))  # of D tan(gamma) by tan(gamma)
    tan = -2 * turn / (linear + slope)
    D_dot = vehicle.m22 * (along.v_p_ddot / along.v_p - a * a)
    gamma_dot = -(vehicle.m11 * along.omega_dot + D_dot * tan) / (slope * (1 + tan * tan))
    tan = tan - (vehicle.m22 - vehicle.m11) * gamma_dot / slope
    return tan / ns.sqrt(1 + tan * tan)


def sideslip_step(
    w: Number, rest: Number, rest_at: Callable[[Number], Number], z: Number, largest: float, ns: Namespace = ARRAYS
) -> tuple[Number, Number]:
    """Return w, cut off at +-`largest`, and the rest of its equation one step of z memories later.

    By the exponential Runge-Kutta formula of second order (Cox and Matthews 2002, eq. 22): less exact than `plan`, but
    it needs no history, so that it can follow a sea that is only known as time goes by.

    Args:
        w: sine of the sideslip before the step.
        rest: the rest of the equation there, times the step.
        rest_at: the same as a function of w behind the step.
        z: the step in memories Dm/d22.
        largest: cut-off of w.
        ns: the namespace of the numbers.
    """
    decay = ns.exp(-z)
    guess = decay * w + (1 - decay) / z * rest
    correction = rest_at(ns.clip(guess, -largest, largest)) - rest
    new = ns.clip(guess + (z - 1 + decay) / (z * z) * correction, -largest, largest)
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
        position: x, y of the path at those times [m].
        along: speed, direction and their rates along the path at those times.
        w: sine of the sideslip.
        vehicle: whose plan it is.
        sway_load: external force Y on the hull along its sway axis [N], in (2b), and its rate [N/s].
    """
    rows = np.array([getattr(along, field.name) for field in fields(PathRates)])
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


BETA = [field.name for field in fields(PathRates)].index("beta")
"""The place of the path's direction among its rates."""


@cache
def _along_kernel() -> Kernel:
    """Return `path_rates` as a kernel."""

    def equation(derivatives: Any) -> dict[str, Any]:
        pairs = list(zip(derivatives[::2], derivatives[1::2], strict=True))
        along = path_rates(pairs, SYMBOLS)
        return {"along": [getattr(along, field.name) for field in fields(PathRates)]}

    return Kernel.traced(equation, {"derivatives": 8})


@cache
def _motion_kernel(loaded: bool, several: bool) -> Kernel:
    """Return `in_sideslip` as a kernel, with a sway load or without, for several vehicles or one."""

    def equation(along: Any, w: Any, coefficients: Any, load: Any = (0.0, 0.0)) -> dict[str, Any]:
        vehicle, (Y, Y_rate) = Coefficients(*coefficients), load
        return {"motion": in_sideslip(PathRates(*along), w[0], vehicle, (Y, Y_rate), SYMBOLS)}

    rows = {"along": len(fields(PathRates)), "w": 1, "coefficients": len(Coefficients._fields)}
    shared = [] if several else ["coefficients"]
    return Kernel.traced(equation, {**rows, "load": 2} if loaded else rows, shared=shared)


def in_sideslip(
    along: PathRates, w: Number, coefficients: Coefficients, sway_load: tuple[Number, Number], ns: Namespace
) -> tuple[Number, ...]:
    """Return psi [rad], u, v [m/s], r [rad/s], F_u [N], F_r [N m] and gamma of motion along a path, see `assemble`."""
    m11, m22, m33, _, d22, *_, Y_vv, _ = coefficients
    v_p, beta, om, v_p_dot, om_dot, v_p_ddot = (getattr(along, field.name) for field in fields(PathRates))
    c = ns.sqrt(1 - w * w)
    tan, gamma, a = w / c, ns.arcsin(w), v_p_dot / v_p
    u, v = v_p * c, v_p * w  # (7), (8)
    D = d22 + Y_vv * abs(v) + m22 * a
    push = sway_load[0] / u
    gamma_dot = -(m11 * om + D * tan - push) / (m22 - m11)
    u_dot, v_dot = v_p_dot * c - v * gamma_dot, v_p_dot * w + u * gamma_dot  # (12)
    side = ns.where(v < 0, -1.0, ns.where(v > 0, 1.0, 0.0))
    D_dot = Y_vv * side * v_dot + m22 * (v_p_ddot / v_p - a * a)
    push_dot = sway_load[1] / u + push * (tan * gamma_dot - a)
    gamma_ddot = -(m11 * om_dot + D_dot * tan + D * gamma_dot / c**2 - push_dot) / (m22 - m11)
    psi = beta - gamma  # (10) with the signed sideslip
    r, r_dot = om - gamma_dot, om_dot - gamma_ddot  # (14)
    _, _, u_free, _, r_free = rates(psi, u, v, r, (0.0, 0.0, 0.0), coefficients, ns)
    return psi, u, v, r, m11 * (u_dot - u_free), m33 * (r_dot - r_free), gamma  # (16)


def printed_surge_rate(u_R: float, v_p: float, v_p_dot: float, omega: float, vehicle: Vehicle) -> float:
    """Return u_R' [m/s^2] by (15) as printed, with its v_R^3 read as the norm v_p^3 as (15') confirms.

    For comparison only: it holds for clockwise curves (omega < 0) and is singular at u_R = v_p.
    """
    m11, m22, d22 = vehicle.m11, vehicle.m22, vehicle.d22
    root = math.sqrt(max(v_p * v_p - u_R * u_R, 0.0))
    bracket = d22 * u_R**2 * v_p - d22 * v_p**3 - m11 * omega * u_R * v_p * root
    return (bracket + m11 * u_R**2 * v_p_dot - m22 * v_p_dot * v_p**2) / (u_R * v_p * (m11 - m22))
