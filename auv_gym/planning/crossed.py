"""The plan of a vehicle with cross-flow, whose sway force is no longer linear in the yaw rate.

With u = v_p cos(gamma), v = v_p sin(gamma) and gamma' = omega - r the sway equation (2b) is a balance without rates of
the state: (m22 - m11) u r = m22 (v_p' sin(gamma) + u omega) + the damping at v and r. It is quadratic in r where r has
one sign, so that r and gamma' follow from gamma and the path. The equation of gamma is integrated with classical
Runge-Kutta steps over two samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.codegen.derivatives import directional
from auv_gym.codegen.graph import SYMBOLS
from auv_gym.codegen.kernel import Kernel
from auv_gym.physics.dynamics import rates
from auv_gym.physics.namespaces import Array, Namespace, Number
from auv_gym.physics.vehicle import Coefficients, CrossFlow
from auv_gym.planning.sideslip import RATES, PathRates

_VEHICLE = len(Coefficients._fields) + len(CrossFlow._fields)


def yaw_rate(along: PathRates, w: Number, acting: Sequence[Number], ns: Namespace) -> tuple[Number, Number]:
    """Return r [rad/s] at which no sway force is missing on a path, ahead, and whether there is one near no turn.

    Args:
        along: speed, direction and their rates along the path.
        w: sine of the sideslip.
        acting: coefficients of the vehicle and its cross-flow, see `Vehicle.acting`.
        ns: the namespace of the numbers.
    """
    c, x = Coefficients(*acting[: len(Coefficients._fields)]), CrossFlow(*acting[len(Coefficients._fields) :])
    u, v = along.v_p * ns.sqrt(abs(1 - w * w)), along.v_p * w
    slip = abs(v)
    wanted = c.m22 * (along.v_p_dot * w + u * along.omega) + (c.d22 + c.Y_uv * u + c.Y_vv * slip) * v
    side = ns.where(wanted < 0, -1.0, 1.0)  # of r
    slope = (c.m22 - c.m11 + c.Y_ur) * u - x.Y_vr * slip - side * x.Y_rv * v
    square = slope * slope - 4 * side * x.Y_rr * wanted
    return 2 * wanted / (slope + ns.sqrt(abs(square))), (slope > 0) & (square > 0)


def sideslips(along: Array, first: float, acting: Array, h: float) -> Array:
    """Return the sine of the sideslip at every second sample, shape (n,), for `PathRates` of 2 n - 1 samples.

    Args:
        along: the rows of `RATES` at the samples, shape (6, 2 n - 1).
        first: sine of the sideslip at the first sample.
        acting: see `yaw_rate`.
        h: time [s] from one sample to the next.
    """
    times = np.concatenate((along[:, :-2:2], along[:, 1::2], along[:, 2::2])).T
    found = _step()(len(times), w=np.array([[first]]), times=times[:, :, None], vehicle=acting, step=np.array([2 * h]))
    return np.concatenate(([first], found["after"].ravel()))


def motion(along: Array, w: Array, acting: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return psi, u, v, r, F_u, F_r and gamma of motion along a path, see `sideslip.in_sideslip`, shape (7, n).

    And whether there is a yaw rate at which the sway forces balance, shape (n,).
    """
    found = _motion()(along=along, w=w[None], vehicle=acting)
    return found["motion"], found["there"][0] > 0


@cache
def _step() -> Kernel:
    """Return one Runge-Kutta step of the sine of the sideslip, w' = cos(gamma) (omega - r)."""

    def equation(w: Any, times: Any, vehicle: Any, step: Any) -> Mapping[str, Sequence[Any]]:
        begin, middle, end = (PathRates(*times[k : k + len(RATES)]) for k in range(0, len(times), len(RATES)))

        def slope(along: PathRates, w: Any) -> Any:
            return SYMBOLS.sqrt(abs(1 - w * w)) * (along.omega - yaw_rate(along, w, vehicle, SYMBOLS)[0])

        (w_0,), (h,) = w, step
        a = slope(begin, w_0)
        b = slope(middle, w_0 + 0.5 * h * a)
        c = slope(middle, w_0 + 0.5 * h * b)
        d = slope(end, w_0 + h * c)
        after = w_0 + h / 6 * (a + 2 * (b + c) + d)
        return {"w": [after], "after": [after]}

    sizes = {"w": 1, "times": 3 * len(RATES), "vehicle": _VEHICLE, "step": 1}
    return Kernel.traced(equation, sizes, ["times", "after"], shared=["vehicle", "step"])


@cache
def _motion() -> Kernel:
    def equation(along: Any, w: Any, vehicle: Any) -> Mapping[str, Sequence[Any]]:
        path, c = PathRates(*along), Coefficients(*vehicle[: len(Coefficients._fields)])
        cosine = SYMBOLS.sqrt(1 - w[0] * w[0])
        r, there = yaw_rate(path, w[0], vehicle, SYMBOLS)
        gamma_dot = path.omega - r  # (14)
        changes = w[0], path.v_p, path.omega, path.v_p_dot
        by_time = cosine * gamma_dot, path.v_p_dot, path.omega_dot, path.v_p_ddot
        (r_dot,) = directional([r], {symbol.index: d for symbol, d in zip(changes, by_time, strict=True)})
        u, v, gamma = path.v_p * cosine, path.v_p * w[0], SYMBOLS.arcsin(w[0])  # (7), (8)
        u_dot, psi = path.v_p_dot * cosine - v * gamma_dot, path.beta - gamma  # (12), (10)
        _, _, u_free, _, r_free = rates(psi, u, v, r, (0.0, 0.0, 0.0), vehicle, SYMBOLS)
        F_u, F_r = c.m11 * (u_dot - u_free), c.m33 * (r_dot - r_free)  # (16)
        return {"motion": [psi, u, v, r, F_u, F_r, gamma], "there": [SYMBOLS.where(there, 1.0, 0.0)]}

    return Kernel.traced(equation, {"along": len(RATES), "w": 1, "vehicle": _VEHICLE}, shared=["vehicle"])
