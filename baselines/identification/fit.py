"""From a log to a vehicle: which parameters it shows, their values and how well they are known."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from baselines.identification.begin import (
    FAILED_START,
    FIRST_SEGMENT,
    NEEDED,
    OPTIONAL,
    bounds_of,
    check_segment,
    first_estimates,
    scales_of,
    segment_length,
    segment_starts,
    shown,
    substeps_for,
)
from baselines.identification.least_squares import Left, first_states, fit
from baselines.identification.log import Log, unwrapped
from baselines.identification.model import COEFFICIENTS, CURRENT_NAMES, FITTED_PARAMETERS, LIMIT_NAMES, LogModel
from baselines.identification.start import RoughStart
from baselines.identification.uncertainty import NORMAL_QUANTILE, covariance, found_noise, rough_noise

IDENTIFIED = "identified"  # what a log says of a parameter, as are the next three: its interval is narrow enough
ZERO = "not told from 0, taken as 0"  # its interval holds zero
UNREACHED = "not reached"  # a limit that no command came up to
UNKNOWN = "not identified"  # nothing in the log depends on it enough

LONGER = 4  # times the rows of the segments of the fit before
WORSE = 1.5  # squared errors, as a multiple of those of shorter segments, at which segments are too long


@dataclass(frozen=True)
class ParameterEstimate:
    """What a log says about a parameter."""

    name: str
    value: float  # what the fit takes; nan where it is not identified, inf for a limit that was not reached
    low: float  # 95 % interval
    high: float
    verdict: str  # IDENTIFIED, ZERO, UNREACHED or UNKNOWN


@dataclass(frozen=True)
class Identified:
    """The vehicle in a log."""

    model: LogModel
    estimates: tuple[ParameterEstimate, ...]  # of all of `FITTED_PARAMETERS`
    values: Array  # what was fitted, shape (P,)
    free: tuple[str, ...]  # the parameters whose values the last fit has chosen
    covariance: Array  # of these, shape (F, F)
    noise: Array  # standard deviations of x, y, psi, u, v, r, shape (6,)
    errors: Array  # measured less predicted, in SI units, shape (T, 6)
    predicted: Array  # shape (T, 6)

    def __getitem__(self, name: str) -> ParameterEstimate:
        """Return what is known of a parameter of `FITTED_PARAMETERS`."""
        return next(estimate for estimate in self.estimates if estimate.name == name)

    @property
    def unknown(self) -> tuple[str, ...]:
        """The parameters that every vehicle needs and this log does not show."""
        return tuple(name for name in NEEDED if self[name].verdict == UNKNOWN)

    def vehicle(self, like: Vehicle | None = None) -> Vehicle:
        """Return the vehicle; what the log does not show is taken from another one. The design speed is the log's mean.

        Raises:
            ValueError: the log does not show all and no other vehicle is given, or no vehicle can be like that.
        """
        if self.unknown and like is None:
            raise ValueError(f"the log does not show {', '.join(self.unknown)}; {advice(self.unknown)}")
        values = {name: self[name].value for name in COEFFICIENTS}
        for name, value in values.items():
            if math.isnan(value):
                values[name] = getattr(like, name) if name in NEEDED else 0.0
        return Vehicle(**values, speed=self.speed)

    @property
    def speed(self) -> float:
        """The mean surge speed [m/s] of the log."""
        return float(np.abs(self.model.log.measured[:, 3]).mean())


def advice(names: Sequence[str]) -> str:
    """Return which manoeuvre would show parameters of the vehicle, in half a sentence."""
    if any(name[-1] in "23vr" for name in names):
        return "a zig-zag or a turning circle under way would"
    return "steps of the surge force would"


def identify(
    log: Log, terms: Sequence[str] | None = None, over_ground: bool = True, segment: float = 0.0
) -> Identified:
    """Return the vehicle in a log: prediction errors as small as they can be, noise and current found along the way.

    Args:
        log: what was measured and commanded.
        terms: names of the optional parameters of the vehicle that may differ from 0; None: all that there are. Each is
            dropped where the log does not tell it from 0, one after the other, the least certain one first.
        over_ground: whether u, v are measured over ground; else through the water.
        segment: length [s] of the pieces that are predicted from a first state; 0: by the vehicle's time constants.

    Raises:
        ValueError: an unknown term, a segment that is too short or too long, or a log that nothing can be fitted to.
    """
    candidates = OPTIONAL if terms is None else tuple(terms)
    if unknown := [name for name in candidates if name not in OPTIONAL]:
        raise ValueError(f"{unknown[0]!r} is no optional parameter of a vehicle; allowed are {', '.join(OPTIONAL)}")
    check_segment(log, segment)
    rough, values, hidden = first_estimates(log, over_ground)
    length, rows = segment_length(log, values, segment), LONGER * FIRST_SEGMENT
    search = None
    while True:  # longer and longer: the more is asked of the values, the nearer they are
        model = LogModel(log, segment_starts(log, min(rows * log.dt, length)), substeps_for(log, values), over_ground)
        try:
            longer = _Search(model, rough, values, candidates, hidden)
        except ValueError:
            longer = None
        if longer is None or (search is not None and longer.misfit > WORSE * search.misfit):
            break  # errors have grown so far on the way that there is no following them
        search, values = longer, longer.values
        if rows * log.dt >= length:
            break
        rows *= LONGER
    if search is None:
        raise ValueError(FAILED_START)
    return search.run()


def may_be_negative(name: str) -> bool:
    """Return whether a vehicle may have less than nothing of an optional parameter."""
    try:
        replace(PAPER_VEHICLE, **{name: -1e-6})
    except ValueError:
        return False
    return True


class _Search:
    """Fits in turn: with all that may be, then without what is not told from nothing, the least certain first."""

    def __init__(
        self, model: LogModel, rough: RoughStart, values: Array, terms: Sequence[str], hidden: set[str]
    ) -> None:
        self.model, self.rough, log = model, rough, model.log
        self.peaks = np.abs(log.commands).max(axis=0)
        self.scales, self.bounds = scales_of(log, rough), bounds_of(log, rough)
        self.free, self.noise = [n for n in shown(log, rough, terms) if n not in hidden], rough_noise(log)
        self.dropped: dict[str, ParameterEstimate] = {}
        self.states, self.spread = first_states(model), np.zeros((0, 0))
        self.values, self.left = self._fitted(np.clip(values, *self._inside()))

    @property
    def misfit(self) -> float:
        """Mean squared error, in variances of the noise."""
        return float(np.mean(self.left.errors**2))

    def _inside(self) -> tuple[Array, Array]:
        """Return the bounds, free limits a little below the largest commands: beyond these they have no effect."""
        low, high = self.bounds
        below = np.array([0.999 if name in LIMIT_NAMES and name in self.free else 1.0 for name in FITTED_PARAMETERS])
        return low, high * below

    def _fitted(self, values: Array) -> tuple[Array, Left]:
        free = np.array([FITTED_PARAMETERS.index(name) for name in self.free])
        return fit(self.model, values, free, self.bounds, self.scales, self.states, self.noise)

    def _refit(self) -> None:
        """Fit again from where it is, with the noise that was found."""
        self.states = self.left.states
        self.noise = found_noise(self.left, self.noise, self.model.log)
        self.values, self.left = self._fitted(self.values)
        self.spread = covariance(self.left, self.model.starts)

    def run(self) -> Identified:
        """Return what there is once everything that is left is told from nothing."""
        self._refit()
        self._refit()
        while (name := self._least_certain()) is not None:
            estimate = self._estimate(name)
            unreached = name in LIMIT_NAMES
            self.dropped[name] = replace(
                estimate, value=math.inf if unreached else 0.0, verdict=UNREACHED if unreached else ZERO
            )
            if unreached:
                peak = float(self.peaks[LIMIT_NAMES.index(name)])
                self.dropped[name] = replace(self.dropped[name], low=min(estimate.low, peak), high=math.inf)
            self.values[FITTED_PARAMETERS.index(name)] = (
                self.bounds[1][FITTED_PARAMETERS.index(name)] if unreached else 0.0
            )
            self.free.remove(name)
            self._refit()
        return self._identified()

    def _certainty(self, name: str) -> float:
        """Return by how many standard deviations a parameter differs from what it is without effect."""
        at = self.free.index(name)
        value, deviation = self.values[FITTED_PARAMETERS.index(name)], math.sqrt(self.spread[at, at])
        if name in LIMIT_NAMES:
            return float((self.peaks[LIMIT_NAMES.index(name)] - value) / deviation)
        sure = float(value / deviation)
        return abs(sure) if name in OPTIONAL and may_be_negative(name) else sure

    def _least_certain(self) -> str | None:
        candidates = [name for name in self.free if name in (*OPTIONAL, *LIMIT_NAMES, "lag")]
        sure = {name: self._certainty(name) for name in candidates}
        least = min(sure, key=lambda name: sure[name], default=None)
        return least if least is not None and sure[least] < NORMAL_QUANTILE else None

    def _estimate(self, name: str) -> ParameterEstimate:
        """Return what the last fit says about one of the parameters that it has chosen."""
        at, value = self.free.index(name), float(self.values[FITTED_PARAMETERS.index(name)])
        half = NORMAL_QUANTILE * math.sqrt(self.spread[at, at])
        low, high = value - half, value + half
        if name not in CURRENT_NAMES and not (name in OPTIONAL and may_be_negative(name)):
            low, high = max(low, 0.0), max(high, 0.0)
        verdict = IDENTIFIED
        if name in COEFFICIENTS and half > abs(value) and half * self.rough.shares[COEFFICIENTS.index(name)] > 1:
            verdict = UNKNOWN
        return ParameterEstimate(name, value, low, high, verdict)

    def _of(self, name: str) -> ParameterEstimate:
        if name in self.free:
            estimate = self._estimate(name)
            return replace(estimate, value=math.nan) if estimate.verdict == UNKNOWN else estimate
        if name in self.dropped:
            return self.dropped[name]
        if name in LIMIT_NAMES:
            return ParameterEstimate(name, math.inf, float(self.peaks[LIMIT_NAMES.index(name)]), math.inf, UNREACHED)
        return ParameterEstimate(name, math.nan, -math.inf, math.inf, UNKNOWN)

    def _identified(self) -> Identified:
        errors = self.left.errors * self.noise
        measured = unwrapped(self.model.log)
        estimates = tuple(self._of(name) for name in FITTED_PARAMETERS)
        return Identified(
            self.model, estimates, self.values, tuple(self.free), self.spread, self.noise, errors, measured - errors
        )
