"""Identification of a vehicle from a log: the fit, the choice of the parameters, estimates with intervals."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import Vehicle
from baselines.identification.initial_values import (
    EVIDENCE,
    FIRST_SEGMENT,
    NO_INITIAL_VALUES,
    initial_values,
    segment_length,
    segment_starts,
    substeps_of_log,
)
from baselines.identification.least_squares import InitialValues, Residuals, fit, measured_states
from baselines.identification.log import Log, rough_noise
from baselines.identification.model import (
    COEFFICIENTS,
    CROSS_TERMS,
    LIMIT_NAMES,
    NEEDED,
    NOT_NEGATIVE,
    OPTIONAL,
    LogModel,
    is_current,
    names_of,
)
from baselines.identification.uncertainty import NORMAL_QUANTILE, covariance, estimated_noise, whiteness

# Verdicts on parameters:
IDENTIFIED = "identified"  # it has a value with an interval
FITTED = "fitted"  # the same with a model misfit: the interval is not valid
ZERO = "not significantly different from 0, taken as 0"  # it is dropped
SMALL = "not significantly different from 0, kept small"  # the same, with a prior instead of dropping it
UNREACHED = "not reached"  # a limit above all commands
UNKNOWN = "not identified"  # the log has too little information on it
KNOWN = "given"  # its value was given
LEFT_OUT = "left out"  # an optional term that was not requested
NEVER_DROPPED = (*NEEDED, "T_nn", "side")
"""Names of the parameters without which there is no vehicle."""
DEFAULT_TERMS = tuple(name for name in OPTIONAL if name not in CROSS_TERMS)
"""Names of the optional coefficients that are fitted first to a log of forces."""

_SETTLED = 4.0  # lags after which the force no longer depends on commands before the log
LONGER = 4  # factor on the length of segments from fit to fit
SIGNIFICANCE = 1e-4  # `Identified.whiteness` below which there is a model misfit
FEWEST_BEYOND = 3  # commands beyond a limit without which it is not identified
LIMIT_MARGIN = 1.02  # factor on a limit from which a command is beyond it
WORSE = 1.5  # factor on the mean squared error from which longer segments are rejected


@dataclass(frozen=True)
class ParameterEstimate:
    """The estimate of a parameter."""

    name: str
    value: float  # nan if it is not identified, inf for a limit that was not reached
    low: float  # 95 % confidence interval
    high: float
    verdict: str  # IDENTIFIED, FITTED, ZERO, SMALL, UNREACHED, UNKNOWN, KNOWN or LEFT_OUT


@dataclass(frozen=True)
class Identified:
    """A vehicle model that is fitted to a log."""

    model: LogModel
    estimates: tuple[ParameterEstimate, ...]  # of all parameters `LogModel.names`
    values: Array  # fitted values of all parameters, shape (P,)
    free: tuple[str, ...]  # names of the parameters of the last fit
    covariance: Array  # of the free parameters, shape (F, F)
    noise: Array  # standard deviations of x, y, psi, u, v, r, shape (6,)
    errors: Array  # measured minus predicted, in SI units, shape (T, 6)
    initial: InitialValues  # with scales and bounds of the parameters
    states: Array  # initial states of the segments, shape (S, 6)
    whiteness: float  # p-value of the portmanteau test, see `uncertainty.whiteness`

    def __getitem__(self, name: str) -> ParameterEstimate:
        """Return the estimate of a parameter of `LogModel.names`."""
        return next(estimate for estimate in self.estimates if estimate.name == name)

    def refitted_without(self, rows: NDArray[np.bool_]) -> Array:
        """Return the values of all parameters, shape (P,), after a fit that ignores some rows, shape (T,)."""
        initial = replace(self.initial, values=self.values, free=self.free)
        return fit(self.model, initial, self.states, self.noise, ~rows)[0]

    @property
    def unknown(self) -> tuple[str, ...]:
        """The names of the parameters that a vehicle needs and that are not identified."""
        return tuple(name for name in NEEDED if self[name].verdict == UNKNOWN)

    def vehicle(self, like: Vehicle | None = None, changed: Mapping[str, float] | None = None) -> Vehicle:
        """Return the vehicle; its design speed is the mean speed of the log.

        With a rudder its tracked point is the centre of percussion of the rudder's side force.

        Args:
            like: vehicle from which parameters are taken that are not identified.
            changed: other values of some parameters, by name.

        Raises:
            ValueError: a parameter is not identified and `like` is None, or the values are not those of a vehicle.
        """
        if self.unknown and like is None:
            turns = any(name[-1] in "23vr" for name in self.unknown)
            manoeuvre = "a zig-zag or a turning circle under way" if turns else "steps of the surge force"
            raise ValueError(f"the log does not show {', '.join(self.unknown)}; {manoeuvre} would")
        values = {"arm": math.inf} | {e.name: e.value for e in self.estimates} | dict(changed or {})
        for name in COEFFICIENTS:
            if math.isnan(values[name]):
                values[name] = getattr(like, name) if name in NEEDED else 0.0
        short = {name: float(f"{values[name]:.9g}") for name in COEFFICIENTS}  # short numbers in error messages
        speed = float(np.abs(self.model.log.measured[:, 3]).mean())
        return Vehicle(**short, speed=speed, eps=short["m33"] / (short["m22"] * values["arm"]))

    def ensemble(self, size: int, like: Vehicle | None = None, seed: int = 0) -> list[Vehicle]:
        """Return vehicles that are drawn from the normal distribution of the fit.

        Draws that are not possible vehicles are repeated.

        Args:
            size: number of vehicles.
            like: vehicle from which parameters are taken that are not identified.
            seed: of the draws.

        Raises:
            ValueError: more than nine in ten draws are repeated.
        """
        rng, free = np.random.default_rng(seed), self.model.indices(self.free)
        vehicles: list[Vehicle] = []
        for drawn in rng.multivariate_normal(self.values[free], self.covariance, 10 * size, method="eigh"):
            with suppress(ValueError):
                vehicles.append(self.vehicle(like, dict(zip(self.free, drawn.tolist(), strict=True))))
            if len(vehicles) == size:
                return vehicles
        possible = f"{len(vehicles)} of {10 * size} draws from the fit"
        raise ValueError(f"{possible} are possible vehicles: the log shows too little")

    @property
    def misfit(self) -> bool:
        """Whether the model does not explain the log; its intervals are then not valid."""
        return self.whiteness < SIGNIFICANCE


@np.errstate(over="ignore", divide="ignore", invalid="ignore")  # of trial steps, which are then refused
def identify(
    log: Log, terms: Sequence[str] | None = None, over_ground: bool = True, known: Mapping[str, float] | None = None
) -> Identified:
    """Return the vehicle model with the least squared prediction errors on a log.

    The errors are weighted by the noise, which is estimated. The current of each run is fitted too.

    Args:
        log: measurements and commands of one run or of several runs.
        terms: names of the optional coefficients that may differ from 0. They are dropped one by one, the least certain
            one first, if they do not differ significantly from 0. None: all without cross-flow, in a log of a rudder
            all.
        over_ground: whether u, v are measured over ground; otherwise through water.
        known: values of parameters that are not fitted, by name.

    Raises:
        ValueError: an unknown term or parameter, or a log on which the simulator diverges.
    """
    known = {} if known is None else known
    candidates = (DEFAULT_TERMS if log.kind == "force" else OPTIONAL) if terms is None else tuple(terms)
    if unknown := [name for name in candidates if name not in OPTIONAL]:
        raise ValueError(f"{unknown[0]!r} is not an optional parameter of a vehicle; allowed are {', '.join(OPTIONAL)}")
    if unknown := [name for name in known if name not in names_of(log)]:
        raise ValueError(f"{unknown[0]!r} is not a parameter of this log; allowed are {', '.join(names_of(log))}")
    initial = initial_values(log, over_ground, candidates, known)
    length, rows = segment_length(log, initial.values), LONGER * FIRST_SEGMENT * log.rarity
    last: _BackwardElimination | None = None
    while True:  # the fit of short segments gives initial values for longer ones
        starts = segment_starts(log, min(rows * log.dt, length))
        model = LogModel(log, starts, substeps_of_log(log, initial.values), over_ground)
        try:
            following = _BackwardElimination(model, initial, known, candidates)
        except ValueError:
            break
        if last is not None and following.mean_square > WORSE * last.mean_square and log.kind == "force":
            break  # errors have grown too much within the longer segments
        last, initial = following, replace(initial, values=following.values)
        if rows * log.dt >= length:
            break
        rows *= LONGER
    if last is None:
        raise ValueError(NO_INITIAL_VALUES)
    if log.kind == "force":
        settled = _without_transients(last.model, _SETTLED * float(initial.values[-1]))
        with suppress(ValueError):  # it can diverge where the log does not show the motion in yaw
            last = _BackwardElimination(settled, initial, known, candidates)
    result = last.run()
    if initial.prior is not None:
        without_prior = replace(initial, values=result.values, prior=None)
        refit = _BackwardElimination(last.model, without_prior, known, candidates)
        result = refit.run() if refit.explains() else result
    if result.misfit and terms is None and log.kind == "force":
        more = [name for name in CROSS_TERMS if name not in initial.free and initial.shares[name] > 0]
        crossed = replace(initial, free=(*initial.free, *more))
        other = _BackwardElimination(last.model, crossed, known, (*candidates, *CROSS_TERMS)).run()
        counts = len(log.t) if log.seen is None else log.seen.sum(axis=0)
        gain = float(np.sum(counts * np.log(result.noise / other.noise)))
        result = other if gain > EVIDENCE else result
    return result


def _without_transients(model: LogModel, time: float) -> LogModel:
    """Return a model in whose log the measurements of the first `time` [s] of each run do not count.

    The force at the first row depends on commands before the log, which are unknown. At least half of the first segment
    counts.
    """
    log, ends = model.log, np.append(model.starts, len(model.log.t))
    seen = np.ones_like(log.measured, dtype=bool) if log.seen is None else log.seen.copy()
    for run in log.runs:
        half = (run.start + ends[np.searchsorted(ends, run.start, side="right")]) // 2
        seen[run.start : half][log.t[run.start : half] - log.t[run.start] < time] = False
    return replace(model, log=replace(log, seen=seen))


class _BackwardElimination:
    """Fits with all parameters, then without those that do not differ from 0, the least certain one first."""

    def __init__(
        self, model: LogModel, initial: InitialValues, known: Mapping[str, float], terms: Sequence[str]
    ) -> None:
        self.model, self.initial, self.known, self.terms = model, initial, known, terms
        self.protected = set(NEVER_DROPPED)
        self.index = {name: i for i, name in enumerate(model.names)}
        self.peaks = dict(zip(LIMIT_NAMES, np.abs(model.log.commands).max(axis=0).tolist(), strict=True))
        self.free, self.noise = list(initial.free), rough_noise(model.log)
        self.dropped: dict[str, ParameterEstimate] = {}
        self.states = measured_states(model)
        low, high = initial.bounds
        limits = [name in LIMIT_NAMES and name in self.free for name in model.names]
        below = np.where(limits, 0.999, 1.0)  # limits above the largest command have no effect
        self.values, self.residuals = self._fit(np.clip(initial.values, low, high * below))
        self.mean_square = float(np.mean(self.residuals.errors**2))  # of the first fit, in variances of the noise

    def _fit(self, values: Array) -> tuple[Array, Residuals]:
        initial = replace(self.initial, values=values, free=tuple(self.free))
        return fit(self.model, initial, self.states, self.noise)

    def _refit(self) -> None:
        """Fit again from the present values, with the noise of the last fit."""
        self.states = self.residuals.states
        self.noise = estimated_noise(self.residuals, self.noise, self.model.log)
        self.values, self.residuals = self._fit(self.values)
        self.whiteness = whiteness(self.residuals, self.model.starts)
        self.covariance = covariance(self.residuals, self.model.starts, self.whiteness < SIGNIFICANCE)

    def explains(self) -> bool:
        """Return whether the model with all free parameters explains the log."""
        self._refit()
        return self.whiteness >= SIGNIFICANCE

    def run(self) -> Identified:
        """Return the fit in which all optional parameters differ significantly from 0; with a prior none is dropped."""
        self._refit()
        self._refit()
        while self.initial.prior is None:
            candidates = [name for name in self.free if name not in self.protected and not is_current(name)]
            certainties = {name: self._certainty(name) for name in candidates}
            least = min(candidates, key=certainties.__getitem__, default=None)
            if least is None or certainties[least] >= NORMAL_QUANTILE:
                break
            self._drop(least)
        return Identified(
            self.model,
            tuple(map(self._estimate, self.model.names)),
            self.values,
            tuple(self.free),
            self.covariance,
            self.noise,
            self.residuals.errors * self.noise,
            self.initial,
            self.states,
            self.whiteness,
        )

    def _certainty(self, name: str) -> float:
        """Return the difference of a parameter from its value without effect, in standard deviations."""
        value, deviation = self.values[self.index[name]], self._deviation(name)
        if name in LIMIT_NAMES:
            commands = np.abs(self.model.log.commands[:, LIMIT_NAMES.index(name)])
            reached = np.count_nonzero(commands > LIMIT_MARGIN * value) >= FEWEST_BEYOND
            return float((commands.max() - value) / deviation) if reached else -math.inf
        ratio = float(value / deviation)
        return ratio if name in NOT_NEGATIVE else abs(ratio)

    def _deviation(self, name: str) -> float:
        at = self.free.index(name)
        return math.sqrt(self.covariance[at, at])

    def _drop(self, name: str) -> None:
        """Fit without a parameter, or keep it if the prediction without it diverges."""
        estimate, values, free = self._free_estimate(name), self.values.copy(), list(self.free)
        at, limit = self.index[name], name in LIMIT_NAMES
        if limit:
            low = min(estimate.low, self.peaks[name])
            estimate = replace(estimate, value=math.inf, low=low, high=math.inf, verdict=UNREACHED)
        else:
            estimate = replace(estimate, value=0.0, verdict=ZERO)
        self.values[at] = self.initial.bounds[1][at] if limit else 0.0
        self.free.remove(name)
        try:
            self._refit()
        except ValueError:
            self.values, self.free = values, free
            self.protected.add(name)
        else:
            self.dropped[name] = estimate

    def _free_estimate(self, name: str) -> ParameterEstimate:
        """Return the estimate of a free parameter by the last fit."""
        value, half = float(self.values[self.index[name]]), NORMAL_QUANTILE * self._deviation(name)
        low, high = value - half, value + half
        if name in NOT_NEGATIVE:
            low, high = max(low, 0.0), max(high, 0.0)
        verdict = IDENTIFIED if self.whiteness >= SIGNIFICANCE else FITTED
        if half > abs(value):
            if name in COEFFICIENTS and half * self.initial.shares[name] > 1:
                verdict = UNKNOWN
            elif self.initial.prior is not None and name not in NEVER_DROPPED and not is_current(name):
                verdict = SMALL
        return ParameterEstimate(name, value, low, high, verdict)

    def _estimate(self, name: str) -> ParameterEstimate:
        if name in self.free:
            estimate = self._free_estimate(name)
            return replace(estimate, value=math.nan) if estimate.verdict == UNKNOWN else estimate
        if name in self.dropped:
            return self.dropped[name]
        if name in LIMIT_NAMES and name not in self.known:
            return ParameterEstimate(name, math.inf, self.peaks[name], math.inf, UNREACHED)
        if name in self.known or (name in OPTIONAL and name not in self.terms):
            value, verdict = float(self.values[self.index[name]]), KNOWN if name in self.known else LEFT_OUT
            return ParameterEstimate(name, value, value, value, verdict)
        return ParameterEstimate(name, math.nan, -math.inf, math.inf, UNKNOWN)
