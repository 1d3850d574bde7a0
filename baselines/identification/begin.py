"""Where the search for a vehicle begins, what it may find, and how the log is cut for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields, replace

import numpy as np

from auv_gym.physics.namespaces import Array, Indices
from auv_gym.physics.stiffness import fastest_rate
from auv_gym.physics.vehicle import Coefficients, CrossTerms, Vehicle
from baselines.identification.least_squares import first_states, fit, leave
from baselines.identification.log import Log
from baselines.identification.model import (
    COEFFICIENTS,
    CROSS_TERMS,
    CURRENT_NAMES,
    LIMIT_NAMES,
    LogModel,
    parameter_names,
)
from baselines.identification.prediction import Windows
from baselines.identification.start import START_WINDOWS, Begin, RoughStart, rough_start
from baselines.identification.stern_start import stern_start
from baselines.identification.uncertainty import rough_noise

NEEDED = tuple(f.name for f in fields(Vehicle) if f.name in COEFFICIENTS and f.default is MISSING)
"""Parameters of the vehicle that every vehicle has."""
OPTIONAL = tuple(name for name in COEFFICIENTS if name not in NEEDED)
"""Parameters of the vehicle that are kept where the log tells them from 0."""
PLAIN_TERMS = tuple(name for name in OPTIONAL if name not in CROSS_TERMS)
"""Those of them that are tried first."""
RELAXATIONS = 3.0  # length of a segment, in the longest time constant of the drag
FEWEST = 3  # segments of a log
SHORTEST_SEGMENT = 20  # rows
FIRST_SEGMENT = 15  # rows of the segments of a first, rough fit: in so short a time nothing can go far astray
_PIECES = 10  # segments of a log in which it is looked for what shows at all
EVIDENCE = 30.0  # [variances of the noise] by which limits must explain the log better than none do
_FAINT = 8.0  # [standard deviations] effect below which nothing shows
TRIED = 3  # rough starts that are fitted from, the best ones
FINEST = 1.0  # largest product of an integration step and the vehicle's fastest rate
_SUBSTEPS = (1, 2, 4)  # integration steps that a row may have
_RATIOS = np.geomspace(1e-2, 1e2, 33)  # of yaw rate and sway velocity at which damping must not give power

FAILED_START = (
    "the simulator follows this log from no values that were tried; are commands in [N] and [N m], do they hold until "
    "the next row, and are rows close enough for the vehicle?"
)
"""What is said of a log that no vehicle explains."""


def check_segment(log: Log, segment: float) -> None:
    """Raise ValueError if segments of this length [s], 0 for any, do not suit a log."""
    least, most = SHORTEST_SEGMENT * log.dt, log.duration / FEWEST
    if segment and not least <= segment <= most:
        raise ValueError(f"a segment is {segment:g} s; for this log it must be in [{least:.3g}, {most:.3g}] s")


def first_estimates(log: Log, over_ground: bool, terms: Sequence[str], known: Mapping[str, float]) -> Begin:
    """Return where the search begins: rough values for a log, and those of a fit to short segments from there.

    Args:
        log: what was measured and commanded.
        over_ground: whether speeds are measured over ground.
        terms: names of the optional parameters of the vehicle that may differ from 0.
        known: values of parameters that are not searched for, by name.

    Raises:
        ValueError: the simulator follows the log from no values that were tried, or too little is known for it.
    """
    if log.kind != "force":
        return stern_start(log, terms, known)
    names = parameter_names(log.kind, log.wind is not None, len(log.starts))
    starts, noise = short_segments(log), rough_noise(log)
    roughs = [rough_start(log, NEEDED, window) for window in START_WINDOWS]
    for substeps in _SUBSTEPS:
        model = LogModel(log, starts, substeps, over_ground)
        found: list[tuple[float, int, RoughStart, Array]] = []
        for rough in roughs:
            free = _indices(names, _shown(log, rough, (), known))
            for values in _begins(log, rough, known):
                left = leave(model, values, free, first_states(model), noise)
                if left is not None:
                    found.append((float(np.sum(left.errors**2)), len(found), rough, values))
        fits: list[tuple[float, int, RoughStart, Array, set[str]]] = []
        for _, _, rough, values in sorted(found, key=lambda entry: entry[:2])[:TRIED]:
            scales, bounds = _scales(log, rough), _bounds(log, rough)
            pieces = LogModel(log, segment_starts(log, log.duration / _PIECES), substeps, over_ground)
            held = _hidden(pieces, values, scales, terms)
            for unlimited in (set(LIMIT_NAMES), set[str]()):
                own = _indices(names, [n for n in _shown(log, rough, (), known) if n not in held | unlimited])
                begin = np.where(np.isin(names, list(unlimited)), bounds[1], values)
                done, left = fit(model, begin, own, bounds, scales, first_states(model), noise)
                price = 0.0 if unlimited else EVIDENCE
                fits.append((float(np.sum(left.errors**2)) + price, len(fits), rough, done, held | unlimited))
        if fits:
            *_, rough, values, held = min(fits, key=lambda entry: entry[:2])
            rough = replace(rough, coefficients=values[: len(COEFFICIENTS)])
            shown = tuple(n for n in _shown(log, rough, terms, known) if n not in held)
            shares = dict(zip(COEFFICIENTS, rough.shares.tolist(), strict=True))
            return Begin(values, _scales(log, rough), _bounds(log, rough), shown, shares)
    raise ValueError(FAILED_START)


def _indices(names: Sequence[str], chosen: Sequence[str]) -> Indices:
    return np.array([names.index(name) for name in chosen], dtype=np.int64)


def _hidden(model: LogModel, values: Array, scales: Array, terms: Sequence[str]) -> set[str]:
    """Return the parameters of the vehicle whose whole force would hardly be seen: noise is all that it acts on."""
    every = [*NEEDED, *terms]
    at = _indices(model.names, every)
    left = leave(model, values, at, first_states(model), rough_noise(model.log))
    if left is None:
        return set()
    seen = np.linalg.norm(left.slopes, axis=(0, 1)) * scales[at]
    seen[len(NEEDED) :] *= 10  # the scale of what is optional is a tenth of all forces
    return {name for name, size in zip(every, seen, strict=True) if size < _FAINT}


def _begins(log: Log, rough: RoughStart, known: Mapping[str, float]) -> list[Array]:
    """Return where to begin: at the rough values, and with actuators that are quick and strong."""
    peaks, begins = np.abs(log.commands).max(axis=0), []
    names = parameter_names(log.kind, log.wind is not None, len(log.starts))
    for lag, limits in ((rough.lag, rough.limits), (0.0, peaks)):
        shares = np.minimum(np.where(peaks > 0, limits / np.maximum(peaks, 1e-300), 1.0), 0.97)
        own = dict.fromkeys(names, 0.0) | dict(zip(COEFFICIENTS, rough.coefficients.tolist(), strict=True))
        own |= {name: share * (peak or 1.0) for name, share, peak in zip(LIMIT_NAMES, shares, peaks, strict=True)}
        own["lag"] = min(max(lag, log.dt), 0.05 * log.duration)
        own |= known
        begins.append(np.array([own[name] for name in names]))
    return begins


def _shown(log: Log, rough: RoughStart, terms: Sequence[str], known: Mapping[str, float]) -> list[str]:
    """Return the parameters that a log may say something about, the vehicle's optional `terms` among them."""
    own = [*NEEDED, *(name for name in terms if rough.shares[COEFFICIENTS.index(name)] > 0)]
    own += [n for n, F in zip(LIMIT_NAMES, log.commands.T, strict=True) if F.any()]
    rest = parameter_names(log.kind, log.wind is not None, len(log.starts))[len(COEFFICIENTS) + len(LIMIT_NAMES) :]
    return [name for name in (*own, *rest) if name not in known]


