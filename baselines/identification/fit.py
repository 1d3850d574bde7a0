"""From a log to a vehicle: which parameters it shows, their values and how well they are known."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import SIGNED_PARAMETERS, Vehicle
from baselines.identification.begin import (
    EVIDENCE,
    FAILED_START,
    FIRST_SEGMENT,
    NEEDED,
    OPTIONAL,
    PLAIN_TERMS,
    check_segment,
    first_estimates,
    is_current,
    power_forms,
    segment_length,
    segment_starts,
    substeps_for,
)
from baselines.identification.least_squares import Left, first_states, fit
from baselines.identification.log import Log, unwrapped
from baselines.identification.model import COEFFICIENTS, CROSS_TERMS, LIMIT_NAMES, LogModel, parameter_names
from baselines.identification.start import Begin
from baselines.identification.stern_start import NOT_NEGATIVE_STERN
from baselines.identification.uncertainty import NORMAL_QUANTILE, covariance, found_noise, rough_noise, whiteness

IDENTIFIED = "identified"  # what a log says of a parameter, as are the next five: its interval is narrow enough
FITTED = "fitted"  # the same where the model does not explain the log: the interval is not valid
ZERO = "not significantly different from 0, taken as 0"  # its interval holds zero
SMALL = "not significantly different from 0, kept small"  # the same, where a prior keeps it small instead
UNREACHED = "not reached"  # a limit that no command came up to
UNKNOWN = "not identified"  # nothing in the log depends on it enough
KNOWN = "given"  # it was not searched for
LEFT_OUT = "left out"  # a term that was not asked for
KEPT = (*NEEDED, "T_nn", "side")
"""Parameters that are there however uncertain they are."""
NOT_NEGATIVE = frozenset((*COEFFICIENTS, *LIMIT_NAMES, *NOT_NEGATIVE_STERN, "lag")) - set(SIGNED_PARAMETERS)
"""Parameters that are magnitudes."""

LONGER = 4  # times the rows of the segments of the fit before
DOUBT = 1e-4  # `Identified.whiteness` below which the model does not explain the log
FEWEST_BEYOND = 3  # commands beyond a limit without which it is not identified
WORSE = 1.5  # squared errors, as a multiple of those of shorter segments, at which segments are too long


@dataclass(frozen=True)
class ParameterEstimate:
    """What a log says about a parameter."""

    name: str
    value: float  # what the fit takes; nan where it is not identified, inf for a limit that was not reached
    low: float  # 95 % interval
    high: float
    verdict: str  # IDENTIFIED, FITTED, ZERO, SMALL, UNREACHED, UNKNOWN, KNOWN or LEFT_OUT


@dataclass(frozen=True)
class Identified:
    """The vehicle in a log."""

    model: LogModel
    estimates: tuple[ParameterEstimate, ...]  # of all of `LogModel.names`
    values: Array  # what was fitted, shape (P,)
    free: tuple[str, ...]  # the parameters whose values the last fit has chosen
    covariance: Array  # of these, shape (F, F)
    noise: Array  # standard deviations of x, y, psi, u, v, r, shape (6,)
    errors: Array  # measured less predicted, in SI units, shape (T, 6)
    predicted: Array  # shape (T, 6)
    begin: Begin  # of the search: scales and bounds of the parameters
    states: Array  # at which the segments begin, shape (S, 6)
    whiteness: float  # probability that the noise of a right model leaves such errors, see `uncertainty.whiteness`

    def __getitem__(self, name: str) -> ParameterEstimate:
        """Return what is known of a parameter of `LogModel.names`."""
        return next(estimate for estimate in self.estimates if estimate.name == name)

    def without(self, rows: NDArray[np.bool_]) -> Array:
        """Return what the same parameters are where some rows do not count, whole segments each, shape (P,)."""
        names, begin = self.model.names, self.begin
        free = np.array([names.index(name) for name in self.free])
        forms = power_forms(names, begin.scales) if set(CROSS_TERMS) & set(self.free) else None
        arguments = begin.bounds, begin.scales, self.states, self.noise, forms, begin.sizes, ~rows
        return fit(self.model, self.values, free, *arguments)[0]

    @property
    def unknown(self) -> tuple[str, ...]:
        """The parameters that every vehicle needs and this log does not show."""
        return tuple(name for name in NEEDED if self[name].verdict == UNKNOWN)

    def vehicle(self, like: Vehicle | None = None) -> Vehicle:
        """Return the vehicle; what the log does not show is taken from another one. The design speed is the log's mean.

        With a rudder its tracked point is the centre of percussion of the rudder's side force.

        Raises:
            ValueError: the log does not show all and no other vehicle is given, or no vehicle can be like that.
        """
        if self.unknown and like is None:
            raise ValueError(f"the log does not show {', '.join(self.unknown)}; {advice(self.unknown)}")
        return self._made(like, {})

    def _made(self, like: Vehicle | None, other: Mapping[str, float]) -> Vehicle:
        """Return `vehicle`, some of its parameters with other values; raises ValueError if there is no such vehicle."""
        values = {name: other.get(name, self[name].value) for name in COEFFICIENTS}
        for name, value in values.items():
            if math.isnan(value):
                values[name] = getattr(like, name) if name in NEEDED else 0.0
            else:
                values[name] = float(f"{value:.9g}")  # so that a refusal is no row of digits
        arm = other.get("arm", self["arm"].value) if "arm" in self.model.names else math.inf
        return Vehicle(**values, speed=self.speed, eps=values["m33"] / (values["m22"] * arm))

    def ensemble(self, size: int, like: Vehicle | None = None, seed: int = 0) -> list[Vehicle]:
        """Return vehicles that the log allows: draws from the normal distribution of the fit.

        Draws that no vehicle can be like are repeated.

        Args:
            size: number of vehicles.
            like: see `vehicle`.
            seed: of the draws.

        Raises:
            ValueError: more than nine in ten draws are repeated.
        """
        rng, at = np.random.default_rng(seed), [self.model.names.index(name) for name in self.free]
        found: list[Vehicle] = []
        for drawn in rng.multivariate_normal(self.values[at], self.covariance, 10 * size, method="eigh"):
            with suppress(ValueError):
                found.append(self._made(like, dict(zip(self.free, drawn.tolist(), strict=True))))
            if len(found) == size:
                return found
        raise ValueError(
            f"{len(found)} of {10 * size} draws from the fit are possible vehicles: the log shows too little"
        )

    @property
    def misfit(self) -> bool:
        """Whether the model does not explain the log: its intervals are then not valid, however wide."""
        return self.whiteness < DOUBT

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
    log: Log,
    terms: Sequence[str] | None = None,
    over_ground: bool = True,
    segment: float = 0.0,
    known: Mapping[str, float] | None = None,
) -> Identified:
    """Return the vehicle in a log: prediction errors as small as they can be, noise and current found along the way.

    Args:
        log: what was measured and commanded, in one run or several ones.
        terms: names of the optional parameters of the vehicle that may differ from 0; None: all but cross-flow, and
            that too in a log of a rudder. Each is dropped where the log does not tell it from 0, one after the other,
            the least certain one first.
        over_ground: whether u, v are measured over ground; else through the water.
        segment: length [s] of the pieces that are predicted from a first state; 0: by the vehicle's time constants, or
            60 s in a log of a rudder.
        known: values of parameters by name that are not searched for.

    Raises:
        ValueError: an unknown term or parameter, a segment that is too short or too long, or a log that nothing can be
            fitted to.
    """
    known = {} if known is None else known
    candidates = (PLAIN_TERMS if log.kind == "force" else OPTIONAL) if terms is None else tuple(terms)
    if unknown := [name for name in candidates if name not in OPTIONAL]:
        raise ValueError(f"{unknown[0]!r} is no optional parameter of a vehicle; allowed are {', '.join(OPTIONAL)}")
    names = parameter_names(log.kind, log.wind is not None, len(log.starts))
    if unknown := [name for name in known if name not in names]:
        raise ValueError(f"{unknown[0]!r} is no parameter of this log; allowed are {', '.join(names)}")
    check_segment(log, segment)
    begin = first_estimates(log, over_ground, candidates, known)
    length, rows = segment_length(log, begin.values, segment), LONGER * FIRST_SEGMENT
    search = None
    while True:  # longer and longer: the more is asked of the values, the nearer they are
        starts = segment_starts(log, min(rows * log.dt, length))
        model = LogModel(log, starts, substeps_for(log, begin.values), over_ground)
        try:
            longer = _Search(model, begin, known, candidates)
        except ValueError:
            longer = None
        if longer is None or (search is not None and longer.misfit > WORSE * search.misfit and log.kind == "force"):
            break  # errors have grown so far on the way that there is no following them
        search, begin = longer, replace(begin, values=longer.values)
        if rows * log.dt >= length:
            break
        rows *= LONGER
    if search is None:
        raise ValueError(FAILED_START)
    found = search.run()
    if begin.sizes is not None:
        own = _Search(search.model, replace(begin, values=found.values, sizes=None), known, candidates)
        found = own.run() if own.explains() else found  # the log itself shows what it needs to
    if found.misfit and terms is None and log.kind == "force":
        more = _Search(search.model, begin.with_terms(CROSS_TERMS), known, (*candidates, *CROSS_TERMS)).run()
        gain = len(log.t) * float(np.sum(np.log(found.noise / more.noise)))
        found = more if gain > EVIDENCE else found
    return found


class _Search:
    """Fits in turn: with all parameters, then without those that do not differ from 0, the least certain first."""

    def __init__(self, model: LogModel, begin: Begin, known: Mapping[str, float], terms: Sequence[str]) -> None:
        self.model, self.begin, self.names, log = model, begin, model.names, model.log
        self.peaks = np.abs(log.commands).max(axis=0)
        self.scales, self.bounds = begin.scales, begin.bounds
        self.forms = power_forms(self.names, self.scales) if set(CROSS_TERMS) & set(begin.free) else None
        self.free, self.noise = list(begin.free), rough_noise(log)
        self.dropped: dict[str, ParameterEstimate] = {}
        self.known, self.terms, self.kept = known, terms, set(KEPT)
        self.states, self.spread = first_states(model), np.zeros((0, 0))
        self.values, self.left = self._fitted(np.clip(begin.values, *self._inside()))

    @property
    def misfit(self) -> float:
        """Mean squared error, in variances of the noise."""
        return float(np.mean(self.left.errors**2))

    def _inside(self) -> tuple[Array, Array]:
        """Return the bounds, free limits a little below the largest commands: beyond these they have no effect."""
        low, high = self.bounds
        below = np.array([0.999 if name in LIMIT_NAMES and name in self.free else 1.0 for name in self.names])
        return low, high * below

    def _fitted(self, values: Array) -> tuple[Array, Left]:
        free = np.array([self.names.index(name) for name in self.free])
        return fit(
            self.model, values, free, self.bounds, self.scales, self.states, self.noise, self.forms, self.begin.sizes
        )

    def _refit(self) -> None:
        """Fit again from where it is, with the noise that was found."""
        self.states = self.left.states
        self.noise = found_noise(self.left, self.noise, self.model.log)
        self.values, self.left = self._fitted(self.values)
        self.white = whiteness(self.left.errors, self.model.starts)
        self.spread = covariance(self.left, self.model.starts, self.white < DOUBT)

    def explains(self) -> bool:
        """Whether the model explains the log with all that is free."""
        self._refit()
        return self.white >= DOUBT

    def run(self) -> Identified:
        """Return the fit once all optional parameters differ significantly from 0, or at once with a prior."""
        self._refit()
        self._refit()
        while self.begin.sizes is None and (name := self._least_certain()) is not None:
            estimate = self._estimate(name)
            unreached = name in LIMIT_NAMES
            self.dropped[name] = replace(
                estimate, value=math.inf if unreached else 0.0, verdict=UNREACHED if unreached else ZERO
            )
            if unreached:
                peak = float(self.peaks[LIMIT_NAMES.index(name)])
                self.dropped[name] = replace(self.dropped[name], low=min(estimate.low, peak), high=math.inf)
            before, free = self.values.copy(), list(self.free)
            self.values[self.names.index(name)] = self.bounds[1][self.names.index(name)] if unreached else 0.0
            self.free.remove(name)
            try:
                self._refit()
            except ValueError:  # without it the prediction blows up
                self.values, self.free = before, free
                self.kept.add(name)
                del self.dropped[name]
        return self._identified()

    def _certainty(self, name: str) -> float:
        """Return by how many standard deviations a parameter differs from what it is without effect."""
        at = self.free.index(name)
        value, deviation = self.values[self.names.index(name)], math.sqrt(self.spread[at, at])
        if name in LIMIT_NAMES:
            commands = np.abs(self.model.log.commands[:, LIMIT_NAMES.index(name)])
            shown = np.count_nonzero(commands > value) >= FEWEST_BEYOND
            return float((commands.max() - value) / deviation) if shown else -math.inf
        sure = float(value / deviation)
        return sure if name in NOT_NEGATIVE else abs(sure)

    def _least_certain(self) -> str | None:
        candidates = [name for name in self.free if name not in self.kept and not is_current(name)]
        sure = {name: self._certainty(name) for name in candidates}
        least = min(sure, key=lambda name: sure[name], default=None)
        return least if least is not None and sure[least] < NORMAL_QUANTILE else None

    def _estimate(self, name: str) -> ParameterEstimate:
        """Return what the last fit says about one of the parameters that it has chosen."""
        at, value = self.free.index(name), float(self.values[self.names.index(name)])
        half = NORMAL_QUANTILE * math.sqrt(self.spread[at, at])
        low, high = value - half, value + half
        if name in NOT_NEGATIVE:
            low, high = max(low, 0.0), max(high, 0.0)
        verdict = IDENTIFIED if self.white >= DOUBT else FITTED
        if name in COEFFICIENTS and half > abs(value) and half * self.begin.shares[name] > 1:
            verdict = UNKNOWN
        elif self.begin.sizes is not None and name not in KEPT and not is_current(name) and half > abs(value):
            verdict = SMALL
        return ParameterEstimate(name, value, low, high, verdict)

    def _of(self, name: str) -> ParameterEstimate:
        if name in self.free:
            estimate = self._estimate(name)
            return replace(estimate, value=math.nan) if estimate.verdict == UNKNOWN else estimate
        if name in self.dropped:
            return self.dropped[name]
        if name in LIMIT_NAMES:
            return ParameterEstimate(name, math.inf, float(self.peaks[LIMIT_NAMES.index(name)]), math.inf, UNREACHED)
        value = float(self.values[self.names.index(name)])
        if name in self.known:
            return ParameterEstimate(name, value, value, value, KNOWN)
        if name in OPTIONAL and name not in self.terms:
            return ParameterEstimate(name, 0.0, 0.0, 0.0, LEFT_OUT)
        return ParameterEstimate(name, math.nan, -math.inf, math.inf, UNKNOWN)

    def _identified(self) -> Identified:
        errors = self.left.errors * self.noise
        measured = unwrapped(self.model.log)
        estimates = tuple(self._of(name) for name in self.names)
        return Identified(
            self.model,
            estimates,
            self.values,
            tuple(self.free),
            self.spread,
            self.noise,
            errors,
            measured - errors,
            self.begin,
            self.states,
            self.white,
        )
