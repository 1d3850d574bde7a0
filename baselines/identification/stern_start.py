"""Where the fit to a log of propeller and rudder begins: the equations of motion at each instant, by least squares."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import least_squares

from auv_gym.physics.dynamics import rates
from auv_gym.physics.errors import to_body
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.steering import Stern, stern_load, thrust
from auv_gym.physics.vehicle import SIGNED_PARAMETERS
from auv_gym.physics.wind import WindDrag, wind_load
from baselines.identification.log import Log
from baselines.identification.model import (
    AHEAD,
    COEFFICIENTS,
    STERN_NAMES,
    WIND_NAMES,
    parameter_names,
)
from baselines.identification.start import Begin, balance, shares_of, smoothed

KNOWN_FIRST = ("m11", "m22", "m33", "arm")
"""What must be known of a vessel whose log has no force or no moment in it."""
_WINDOW = 5  # rows that speeds are smoothed over
_RESISTANCE = 0.05  # resistance ahead, as a share of m11 U^2/arm
NOT_NEGATIVE_STERN = ("T_nn", "side", "drag", "wash", "wake", "straight", "X_air", "Y_air")
"""Parameters of propeller, rudder and wind that are not negative."""
_EVALUATIONS = 60
_WEAK = frozenset(
    (*COEFFICIENTS[6:], "T_nu", "wash", "wake", "straight", "uneven", "neutral", AHEAD, "N_air", "N_turn")
)
"""Parameters that are taken to be small where the log hardly shows them."""
_RIDGE = 0.3  # their standard deviation before the log is seen, in typical sizes


def stern_start(log: Log, terms: Sequence[str], known: Mapping[str, float]) -> Begin:
    """Return where the search begins in a log of thrust, or revolutions, and rudder.

    Args:
        log: what was measured and commanded.
        terms: names of the optional parameters of the vehicle that may differ from 0.
        known: values of parameters by name, those of `KNOWN_FIRST` among them.

    Raises:
        ValueError: one of `KNOWN_FIRST` is not known.
    """
    if missing := [name for name in KNOWN_FIRST if name not in known]:
        raise ValueError(
            f"a log of {log.kind} and rudder does not show {', '.join(missing)}: give them as known. As a rule m11 is "
            "1.05 times the mass m, m22 1.8 m, m33 0.1 m L^2, and arm half the length L"
        )
    names = parameter_names(log.kind, log.wind is not None, len(log.starts))
    speeds, accelerations = smoothed(log, _WINDOW)
    scales = _typical(log, speeds, accelerations, known)
    begin = dict.fromkeys(names, 0.0) | {n: scales[n] for n in (*COEFFICIENTS[:9], "T_nn", "side") if n in names}
    begin |= {name: value for name, value in known.items() if name in names}
    positive = (*(name for name in COEFFICIENTS[3:] if name not in SIGNED_PARAMETERS), *NOT_NEGATIVE_STERN)
    low = dict.fromkeys(positive, 0.0) | {name: 1e-6 * scales[name] for name in COEFFICIENTS[3:6]}
    own = STERN_NAMES[log.kind]
    fitted = [*COEFFICIENTS[3:13], *own, *(WIND_NAMES if log.wind is not None else ())]
    chosen = [n for n in fitted if n not in known and (n not in COEFFICIENTS[6:] or n in terms)]
    weights = 1 / np.maximum(accelerations.std(axis=1), 1e-12)

    def left(x: Array) -> Array:
        values = begin | {name: float(a) * scales[name] for name, a in zip(chosen, x, strict=True)}
        return np.asarray((weights[:, None] * (_accelerations(log, speeds, values) - accelerations)).ravel())

    first = np.array([begin[name] / scales[name] for name in chosen])
    least = np.array([low.get(name, -np.inf) / scales[name] for name in chosen])
    done = least_squares(left, np.maximum(first, least), bounds=(least, np.inf), max_nfev=_EVALUATIONS)
    begin |= {name: float(a) * scales[name] for name, a in zip(chosen, done.x, strict=True)}
    motion = np.concatenate((speeds, accelerations, np.zeros((2, len(log.t)))))
    parts = balance()(motion=motion, coefficients=np.ones(len(COEFFICIENTS)))["terms"].reshape(3, len(COEFFICIENTS), -1)
    shares = dict(zip(COEFFICIENTS, shares_of(parts, np.array([begin[n] for n in COEFFICIENTS])).tolist(), strict=True))
    bounds = np.array([[low.get(n, -np.inf), np.inf] for n in names]).T
    bounds[:, -1] = 0.0, 0.1 * log.duration
    optional = [n for n in names if n not in known and n not in COEFFICIENTS[:3]]
    free = tuple(n for n in optional if n not in COEFFICIENTS[6:] or n in terms)
    values, sizes = (np.array([table[name] for name in names]) for table in (begin, scales))
    weak = np.array([name in _WEAK for name in names])
    return Begin(values, sizes, (bounds[0], bounds[1]), free, shares, np.where(weak, _RIDGE * sizes, np.inf))


def _accelerations(log: Log, speeds: Array, values: Mapping[str, float]) -> Array:
    """Return what the equations of motion make of the velocities and commands at each instant, shape (3, T)."""
    u, v, r = speeds
    v = v + values[AHEAD] * r
    stern = Stern(*(values.get(name, 0.0) for name in Stern._fields))
    one, other = log.commands.T
    T = thrust(one, u, stern) if log.kind == "revolutions" else one
    load = stern_load(T, other, u, v, r, stern, ARRAYS)
    if log.wind is not None:
        c, s = np.cos(log.measured[:, 2]), np.sin(log.measured[:, 2])
        air = to_body(log.wind[:, 0], log.wind[:, 1], c, s)
        drag = wind_load(u - air[0], v - air[1], WindDrag(*(values[name] for name in WIND_NAMES)), ARRAYS)
        load = load[0] + drag[0], load[1] + drag[1], load[2] + drag[2]
    _, _, a_u, a_v, a_r = rates(0.0, u, v, r, load, [values[name] for name in COEFFICIENTS], np)
    return np.array((a_u, a_v, a_r))


def _typical(log: Log, speeds: Array, accelerations: Array, known: Mapping[str, float]) -> dict[str, float]:
    """Return a typical size of each parameter, at which its force is a tenth of those that act."""
    m11, m22, m33, arm = (known[name] for name in KNOWN_FIRST)
    U, V, R = np.maximum(np.sqrt(np.mean(speeds**2, axis=1)), 1e-9).tolist()
    A = np.sqrt(np.mean(accelerations**2, axis=1))
    X = _RESISTANCE * m11 * U * U / arm + m11 * A[0]
    Y, N = m22 * A[1] + m11 * U * R, m33 * A[2] + 0.3 * arm * (m22 * A[1] + m11 * U * R)
    one, other = np.maximum(np.sqrt(np.mean(log.commands**2, axis=0)), 1e-9).tolist()
    bases = {
        "d11": X / U, "X_uu": X / (U * U), "X_vv": X / (V * V), "X_vr": X / (V * R), "X_rr": X / (R * R),
        "d22": Y / V, "Y_vv": Y / (V * V), "Y_uv": Y / (U * V), "Y_ur": Y / (U * R),
        "Y_rv": Y / (R * V), "Y_vr": Y / (V * R), "Y_rr": Y / (R * R),
        "d33": N / R, "N_rr": N / (R * R), "N_uv": N / (U * V), "N_ur": N / (U * R),
        "N_vv": N / (V * V), "N_rv": N / (R * V), "N_vr": N / (V * R),
    }  # fmt: skip
    scales = {name: 0.1 * size for name, size in bases.items()} | {"m11": m11, "m22": m22, "m33": m33}
    scales |= {"T_nn": X / one**2, "T_nu": 0.1 * X / (one * U), "side": Y / (U * U * other)}
    scales |= {"drag": X / (U * other) ** 2}
    scales |= {
        "wash": 0.1 * U * U / X,
        "wake": 0.1,
        "straight": 0.1,
        "uneven": 0.1,
        "neutral": 0.02,
        "arm": arm,
        AHEAD: 0.1 * arm,
    }
    if log.wind is not None:
        W = max(float(np.sqrt(np.mean(np.sum(log.wind**2, axis=1)))), 1e-9)
        scales |= {"X_air": 0.1 * X / W**2, "Y_air": 0.1 * Y / W**2, "N_air": 0.1 * N / W**2, "N_turn": 0.1 * N / W**2}
    currents = {f"{axis}{'' if len(log.starts) == 1 else f' {k + 1}'}": 0.1 * U
                for axis in ("V_x", "V_y") for k in range(len(log.starts))}  # fmt: skip
    return scales | currents | {"lag": log.dt}