def _scales(log: Log, rough: RoughStart) -> Array:
    """Return changes of the parameters that matter, shape (P,)."""
    speed, peaks = float(np.abs(log.measured[:, 3:5]).max()), np.abs(log.commands).max(axis=0)
    names = parameter_names(log.kind, log.wind is not None, len(log.starts))
    scales = {name: 0.1 * speed if is_current(name) and speed else 1.0 for name in names}
    scales |= {name: 0.1 / share for name, share in zip(COEFFICIENTS, rough.shares.tolist(), strict=True) if share > 0}
    scales |= {name: float(value) for name, value in zip(NEEDED, rough.coefficients[: len(NEEDED)], strict=True)}
    scales |= {name: float(peak) or 1.0 for name, peak in zip(LIMIT_NAMES, peaks, strict=True)}
    scales["lag"] = max(rough.lag, log.dt)
    return np.array([scales[name] for name in names])


def _bounds(log: Log, rough: RoughStart) -> tuple[Array, Array]:
    """Return least and largest values, shape (P,) each."""
    names = parameter_names(log.kind, log.wind is not None, len(log.starts))
    scales = dict(zip(names, _scales(log, rough).tolist(), strict=True))
    ranges = {name: (1e-4 * scales[name], 1e4 * scales[name]) for name in NEEDED}
    ranges |= {name: (1e-3 * scales[name], scales[name]) for name in LIMIT_NAMES} | {"lag": (0.0, 0.1 * log.duration)}
    low, high = zip(*(ranges.get(name, (-np.inf, np.inf)) for name in names), strict=True)
    return np.array(low), np.array(high)


