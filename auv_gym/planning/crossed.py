"""The plan of a vehicle with cross terms, whose sway force is no longer linear in the yaw rate.

With u = v_p cos(gamma), v = v_p sin(gamma) and gamma' = omega - r the sway equation (2b) is a balance without rates of
the state: v_p' sin(gamma) + u (omega - r) is the sway acceleration of `dynamics.rates` at u, v and r. Newton's method
gives r, and with it gamma'. The equation of gamma is integrated with classical Runge-Kutta steps over two samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.codegen.derivatives import directional
from auv_gym.codegen.graph import SYMBOLS, Symbol
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.dynamics import rates
from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import Coefficients
from auv_gym.planning.sideslip import RATES, PathRates

_ITERATIONS = 6  # of Newton's method; the balance is quadratic in r where v and r keep their signs
_LARGEST_SINE = 0.9  # of the first sideslip
_TOLERANCE = 1e-9  # largest residual of the balance, as a share of the accelerations in it
_NEGLIGIBLE = 1e-15  # [m/s^2] residual that is always allowed: on a long straight line all accelerations vanish


def _missing(along: PathRates, w: Symbol, r: Symbol, acting: Sequence[Symbol]) -> tuple[Symbol, Symbol]:
    """Return the sway acceleration [m/s^2] that is missing on a path at a yaw rate r, and the sum of the magnitudes."""
    u, v = along.v_p * SYMBOLS.sqrt(abs(1 - w * w)), along.v_p * w
    _, _, _, v_dot, _ = rates(along.beta, u, v, r, (0.0, 0.0, 0.0), acting, SYMBOLS)
    needed = along.v_p_dot * w + u * along.omega
    return needed - u * r - v_dot, abs(needed) + abs(u * r) + abs(v_dot)


def _zero(f: Callable[[Symbol], Symbol], x: Symbol, most: float = math.inf) -> tuple[Symbol, Symbol]:
    """Return where f is zero, by Newton's method within +-most from a guess in a node of its own, and f' there."""
    for _ in range(_ITERATIONS):
        (slope,) = directional([value := f(x)], {x.index: 1.0})
        x = x - value / slope
        x = x if math.isinf(most) else SYMBOLS.clip(x, -most, most)
    return x, directional([f(x)], {x.index: 1.0})[0]


def _yaw_rate(along: PathRates, w: Symbol, acting: Sequence[Symbol]) -> tuple[Symbol, Symbol]:
    """Return r [rad/s] at which no sway force is missing, and the derivative of what is missing by r there."""
    return _zero(lambda r: _missing(along, w, r, acting)[0], 1.1 * along.omega)


def steady_sideslips(along: Array, acting: Array) -> tuple[Array, Array]:
    """Return the sine of the sideslip without the fast transient, and the rate [1/s] of this transient, shapes (n,).

    Args:
        along: the rows of `RATES` at the samples, shape (6, n).
        acting: see `Vehicle.acting`; with cross terms.
    """
    results = _steady(len(acting))(along=along, vehicle=acting)
    return results["w"][0], results["rate"][0]


def sideslips(along: Array, first: float, acting: Array, h: float) -> Array:
    """Return the sine of the sideslip at every second sample, shape (n,), for `PathRates` of 2 n - 1 samples.

    Args:
        along: the rows of `RATES` at the samples, shape (6, 2 n - 1).
        first: sine of the sideslip at the first sample.
        acting: see `Vehicle.acting`; with cross terms.
        h: time [s] from one sample to the next.
    """
    times = np.concatenate((along[:, :-2:2], along[:, 1::2], along[:, 2::2])).T
    results = _step(len(acting))(
        len(times), w=np.array([[first]]), times=times[:, :, None], vehicle=acting, step=np.array([2 * h])
    )
    return np.concatenate(([first], results["after"].ravel()))


def motion(along: Array, w: Array, acting: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return psi, u, v, r, F_u, F_r and gamma of motion along a path, see `sideslip.in_sideslip`, shape (7, n).

    And whether there is a yaw rate at which the sway forces balance, shape (n,).
    """
    results = _motion(len(acting))(along=along, w=w[None], vehicle=acting)
    return results["motion"], results["there"][0] > 0


