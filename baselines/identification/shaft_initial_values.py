"""Initial values for a log of propeller and rudder: least squares on the equations of motion at each instant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import least_squares

from auv_gym.physics.dynamics import rates
from auv_gym.physics.namespaces import ARRAYS, Array
from auv_gym.physics.vehicle import SIGNED_PARAMETERS
from baselines.identification.least_squares import InitialValues
from baselines.identification.linear_fit import force_shares, regressors, smoothed
from baselines.identification.log import Log
from baselines.identification.model import AHEAD, COEFFICIENTS, STERN_NAMES, WIND_NAMES, is_current, load_of, names_of

GIVEN = ("m11", "m22", "m33", "arm")
"""Names of the parameters that must be known for a log of thrust or revolutions and rudder."""
_WINDOW = 5  # number of rows of the smoothing
_RESISTANCE = 0.05  # resistance in surge, as a share of m11 U^2/arm
NOT_NEGATIVE_STERN = ("T_nn", "side", "drag", "wash", "wake", "straight", "X_air", "Y_air")
"""Names of the parameters of propeller, rudder and wind that are not negative."""
_MAX_EVALUATIONS = 60
_WEAK = frozenset(
    (*COEFFICIENTS[6:], "T_nu", "wash", "wake", "straight", "uneven", "neutral", AHEAD, "N_air", "N_turn")
)
"""Names of the parameters with a prior, which keeps them small if the log has little information on them."""
_PRIOR = 0.3  # standard deviation of the prior, in units of the scale


def shaft_initial_values(log: Log, terms: Sequence[str], known: Mapping[str, float]) -> InitialValues:
    """Return initial values for a log of thrust, or revolutions, and rudder.

    Args:
        log: the log with measurements and commands.
        terms: names of the optional coefficients that may differ from 0.
        known: values of parameters by name; they must include `GIVEN`.

    Raises:
        ValueError: one of `GIVEN` is not known.
    """
    if missing := [name for name in GIVEN if name not in known]:
        raise ValueError(
            f"a log of {log.kind} and rudder does not show {', '.join(missing)}: give them as known. As a rule m11 is "
            "1.05 times the mass m, m22 1.8 m, m33 0.1 m L^2, and arm half the length L"
        )
    names = names_of(log)
    speeds, accelerations = smoothed(log, _WINDOW)
    scales = _scales(log, speeds, accelerations, known)
    values = dict.fromkeys(names, 0.0) | {n: scales[n] for n in (*COEFFICIENTS[:9], "T_nn", "side") if n in names}
    values |= {name: value for name, value in known.items() if name in names}
    positive = (*(name for name in COEFFICIENTS[3:] if name not in SIGNED_PARAMETERS), *NOT_NEGATIVE_STERN)
    lowest = dict.fromkeys(positive, 0.0) | {name: 1e-6 * scales[name] for name in COEFFICIENTS[3:6]}
    optional = {name for name in COEFFICIENTS[6:] if name not in terms}
    wind_names = WIND_NAMES if log.wind is not None else ()
    fitted = [*COEFFICIENTS[3:13], *STERN_NAMES[log.kind], *wind_names]
    fitted = [name for name in fitted if name not in known and name not in optional]
    weights = 1 / np.maximum(accelerations.std(axis=1), 1e-12)

    def in_si_units(x: Array) -> dict[str, float]:
        return {name: float(a) * scales[name] for name, a in zip(fitted, x, strict=True)}

    def errors(x: Array) -> Array:
        predicted = _accelerations(log, speeds, values | in_si_units(x))
        return np.asarray((weights[:, None] * (predicted - accelerations)).ravel())

    least = np.array([lowest.get(name, -np.inf) / scales[name] for name in fitted])
    x = np.maximum(np.array([values[name] / scales[name] for name in fitted]), least)
    values |= in_si_units(least_squares(errors, x, bounds=(least, np.inf), max_nfev=_MAX_EVALUATIONS).x)
    coefficients = np.array([values[name] for name in COEFFICIENTS])
    shares = force_shares(regressors(speeds, accelerations), coefficients)
    low, high = np.array([(lowest.get(name, -np.inf), np.inf) for name in names]).T
    low[-1], high[-1] = 0.0, 0.1 * log.duration
    first, sizes = (np.array([table[name] for name in names]) for table in (values, scales))
    prior = np.where([name in _WEAK for name in names], _PRIOR * sizes, np.inf)
    free = tuple(n for n in names if n not in known and n not in COEFFICIENTS[:3] and n not in optional)
    return InitialValues(first, sizes, (low, high), free, dict(zip(COEFFICIENTS, shares.tolist(), strict=True)), prior)


def _accelerations(log: Log, speeds: Array, values: Mapping[str, float]) -> Array:
    """Return the accelerations by the equations of motion at each instant, shape (3, T)."""
    u, v, r = speeds
    v = v + values[AHEAD] * r
    air = None if log.wind is None else (-log.wind[:, 0], -log.wind[:, 1])
    load = load_of(log.kind, log.commands.T, (0.0, 0.0, log.measured[:, 2], u, v, r), values, ARRAYS, air)
    _, _, *accelerations = rates(0.0, u, v, r, load, [values[name] for name in COEFFICIENTS], np)
    return np.array(accelerations)


def _scales(log: Log, speeds: Array, accelerations: Array, known: Mapping[str, float]) -> dict[str, float]:
    """Return a scale of each parameter, with which its force is about a tenth of the acting forces."""
    m11, m22, m33, arm = (known[name] for name in GIVEN)
    U, V, R = np.maximum(np.sqrt(np.mean(speeds**2, axis=1)), 1e-9).tolist()
    A = np.sqrt(np.mean(accelerations**2, axis=1))
    X = _RESISTANCE * m11 * U * U / arm + m11 * A[0]
    Y, N = m22 * A[1] + m11 * U * R, m33 * A[2] + 0.3 * arm * (m22 * A[1] + m11 * U * R)
    one, angle = np.maximum(np.sqrt(np.mean(log.commands**2, axis=0)), 1e-9).tolist()
    forces = {
        "d11": X / U, "X_uu": X / (U * U), "X_vv": X / (V * V), "X_vr": X / (V * R), "X_rr": X / (R * R),
        "d22": Y / V, "Y_vv": Y / (V * V), "Y_uv": Y / (U * V), "Y_ur": Y / (U * R),
        "Y_rv": Y / (R * V), "Y_vr": Y / (V * R), "Y_rr": Y / (R * R),
        "d33": N / R, "N_rr": N / (R * R), "N_uv": N / (U * V), "N_ur": N / (U * R),
        "N_vv": N / (V * V), "N_rv": N / (R * V), "N_vr": N / (V * R),
    }  # fmt: skip
    scales = {name: 0.1 * size for name, size in forces.items()} | {"m11": m11, "m22": m22, "m33": m33, "arm": arm}
    scales |= {"T_nn": X / one**2, "T_nu": 0.1 * X / (one * U), "side": Y / (U * U * angle)}
    scales |= {"drag": X / (U * angle) ** 2, "wash": 0.1 * U * U / X, AHEAD: 0.1 * arm, "lag": log.dt}
    scales |= {"wake": 0.1, "straight": 0.1, "uneven": 0.1, "neutral": 0.02}
    if log.wind is not None:
        W = max(float(np.sqrt(np.mean(np.sum(log.wind**2, axis=1)))), 1e-9)
        scales |= {"X_air": 0.1 * X / W**2, "Y_air": 0.1 * Y / W**2, "N_air": 0.1 * N / W**2, "N_turn": 0.1 * N / W**2}
    return scales | {name: 0.1 * U for name in names_of(log) if is_current(name)}