def is_current(name: str) -> bool:
    """Return whether a parameter is the current of a run."""
    return name.split(maxsplit=1)[0] in CURRENT_NAMES


def power_forms(names: Sequence[str], scales: Array) -> Array:
    """Return linear forms of the parameters that are negative where quadratic damping gives power, shape (K, P).

    They are in units in which the scales of Y_vv and N_rr are 1, see `CrossTerms.slopes`.
    """
    at = {name: names.index(name) for name in (*CROSS_TERMS, "Y_vv", "N_rr")}
    unit = np.cbrt(scales[at["N_rr"]] / scales[at["Y_vv"]])
    rows = np.eye(len(names))
    cross = CrossTerms._make([*(rows[at[name]] for name in CROSS_TERMS), 0.0, 0.0, 0.0])
    ratios = _RATIOS[:, None] / unit
    forms = [
        sum(c * ratios**k for k, c in enumerate(slope)) / scales[at["Y_vv"]]
        for slope in cross.slopes(rows[at["Y_vv"]], rows[at["N_rr"]])
    ]
    return np.concatenate(forms) / np.tile(1 + _RATIOS[:, None] ** 3, (2, 1))


def short_segments(log: Log) -> Indices:
    """Return where segments of a first fit begin."""
    starts = [np.arange(run.start, run.stop - FIRST_SEGMENT, FIRST_SEGMENT) for run in log.runs]
    return np.concatenate(starts)


def segment_length(log: Log, values: Array, segment: float) -> float:
    """Return the length of a segment [s] that is given, or goes by the time constants of the vehicle.

    In logs of a rudder it is that of the predictions of held-out runs.
    """
    if segment:
        return segment
    longest = log.duration / FEWEST
    if log.kind == "force":
        return min(max(RELAXATIONS * float((values[:3] / values[3:6]).max()), SHORTEST_SEGMENT * log.dt), longest)
    return min(max(Windows.horizon, SHORTEST_SEGMENT * log.dt), longest)


def segment_starts(log: Log, length: float) -> Indices:
    """Return where segments of about a length [s] begin."""
    starts = []
    fewest = FEWEST if len(log.starts) == 1 else 1
    for run in log.runs:
        t = log.t[run]
        duration = float(t[-1] - t[0])
        count = max(fewest, round(duration / length))
        begins = t[0] + duration * np.arange(count) / count
        starts.append(run.start + np.unique(np.searchsorted(t, begins - 0.5 * log.dt)))
    return np.concatenate(starts)


def substeps_for(log: Log, values: Array) -> int:
    """Return how many integration steps a row needs at the speeds of the log."""
    peaks = np.abs(log.measured[:, 3:]).max(axis=0).tolist()
    coefficients = Coefficients(*np.abs(values[: len(Coefficients._fields)]))
    rate = float(fastest_rate(coefficients, (0.0, 0.0, 0.0), tuple(peaks)))
    steps = next((n for n in _SUBSTEPS if log.dt * rate <= FINEST * n), _SUBSTEPS[-1])
    return steps if log.kind == "force" else max(steps, _SUBSTEPS[1])  # the load of a rudder changes within a row
