"""Initial values of a fit, and the division of a log into segments."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from auv_gym.physics.dynamics import rates
from auv_gym.physics.namespaces import ARRAYS, Array, Indices
from auv_gym.physics.stiffness import fastest_rate
from auv_gym.physics.vehicle import Coefficients
from baselines.identification.least_squares import InitialValues, fit, measured_states, residuals
from baselines.identification.linear_fit import (
    SMOOTHING_LENGTHS,
    LinearFit,
    force_shares,
    linear_fit,
    regressors,
    smoothed,
)
from baselines.identification.log import Log, rough_noise
from baselines.identification.model import (
    AHEAD,
    COEFFICIENTS,
    LIMIT_NAMES,
    NEEDED,
    NOT_NEGATIVE,
    PREDICTION_TIME,
    STERN_NAMES,
    WIND_NAMES,
    LogModel,
    is_current,
    load_of,
    names_of,
)

RELAXATIONS = 3.0  # length of a segment in units of the longest time constant of the drag
MIN_SEGMENTS = 3  # of a log
SHORTEST_SEGMENT = 20  # rows
FIRST_SEGMENT = 15  # rows of the segments of the first fit, in which errors cannot grow much
_PIECES = 10  # segments of a log for the test whether a parameter has a visible effect
EVIDENCE = 30.0  # [variances of the noise] least improvement of the squared errors by limits
_FAINT = 8.0  # [standard deviations] least effect of a parameter on the measurements
TRIED = 3  # number of the best linear fits that are refined
FINEST = 1.0  # largest product of an integration step and the vehicle's fastest rate
_OF_LAG = 0.16  # largest share of the lag in an integration step, during which the force is constant
_SUBSTEPS = (1, 2, 4)  # allowed numbers of integration steps per row

NOT_SHOWN = ("m11", "m22", "m33", "arm")
"""Names of the parameters that must be known for a log of thrust or revolutions and rudder."""
_WEAK = frozenset(
    (*COEFFICIENTS[6:], "T_nu", "wash", "wake", "straight", "uneven", "neutral", AHEAD, "N_air", "N_turn")
)
"""Names of the parameters with a prior, which keeps them small if the log has little information on them."""
_PRIOR = 0.3  # standard deviation of the prior, in units of the scale
_WINDOW = 5  # number of rows of the smoothing
_RESISTANCE = 0.05  # resistance in surge, as a share of m11 U^2/arm
_MAX_EVALUATIONS = 60

NO_INITIAL_VALUES = (
    "the simulator diverges on this log from all initial values; are commands in [N] and [N m], do they hold until the "
    "next row, and are rows close enough for the vehicle?"
)
"""The message if no initial values are found."""


def initial_values(log: Log, over_ground: bool, terms: Sequence[str], known: Mapping[str, float]) -> InitialValues:
    """Return initial values for a log: for forces those of linear fits that are refined on short segments.

    For propeller and rudder they are those of a nonlinear fit of the accelerations, with a prior.

    Args:
        log: the log with measurements and commands.
        over_ground: whether speeds are measured over ground.
        terms: names of the optional coefficients that may differ from 0.
        known: values of parameters that are not fitted, by name; for propeller and rudder with `NOT_SHOWN`.

    Raises:
        ValueError: the simulator diverges from all initial values, or too few parameters are known for the log.
    """
    if log.kind != "force":
        return _of_shaft(log, terms, known)
    noise = rough_noise(log)
    rows = FIRST_SEGMENT * log.rarity
    starts = np.concatenate([np.arange(run.start, run.stop - rows, rows) for run in log.runs])
    linear_fits = [linear_fit(log, window) for window in SMOOTHING_LENGTHS]
    for substeps in _SUBSTEPS:
        model = LogModel(log, starts, substeps, over_ground)
        states = measured_states(model)
        candidates: list[tuple[float, LinearFit, InitialValues]] = []
        for linear in linear_fits:
            for values in _candidates(log, linear, known):
                initial = _with_ranges(log, linear, values, (), known)
                misses = residuals(model, values, model.indices(initial.free), states, noise)
                if misses is not None:
                    candidates.append((float(np.sum(misses.errors**2)), linear, initial))
        fits: list[tuple[float, LinearFit, Array, set[str]]] = []
        for _, linear, initial in sorted(candidates, key=lambda candidate: candidate[0])[:TRIED]:
            pieces = LogModel(log, segment_starts(log, log.duration / _PIECES), substeps, over_ground)
            hidden = _hidden(pieces, initial, terms)
            for unlimited in (set(LIMIT_NAMES), set[str]()):
                start = np.where(np.isin(model.names, list(unlimited)), initial.bounds[1], initial.values)
                free = tuple(name for name in initial.free if name not in hidden | unlimited)
                values, misses = fit(model, replace(initial, values=start, free=free), states, noise)
                cost = float(np.sum(misses.errors**2)) + (0.0 if unlimited else EVIDENCE)
                fits.append((cost, linear, values, hidden | unlimited))
        if fits:
            _, linear, values, excluded = min(fits, key=lambda entry: entry[0])
            linear = replace(linear, coefficients=values[: len(COEFFICIENTS)])
            initial = _with_ranges(log, linear, values, terms, known)
            return replace(initial, free=tuple(name for name in initial.free if name not in excluded))
    raise ValueError(NO_INITIAL_VALUES)


def _candidates(log: Log, linear: LinearFit, known: Mapping[str, float]) -> Iterator[Array]:
    """Yield two candidates: the linear fit, and the same with actuators of little lag and high limits."""
    peaks = np.abs(log.commands).max(axis=0)
    for lag, limits in ((linear.lag, linear.limits), (0.0, peaks)):
        shares = np.minimum(np.where(peaks > 0, limits / np.maximum(peaks, 1e-300), 1.0), 0.97)
        values = dict.fromkeys(names_of(log), 0.0) | dict(zip(COEFFICIENTS, linear.coefficients.tolist(), strict=True))
        values |= {name: share * (peak or 1.0) for name, share, peak in zip(LIMIT_NAMES, shares, peaks, strict=True)}
        values["lag"] = min(max(lag, log.dt), 0.05 * log.duration)
        values |= known
        yield np.array([values[name] for name in names_of(log)])


def _with_ranges(
    log: Log, linear: LinearFit, values: Array, terms: Sequence[str], known: Mapping[str, float]
) -> InitialValues:
    """Return initial values with scales and bounds; free are all parameters that are not known, and `terms`."""
    names, peaks = names_of(log), np.abs(log.commands).max(axis=0)
    shares = dict(zip(COEFFICIENTS, linear.shares.tolist(), strict=True))
    fitted = [*NEEDED, *(name for name in terms if shares[name] > 0)]
    fitted += [name for name, peak in zip(LIMIT_NAMES, peaks, strict=True) if peak]
    fitted += names[len(COEFFICIENTS) + len(LIMIT_NAMES) :]
    speed = float(np.abs(log.measured[:, 3:5]).max())
    scales = {name: 0.1 * speed if is_current(name) and speed else 1.0 for name in names}
    scales |= {name: 0.1 / share for name, share in shares.items() if share > 0}
    scales |= {name: float(value) for name, value in zip(NEEDED, linear.coefficients[: len(NEEDED)], strict=True)}
    scales |= {name: float(peak) or 1.0 for name, peak in zip(LIMIT_NAMES, peaks, strict=True)}
    scales["lag"] = max(linear.lag, log.dt)
    ranges = {name: (1e-4 * scales[name], 1e4 * scales[name]) for name in NEEDED}
    ranges |= {name: (1e-3 * scales[name], scales[name]) for name in LIMIT_NAMES} | {"lag": (0.0, 0.1 * log.duration)}
    low, high = np.array([ranges.get(name, (-np.inf, np.inf)) for name in names]).T
    free = tuple(name for name in fitted if name not in known)
    return InitialValues(values, np.array([scales[name] for name in names]), (low, high), free, shares)


def _hidden(model: LogModel, initial: InitialValues, terms: Sequence[str]) -> set[str]:
    """Return the names of the coefficients whose whole force has no visible effect, as in a log without motion."""
    names = [*NEEDED, *terms]
    columns = model.indices(names)
    misses = residuals(model, initial.values, columns, measured_states(model), rough_noise(model.log))
    if misses is None:
        return set()
    effects = np.linalg.norm(misses.slopes, axis=(0, 1)) * initial.scales[columns]
    effects[len(NEEDED) :] *= 10  # the scale of an optional coefficient is a tenth of all forces
    return {name for name, effect in zip(names, effects, strict=True) if effect < _FAINT}


def _of_shaft(log: Log, terms: Sequence[str], known: Mapping[str, float]) -> InitialValues:
    """Return initial values for a log of propeller and rudder: least squares on the accelerations at each instant."""
    if missing := [name for name in NOT_SHOWN if name not in known]:
        raise ValueError(
            f"a log of {log.kind} and rudder does not show {', '.join(missing)}: give them as known. As a rule m11 is "
            "1.05 times the mass m, m22 1.8 m, m33 0.1 m L^2, and arm half the length L"
        )
    names = names_of(log)
    speeds, accelerations = smoothed(log, _WINDOW)
    scales = _scales(log, speeds, accelerations, known)
    fixed = {*known, *(name for name in COEFFICIENTS[6:] if name not in terms)}
    first = [name for name in (*COEFFICIENTS[:9], "T_nn", "side") if name in names and name not in fixed]
    values = dict.fromkeys(names, 0.0) | {name: scales[name] for name in first} | dict(known)
    lowest = dict.fromkeys(NOT_NEGATIVE, 0.0) | {name: 1e-6 * scales[name] for name in COEFFICIENTS[3:6]}
    fitted = [*COEFFICIENTS[3:13], *STERN_NAMES[log.kind], *(() if log.wind is None else WIND_NAMES)]
    fitted = [name for name in fitted if name not in fixed]
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
    start, sizes = (np.array([table[name] for name in names]) for table in (values, scales))
    prior = np.where([name in _WEAK for name in names], _PRIOR * sizes, np.inf)
    free = tuple(name for name in names if name not in fixed and name not in COEFFICIENTS[:3])
    return InitialValues(start, sizes, (low, high), free, dict(zip(COEFFICIENTS, shares.tolist(), strict=True)), prior)


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
    m11, m22, m33, arm = (known[name] for name in NOT_SHOWN)
    U, V, R = np.maximum(np.sqrt(np.mean(speeds**2, axis=1)), 1e-9).tolist()
    A = np.sqrt(np.mean(accelerations**2, axis=1))
    X = _RESISTANCE * m11 * U * U / arm + m11 * A[0]
    Y, N = m22 * A[1] + m11 * U * R, m33 * A[2] + 0.3 * arm * (m22 * A[1] + m11 * U * R)
    one, angle = np.maximum(np.sqrt(np.mean(log.commands**2, axis=0)), 1e-9).tolist()
    scales = {"m11": m11, "m22": m22, "m33": m33, "arm": arm}
    scales |= {"d11": 0.1 * (X / U), "d22": 0.1 * (Y / V), "d33": 0.1 * (N / R)}
    force, velocity = {"X": X, "Y": Y, "N": N}, {"u": U, "v": V, "r": R}
    for name in COEFFICIENTS[6:]:  # such as N_uv, a moment per product of surge and sway velocity
        scales[name] = 0.1 * (force[name[0]] / (velocity[name[-2]] * velocity[name[-1]]))
    scales |= {"T_nn": X / one**2, "T_nu": 0.1 * X / (one * U), "side": Y / (U * U * angle)}
    scales |= {"drag": X / (U * angle) ** 2, "wash": 0.1 * U * U / X, AHEAD: 0.1 * arm, "lag": log.dt}
    scales |= {"wake": 0.1, "straight": 0.1, "uneven": 0.1, "neutral": 0.02}
    if log.wind is not None:
        W = max(float(np.sqrt(np.mean(np.sum(log.wind**2, axis=1)))), 1e-9)
        scales |= {"X_air": 0.1 * X / W**2, "Y_air": 0.1 * Y / W**2, "N_air": 0.1 * N / W**2, "N_turn": 0.1 * N / W**2}
    return scales | {name: 0.1 * U for name in names_of(log) if is_current(name)}


def segment_length(log: Log, values: Array) -> float:
    """Return the length of segments [s]: a multiple of the vehicle's time constant; `PREDICTION_TIME` with a rudder."""
    length = RELAXATIONS * float((values[:3] / values[3:6]).max()) if log.kind == "force" else PREDICTION_TIME
    return min(max(length, SHORTEST_SEGMENT * log.dt), log.duration / MIN_SEGMENTS)