@cache
def _steady(size: int) -> Kernel:
    """Return the kernel of `steady_sideslips`, which has two estimates of gamma': 0, then the one that follows."""

    def equation(along: Any, vehicle: Any) -> Mapping[str, Sequence[Any]]:
        path = PathRates(*along)

        def missing(w: Symbol, r: Symbol) -> Symbol:
            return _missing(path, w, r, vehicle)[0]

        w, slope = _zero(lambda w: missing(w, path.omega), -0.1 * path.omega, _LARGEST_SINE)
        changes = (path.v_p, path.v_p_dot), (path.omega, path.omega_dot), (path.v_p_dot, path.v_p_ddot)
        directions = {**{symbol.index: rate for symbol, rate in changes}, w.index: 0.0}
        w_dot = -directional([missing(w, path.omega)], directions)[0] / slope
        r = path.omega - w_dot / SYMBOLS.sqrt(1 - w * w)
        w, slope = _zero(lambda w: missing(w, r), w, _LARGEST_SINE)
        (by_r,) = directional([missing(w, r)], {r.index: 1.0, w.index: 0.0})
        return {"w": [w], "rate": [abs(slope / by_r)]}

    return Kernel.traced(equation, {"along": len(RATES), "vehicle": size}, shared=["vehicle"])


@cache
def _step(size: int) -> Kernel:
    """Return one Runge-Kutta step of the sine of the sideslip, w' = cos(gamma) (omega - r)."""

    def equation(w: Any, times: Any, vehicle: Any, step: Any) -> Mapping[str, Sequence[Any]]:
        begin, middle, end = (PathRates(*times[k : k + len(RATES)]) for k in range(0, len(times), len(RATES)))

        def slope(along: PathRates, w: Any) -> Any:
            return SYMBOLS.sqrt(abs(1 - w * w)) * (along.omega - _yaw_rate(along, w, vehicle)[0])

        (w_0,), (h,) = w, step
        a = slope(begin, w_0)
        b = slope(middle, w_0 + 0.5 * h * a)
        c = slope(middle, w_0 + 0.5 * h * b)
        d = slope(end, w_0 + h * c)
        after = w_0 + h / 6 * (a + 2 * (b + c) + d)
        return {"w": [after], "after": [after]}

    sizes = {"w": 1, "times": 3 * len(RATES), "vehicle": size, "step": 1}
    return Kernel.traced(equation, sizes, ["times", "after"], shared=["vehicle", "step"])


@cache
def _motion(size: int) -> Kernel:
    def equation(along: Any, w: Any, vehicle: Any) -> Mapping[str, Sequence[Any]]:
        path, c = PathRates(*along), Coefficients(*vehicle[: len(Coefficients._fields)])
        cosine = SYMBOLS.sqrt(1 - w[0] * w[0])
        r, slope = _yaw_rate(path, w[0], vehicle)
        missing, magnitude = _missing(path, w[0], r, vehicle)
        gamma_dot = path.omega - r  # (14)
        changes = w[0], path.v_p, path.omega, path.v_p_dot
        by_time = cosine * gamma_dot, path.v_p_dot, path.omega_dot, path.v_p_ddot
        directions = {symbol.index: d for symbol, d in zip(changes, by_time, strict=True)}
        r_dot = -directional([missing], {**directions, r.index: 0.0})[0] / slope
        there = (slope < 0) & (abs(missing) <= _TOLERANCE * magnitude + _NEGLIGIBLE)
        u, v, gamma = path.v_p * cosine, path.v_p * w[0], SYMBOLS.arcsin(w[0])  # (7), (8)
        u_dot, psi = path.v_p_dot * cosine - v * gamma_dot, path.beta - gamma  # (12), (10)
        _, _, u_free, _, r_free = rates(psi, u, v, r, (0.0, 0.0, 0.0), vehicle, SYMBOLS)
        F_u, F_r = c.m11 * (u_dot - u_free), c.m33 * (r_dot - r_free)  # (16)
        return {"motion": [psi, u, v, r, F_u, F_r, gamma], "there": [SYMBOLS.where(there, 1.0, 0.0)]}

    return Kernel.traced(equation, {"along": len(RATES), "w": 1, "vehicle": size}, shared=["vehicle"])
