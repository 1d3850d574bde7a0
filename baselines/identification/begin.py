"""Where the search for a vehicle begins, what it may find, and how the log is cut for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import MISSING, fields, replace

import numpy as np

from auv_gym.physics.namespaces import Array, Indices
from auv_gym.physics.stiffness import fastest_rate
from auv_gym.physics.vehicle import Coefficients, Vehicle
from baselines.identification.least_squares import first_states, fit, leave
from baselines.identification.log import Log
from baselines.identification.model import COEFFICIENTS, CURRENT_NAMES, FITTED_PARAMETERS, LIMIT_NAMES, LogModel
from baselines.identification.start import START_WINDOWS, RoughStart, rough_start
from baselines.identification.uncertainty import rough_noise

NEEDED = tuple(f.name for f in fields(Vehicle) if f.name in COEFFICIENTS and f.default is MISSING)
"""Parameters of the vehicle that every vehicle has."""
OPTIONAL = tuple(name for name in COEFFICIENTS if name not in NEEDED)
"""Parameters of the vehicle that are kept where the log tells them from 0."""
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


def first_estimates(log: Log, over_ground: bool) -> tuple[RoughStart, Array, set[str]]:
    """Return rough values for a log, those of a fit to short segments from there, and what the log cannot show.

    Raises:
        ValueError: the simulator follows the log from none of them.
    """
    starts, noise = np.arange(0, len(log.t) - FIRST_SEGMENT, FIRST_SEGMENT), rough_noise(log)
    roughs = [rough_start(log, NEEDED, window) for window in START_WINDOWS]
    for substeps in _SUBSTEPS:
        model = LogModel(log, starts, substeps, over_ground)
        found: list[tuple[float, int, RoughStart, Array, Indices]] = []
        for rough in roughs:
            free = np.array([FITTED_PARAMETERS.index(name) for name in shown(log, rough, ())])
            for values in _begins(log, rough):
                left = leave(model, values, free, first_states(model), noise)
                if left is not None:
                    found.append((float(np.sum(left.errors**2)), len(found), rough, values, free))
        fits: list[tuple[float, int, RoughStart, Array, set[str]]] = []
        for _, _, rough, values, free in sorted(found, key=lambda entry: entry[:2])[:TRIED]:
            scales, bounds = scales_of(log, rough), bounds_of(log, rough)
            held = _hidden(
                LogModel(log, segment_starts(log, log.duration / _PIECES), substeps, over_ground), values, scales
            )
            for unlimited in (set(LIMIT_NAMES), set[str]()):
                own = np.array([j for j in free if FITTED_PARAMETERS[j] not in held | unlimited])
                begin = np.where(np.isin(FITTED_PARAMETERS, list(unlimited)), bounds[1], values)
                done, left = fit(model, begin, own, bounds, scales, first_states(model), noise)
                price = 0.0 if unlimited else EVIDENCE
                fits.append((float(np.sum(left.errors**2)) + price, len(fits), rough, done, held | unlimited))
        if fits:
            *_, rough, values, held = min(fits, key=lambda entry: entry[:2])
            return replace(rough, coefficients=values[: len(COEFFICIENTS)]), values, held
    raise ValueError(FAILED_START)


def _hidden(model: LogModel, values: Array, scales: Array) -> set[str]:
    """Return the parameters of the vehicle whose whole force would hardly be seen: noise is all that it acts on."""
    every = np.arange(len(COEFFICIENTS))
    left = leave(model, values, every, first_states(model), rough_noise(model.log))
    if left is None:
        return set()
    seen = np.linalg.norm(left.slopes, axis=(0, 1)) * scales[every]
    seen[len(NEEDED) :] *= 10  # the scale of what is optional is a tenth of all forces
    return {name for name, size in zip(COEFFICIENTS, seen, strict=True) if size < _FAINT}


def _begins(log: Log, rough: RoughStart) -> list[Array]:
    """Return where to begin: at the rough values, and with actuators that are quick and strong."""
    peaks, begins = np.abs(log.commands).max(axis=0), []
    for lag, limits in ((rough.lag, rough.limits), (0.0, peaks)):
        shares = np.minimum(np.where(peaks > 0, limits / np.maximum(peaks, 1e-300), 1.0), 0.97)
        own = dict(zip(COEFFICIENTS, rough.coefficients, strict=True)) | dict.fromkeys(CURRENT_NAMES, 0.0)
        own |= {name: share * (peak or 1.0) for name, share, peak in zip(LIMIT_NAMES, shares, peaks, strict=True)}
        own["lag"] = min(max(lag, log.dt), 0.05 * log.duration)
        begins.append(np.array([own[name] for name in FITTED_PARAMETERS]))
    return begins


def shown(log: Log, rough: RoughStart, terms: Sequence[str]) -> list[str]:
    """Return the parameters that a log may say something about, the vehicle's optional `terms` among them."""
    own = [*NEEDED, *(name for name in terms if rough.shares[COEFFICIENTS.index(name)] > 0)]
    return [*own, *(n for n, F in zip(LIMIT_NAMES, log.commands.T, strict=True) if F.any()), *CURRENT_NAMES, "lag"]


