"""How long an integration step may be: the fastest rates of a vehicle at the speeds that it can reach."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from auv_gym.physics.dynamics import Load
from auv_gym.physics.vehicle import CrossTerms

MAX_INTEGRATION_STEP = 0.5  # [s]
MAX_STIFFNESS = 2.0
"""Largest product of an integration step and `fastest_rate`: of 60,000 vehicles that were steered at random, none blew
up below 2.1."""
AT_REST: Load = (0.0, 0.0, 0.0)  # surge, sway [m/s] and yaw rate [rad/s] of a vehicle at rest


def longest_step(coefficients: Sequence[Any], load: Load, speeds: Load = AT_REST) -> float:
    """Return the longest integration step [s] for a vehicle, or for all of several in rows, see `fastest_rate`."""
    return min(MAX_INTEGRATION_STEP, MAX_STIFFNESS / float(np.max(fastest_rate(coefficients, load, speeds))))


def substeps_for(period: float, coefficients: Sequence[Any], load: Load) -> int:
    """Return the smallest number of integration steps in a period [s] that are not too long, see `longest_step`."""
    longest = longest_step(coefficients, load)
    return next(n for n in itertools.count(1) if period / n <= longest)


def check_step(h: float, coefficients: Sequence[Any], load: Load, speeds: Load = AT_REST) -> None:
    """Raise ValueError if an integration step of h [s] is too long, see `longest_step`."""
    if not h <= (longest := longest_step(coefficients, load, speeds)):
        cause = (
            _cause(coefficients, load, longest) if longest < 0.06 and speeds is AT_REST else ""
        )  # a doubtful vehicle
        raise ValueError(
            f"an integration step, control_dt / substeps, is {h:.4g} s; it must be at most {longest:.3g} s for this "
            f"vehicle and what acts on it, so raise substeps or lower control_dt{cause}"
        )


def _cause(coefficients: Sequence[Any], load: Load, longest: float) -> str:
    """Return what makes the rates fast: a linear drag that gives an eighth of the fastest one, otherwise the limits."""
    m11, m22, m33 = (float(np.min(c)) for c in coefficients[:3])
    rates = [(float(np.max(coefficients[i + 2])) / m, i) for i, m in enumerate((m11, m22, m33), 1)]
    if 8 * max(rates)[0] * longest > MAX_STIFFNESS:
        return "; d{1}{1}/m{1}{1} is {0:.3g} 1/s: are its units kg, m, s?".format(*max(rates))
    return f"; {load[0]:.3g} N act on {m11:.3g} kg, {load[2]:.3g} N m on {m33:.3g} kg m^2: are these limits right?"


def fastest_rate(coefficients: Sequence[Any], load: Load, speeds: Load = AT_REST) -> Any:
    """Return the fastest rate [1/s] at which velocities change by themselves, at speeds that a load can bring about.

    It is that of the drag, or that of the coupling of the three velocities. The speeds are bounded, since beyond these
    bounds drag dissipates more power than the load supplies: |u| <= X / (2 d11) + sqrt(P / d11) by the linear drag, |u|
    <= sqrt(X / X_uu) + (P / X_uu)^(1/3) by the quadratic one, and so on. P is what the three loads can give: each X^2 /
    (4 d11), or 2/3 X sqrt(X / (3 X_uu)) if that is less. Lift and surge loss are taken to give no power; drag in sway
    and yaw counts less by what the cross terms may give. The side force of a rudder, eps m22 / m33 times the torque, is
    a part of the load.

    Args:
        coefficients: `Vehicle.all_coefficients`, floats or rows (n,).
        load: largest magnitudes.
        speeds: u, v, r at the start.
    """
    m11, m22, m33, *drags = (np.asarray(c, dtype=np.float64) for c in coefficients)
    linear, quadratic, (Y_uv, Y_ur, N_uv, N_ur) = drags[:3], drags[3:6], drags[6:10]
    cross = CrossTerms(*drags[10:]) if len(drags) > 10 else None
    slow, fast = linear, quadratic  # damping that takes power for sure
    if cross is not None:
        load = load[0], load[1] + cross.eps * m22 / m33 * load[2], load[2]
        rest = np.fmax(1 - abs(cross.d23 + cross.d32) / np.sqrt(4 * linear[1] * linear[2]), 0.0)
        slow, fast = [linear[0], rest * linear[1], rest * linear[2]], [*_sure(quadratic, cross)]
    u, v, r = (np.maximum(w, abs(w_0)) for w, w_0 in zip(_reach(load, slow, fast), speeds, strict=True))
    if cross is not None:  # astern, what turns take from the surge force is a load
        surge = load[0] + abs(cross.X_vv) * v * v + abs(cross.X_vr) * v * r + abs(cross.X_rr) * r * r
        u, v, r = (np.maximum(a, b) for a, b in zip(_reach((surge, *load[1:]), slow, fast), (u, v, r), strict=True))
    moving = zip(linear, quadratic, (u, v, r), (m11, m22, m33), (0, Y_uv, N_ur), strict=True)
    decay = [(d + 2 * q * speed + lift * u) / m for d, q, speed, m, lift in moving]
    zero, sway, munk = 0 * u, m11 + abs(Y_ur), m22 - m11 + abs(N_uv)
    rows = (
        (zero, m22 * r / m11, m22 * v / m11),
        ((sway * r + Y_uv * v) / m22, zero, sway * u / m22),
        ((munk * v + N_ur * r) / m33, munk * u / m33, zero),
    )
    coupling = np.moveaxis(np.array(rows), (0, 1), (-2, -1))
    if cross is not None:
        decay, coupling = _crossed(decay, coupling, cross, (v, r), (m11, m22, m33))
    return np.maximum(np.max(decay, axis=0), np.abs(np.linalg.eigvals(coupling)).max(axis=-1))


def _reach(load: Load, linear: Sequence[Any], quadratic: Sequence[Any]) -> list[Any]:
    """Return |u|, |v|, |r| at which drag takes away all power that the load can give."""
    acting = list(zip(load, linear, quadratic, strict=True))
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # no quadratic drag: no bound by it
        power = sum(np.fmin(F * F / (4 * d), 2 / 3 * F * np.sqrt(F / (3 * q))) for F, d, q in acting)
        return [np.fmin(F / (2 * d) + np.sqrt(power / d), np.sqrt(F / q) + np.cbrt(power / q)) for F, d, q in acting]


def _sure(quadratic: Sequence[Any], cross: CrossTerms) -> tuple[Any, Any, Any]:
    """Return X_uu, and lower bounds of Y_vv and N_rr for any sign of the cross-flow terms.

    By |v|^2 |r| <= (2 |v|^3 + |r|^3) / 3, for v and r in units in which Y_vv and N_rr are equal.
    """
    X_uu, Y_vv, N_rr = quadratic
    one, other = cross.slopes(Y_vv, N_rr)
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.cbrt(N_rr / Y_vv)
        first, second = (np.fmin(one[k], other[k]) / (Y_vv * size**k) for k in (1, 2))
        first, second = (np.where(np.isnan(x), -np.inf, np.minimum(x, 0.0)) for x in (first, second))
    return X_uu, Y_vv * np.fmax(1 + (2 * first + second) / 3, 0.0), N_rr * np.fmax(1 + (first + 2 * second) / 3, 0.0)


def _crossed(
    decay: list[Any], coupling: Any, cross: CrossTerms, speeds: tuple[Any, Any], masses: Sequence[Any]
) -> tuple[list[Any], Any]:
    """Return the rates of decay and of coupling with what cross terms and surge loss add at most at v and r.

    Decay is on the diagonal of the coupling as well, since linear cross terms couple what decays fast.
    """
    X_vv, X_vr, X_rr, Y_rv, Y_vr, Y_rr, N_vv, N_rv, N_vr, d23, d32, _ = (abs(c) for c in cross)
    (v, r), (m11, m22, m33) = speeds, masses
    more = 0 * v, ((Y_rv + Y_vr) * r) / m22, ((N_rv + N_vr) * v) / m33
    zero = 0 * v
    rows = (
        (zero, (2 * X_vv * v + X_vr * r) / m11, (X_vr * v + 2 * X_rr * r) / m11),
        (zero, zero, ((Y_rv + Y_vr) * v + 2 * Y_rr * r + d23) / m22),
        (zero, (2 * N_vv * v + (N_rv + N_vr) * r + d32) / m33, zero),
    )
    decay = [a + b for a, b in zip(decay, more, strict=True)]
    diagonal = np.eye(3) * np.moveaxis(np.array(decay), 0, -1)[..., None]
    return decay, coupling + np.moveaxis(np.array(rows), (0, 1), (-2, -1)) + diagonal