def segment_starts(log: Log, length: float) -> Indices:
    """Return the first rows of segments of about a length [s]."""
    starts = []
    fewest = MIN_SEGMENTS if len(log.starts) == 1 else 1
    for run in log.runs:
        t = log.t[run]
        duration = float(t[-1] - t[0])
        count = max(fewest, round(duration / length))
        times = t[0] + duration * np.arange(count) / count
        starts.append(run.start + np.unique(np.searchsorted(t, times - 0.5 * log.dt)))
    return np.concatenate(starts)


def substeps_of_log(log: Log, values: Array) -> int:
    """Return the number of integration steps per row at the speeds of the log, and for the lag of the actuators."""
    peaks = np.abs(log.measured[:, 3:]).max(axis=0).tolist()
    coefficients = Coefficients(*np.abs(values[: len(Coefficients._fields)]))
    rate = float(fastest_rate(coefficients, (0.0, 0.0, 0.0), tuple(peaks)))
    rate = max(rate, FINEST / (_OF_LAG * max(float(values[-1]), log.dt)))
    steps = next((n for n in _SUBSTEPS if log.dt * rate <= FINEST * n), _SUBSTEPS[-1])
    return steps if log.kind == "force" else max(steps, _SUBSTEPS[1])  # the load of a rudder changes within a row