def scales_of(log: Log, rough: RoughStart) -> Array:
    """Return changes of the parameters that matter, shape (P,)."""
    speed, peaks = float(np.abs(log.measured[:, 3:5]).max()), np.abs(log.commands).max(axis=0)
    scales = {name: 0.1 / share if share > 0 else 1.0 for name, share in zip(COEFFICIENTS, rough.shares, strict=True)}
    scales |= {name: float(value) for name, value in zip(NEEDED, rough.coefficients[: len(NEEDED)], strict=True)}
    scales |= {name: float(peak) or 1.0 for name, peak in zip(LIMIT_NAMES, peaks, strict=True)}
    scales |= dict.fromkeys(CURRENT_NAMES, 0.1 * speed or 1.0) | {"lag": max(rough.lag, log.dt)}
    return np.array([scales[name] for name in FITTED_PARAMETERS])


def bounds_of(log: Log, rough: RoughStart) -> tuple[Array, Array]:
    """Return least and largest values, shape (P,) each."""
    scales = dict(zip(FITTED_PARAMETERS, scales_of(log, rough).tolist(), strict=True))
    ranges = {name: (1e-4 * scales[name], 1e4 * scales[name]) for name in NEEDED}
    ranges |= {name: (1e-3 * scales[name], scales[name]) for name in LIMIT_NAMES} | {"lag": (0.0, 0.1 * log.duration)}
    low, high = zip(*(ranges.get(name, (-np.inf, np.inf)) for name in FITTED_PARAMETERS), strict=True)
    return np.array(low), np.array(high)


def segment_length(log: Log, values: Array, segment: float) -> float:
    """Return the length of a segment [s] that is given, or goes by the time constants of the drag."""
    relaxation = float((values[:3] / values[3:6]).max())
    return segment or min(max(RELAXATIONS * relaxation, SHORTEST_SEGMENT * log.dt), log.duration / FEWEST)


def segment_starts(log: Log, length: float) -> Indices:
    """Return where segments of about a length [s] begin."""
    count = max(FEWEST, round(log.duration / length))
    begins = log.t[0] + log.duration * np.arange(count) / count
    return np.unique(np.searchsorted(log.t, begins - 0.5 * log.dt))


def substeps_for(log: Log, values: Array) -> int:
    """Return how many integration steps a row needs at the speeds of the log."""
    peaks = np.abs(log.measured[:, 3:]).max(axis=0).tolist()
    coefficients = Coefficients(*np.abs(values[: len(COEFFICIENTS)]))
    rate = float(fastest_rate(coefficients, (0.0, 0.0, 0.0), tuple(peaks)))
    return next((n for n in _SUBSTEPS if log.dt * rate <= FINEST * n), _SUBSTEPS[-1])
