"""Initial values of a fit, and the division of a log into segments."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, fields, replace

import numpy as np

from auv_gym.physics.namespaces import Array, Indices
from auv_gym.physics.stiffness import fastest_rate
from auv_gym.physics.vehicle import Coefficients, Vehicle
from baselines.identification.least_squares import InitialValues, fit, measured_states, residuals
from baselines.identification.linear_fit import WINDOWS, LinearFit, linear_fit
from baselines.identification.log import Log
from baselines.identification.model import COEFFICIENTS, CROSS_TERMS, LIMIT_NAMES, LogModel, is_current, names_of
from baselines.identification.prediction import Windows
from baselines.identification.shaft_initial_values import shaft_initial_values
from baselines.identification.uncertainty import rough_noise

NEEDED = tuple(f.name for f in fields(Vehicle) if f.name in COEFFICIENTS and f.default is MISSING)
"""Names of the coefficients that every vehicle has."""
OPTIONAL = tuple(name for name in COEFFICIENTS if name not in NEEDED)
"""Names of the coefficients that are kept only if they differ significantly from 0."""
DEFAULT_TERMS = tuple(name for name in OPTIONAL if name not in CROSS_TERMS)
"""Names of the optional coefficients that are fitted first."""
RELAXATIONS = 3.0  # length of a segment in units of the longest time constant of the drag
MIN_SEGMENTS = 3  # of a log
SHORTEST_SEGMENT = 20  # rows
FIRST_SEGMENT = 15  # rows of the segments of the first fit, in which errors cannot grow much
_PIECES = 10  # segments of a log for the test whether a parameter has a visible effect
EVIDENCE = 30.0  # [variances of the noise] least improvement of the squared errors by limits
_FAINT = 8.0  # [standard deviations] least effect of a parameter on the measurements
TRIED = 3  # number of the best linear fits that are refined
FINEST = 1.0  # largest product of an integration step and the vehicle's fastest rate
_SUBSTEPS = (1, 2, 4)  # allowed numbers of integration steps per row

NO_INITIAL_VALUES = (
    "the simulator diverges on this log from all initial values; are commands in [N] and [N m], do they hold until the "
    "next row, and are rows close enough for the vehicle?"
)
"""Message if no initial values are found."""


def initial_values(log: Log, over_ground: bool, terms: Sequence[str], known: Mapping[str, float]) -> InitialValues:
    """Return initial values for a log: for forces those of linear fits that are refined on short segments.

    Args:
        log: the log with measurements and commands.
        over_ground: whether speeds are measured over ground.
        terms: names of the optional coefficients that may differ from 0.
        known: values of parameters that are not fitted, by name.

    Raises:
        ValueError: the simulator diverges from all initial values, or too few parameters are known for the log.
    """
    if log.kind != "force":
        return shaft_initial_values(log, terms, known)
    noise = rough_noise(log)
    starts = np.concatenate([np.arange(run.start, run.stop - FIRST_SEGMENT, FIRST_SEGMENT) for run in log.runs])
    linear_fits = [linear_fit(log, NEEDED, window) for window in WINDOWS]
    for substeps in _SUBSTEPS:
        model = LogModel(log, starts, substeps, over_ground)
        states = measured_states(model)
        candidates: list[tuple[float, LinearFit, InitialValues]] = []
        for linear in linear_fits:
            for values in _candidates(log, linear, known):
                initial = _with_ranges(log, linear, values, (), known)
                found = residuals(model, values, model.indices(initial.free), states, noise)
                if found is not None:
                    candidates.append((float(np.sum(found.errors**2)), linear, initial))
        fits: list[tuple[float, LinearFit, Array, set[str]]] = []
        for _, linear, initial in sorted(candidates, key=lambda candidate: candidate[0])[:TRIED]:
            pieces = LogModel(log, segment_starts(log, log.duration / _PIECES), substeps, over_ground)
            hidden = _hidden(pieces, initial, terms)
            for unlimited in (set(LIMIT_NAMES), set[str]()):
                start = np.where(np.isin(model.names, list(unlimited)), initial.bounds[1], initial.values)
                values, found = fit(model, _without(initial, start, hidden | unlimited), states, noise)
                cost = float(np.sum(found.errors**2)) + (0.0 if unlimited else EVIDENCE)
                fits.append((cost, linear, values, hidden | unlimited))
        if fits:
            _, linear, values, excluded = min(fits, key=lambda entry: entry[0])
            linear = replace(linear, coefficients=values[: len(COEFFICIENTS)])
            return _without(_with_ranges(log, linear, values, terms, known), values, excluded)
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


def _without(initial: InitialValues, values: Array, excluded: set[str]) -> InitialValues:
    """Return initial values with other values, in which some parameters are not free."""
    return replace(initial, values=values, free=tuple(name for name in initial.free if name not in excluded))


def _hidden(model: LogModel, initial: InitialValues, terms: Sequence[str]) -> set[str]:
    """Return the names of the coefficients whose whole force has no visible effect, as in a log without motion."""
    names = [*NEEDED, *terms]
    columns = model.indices(names)
    found = residuals(model, initial.values, columns, measured_states(model), rough_noise(model.log))
    if found is None:
        return set()
    effects = np.linalg.norm(found.slopes, axis=(0, 1)) * initial.scales[columns]
    effects[len(NEEDED) :] *= 10  # the scale of an optional coefficient is a tenth of all forces
    return {name for name, effect in zip(names, effects, strict=True) if effect < _FAINT}


def segment_length(log: Log, values: Array) -> float:
    """Return the length of segments [s]: a multiple of the vehicle's time constant.

    In logs of a rudder it is the horizon of the predictions of held-out runs.
    """
    length = RELAXATIONS * float((values[:3] / values[3:6]).max()) if log.kind == "force" else Windows.horizon
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


def substeps_for(log: Log, values: Array) -> int:
    """Return the number of integration steps per row at the speeds of the log."""
    peaks = np.abs(log.measured[:, 3:]).max(axis=0).tolist()
    coefficients = Coefficients(*np.abs(values[: len(Coefficients._fields)]))
    rate = float(fastest_rate(coefficients, (0.0, 0.0, 0.0), tuple(peaks)))
    steps = next((n for n in _SUBSTEPS if log.dt * rate <= FINEST * n), _SUBSTEPS[-1])
    return steps if log.kind == "force" else max(steps, _SUBSTEPS[1])  # the load of a rudder changes within a row
