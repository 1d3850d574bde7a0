"""Tune a controller's gains on episodes of its own: `auv-gym tune --help`.

The objective is the error that the score is made of: the mean over the eight cases of a regime of the tail RMSE, that
of an episode at most the distance from which it counts as lost. Gains are searched on a logarithmic scale.
"""

from __future__ import annotations

import importlib.metadata
import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from typing import Annotated, Literal

import numpy as np
from scipy import optimize
from tyro.conf import Positional, arg

from auv_gym.policy import Policy
from auv_gym.presets import CASES
from baselines import make_policy
from baselines.control.backstepping import GAINS, LAW_GAINS, Backstepping, Gains
from baselines.control.current_observer import OBSERVER_GAINS, make_current_observer
from baselines.control.ekf_law import EKF_GAINS, make_ekf_law
from baselines.control.integral import NORMALISED_GAINS, PRINTED_GAINS, make_integral, make_integral_normalised
from baselines.control.los_pid import PIDGains, make_los_pid
from baselines.control.lqi import LqiWeights, make_lqi
from baselines.control.nmpc.controller import NMPC_GAINS, make_nmpc
from baselines.gains.loading import FOLDER, gain_file, gain_record, load_gains
from baselines.policy import Array
from baselines.tools.command_line import DONE, UsageError, parse, typed
from baselines.tuning.objective import Course, compared

PROGRAM = "python -m baselines.tuning"
TUNING_SEED = 10_000_000  # first seed of the episodes that gains are tuned on; an evaluation's begin far below
VALIDATION_SEED = 20_000_000  # first seed of the episodes that gains are checked on
VALIDATION_EPISODES = 1024  # that gains are checked on

GainSet = Mapping[str, float]


@dataclass(frozen=True)
class Tunable:
    """A controller whose gains can be tuned."""

    factory: Callable[[dict[str, float]], Policy]  # the policy with these gains at every speed
    names: Sequence[str]  # of the gains
    start: Mapping[str, Gains] | None = None  # to begin the search at, by regime; None: those of its file
    ratio: float = 30.0  # gains are searched from start / ratio to start * ratio


TUNABLES: dict[str, Tunable] = {
    "backstepping": Tunable(
        lambda gains: Backstepping(Gains(**gains)), LAW_GAINS, {"slow": GAINS["paper"], "cruise": GAINS["cruise"]}
    ),
    "integral": Tunable(make_integral, PRINTED_GAINS),
    "integral-normalised": Tunable(make_integral_normalised, NORMALISED_GAINS),
    "current-observer": Tunable(make_current_observer, OBSERVER_GAINS),
    "ekf": Tunable(make_ekf_law, EKF_GAINS),
    "los-pid": Tunable(make_los_pid, PIDGains._fields),
    "lqi": Tunable(make_lqi, LqiWeights._fields),
    "nmpc": Tunable(make_nmpc, NMPC_GAINS),
}
"""What can be tuned, by name: add an entry here."""


class _EvaluationsSpentError(Exception):
    """Ends a search; unlike StopIteration it passes through the optimisers."""


def tune(tunable: Tunable, course: Course, start: GainSet, evaluations: int, price: float = 0.0) -> dict[str, float]:
    """Return the best gains that were found on a course.

    Two fifths of the evaluations go to a differential evolution between the bounds, the rest to Nelder and Mead's
    simplex from the best that it found.

    Args:
        tunable: the controller.
        course: the episodes.
        start: gains to begin at; 0 evaluations return them.
        evaluations: how often the course may be run.
        price: what is minimised is the error times the command's smoothness to this power.
    """
    search = _Search(tunable, course, start, evaluations, price)
    try:
        if evaluations:
            search.explore()
            search.refine()
    except _EvaluationsSpentError:
        pass
    return search.gains(search.best)


class _Search:
    """The best gains so far, as logarithms, and what is left of the evaluations."""

    def __init__(self, tunable: Tunable, course: Course, start: GainSet, evaluations: int, price: float) -> None:
        self._tunable, self._course, self._evaluations, self._price = tunable, course, evaluations, price
        self._names = list(start)
        self._centre = np.log(np.array([start[name] for name in self._names]))
        self._reach = np.log(tunable.ratio)
        self.best, self._lowest = self._centre, np.inf
        self._count, self._begin = 0, time.monotonic()

    def gains(self, x: Array) -> dict[str, float]:
        """Return the gains of a point, by name."""
        return dict(zip(self._names, np.exp(x).tolist(), strict=True))

    def _cost(self, x: Array) -> float:
        """Return the cost of a point, higher the farther out of bounds; raise _EvaluationsSpentError at the end."""
        if self._count >= self._evaluations:
            raise _EvaluationsSpentError
        inside = np.clip(x, self._centre - self._reach, self._centre + self._reach)
        gains = self.gains(inside)
        result = self._course.run(self._tunable.factory(gains))
        cost = float(result.error_m * result.smoothness**self._price * (1 + np.abs(x - inside).sum()))
        self._count += 1
        if cost < self._lowest:
            self.best, self._lowest = inside, cost
            seconds = time.monotonic() - self._begin
            print(f"{self._count:5d} {seconds:6.0f} s {result.error_m:8.4f} m  {_text(gains)}", flush=True)
        return cost

    def explore(self) -> None:
        """Evolve a population of three per gain within a factor of 4 about the start, which is one of it."""
        rng, centre, reach = np.random.default_rng(0), self._centre, self._reach
        population = centre + min(np.log(4.0), reach) * rng.uniform(-1, 1, (3 * len(centre), len(centre)))
        population[0] = centre
        bounds = optimize.Bounds(centre - reach, centre + reach)
        generations = max(0, round(0.4 * self._evaluations / len(population)) - 1)
        optimize.differential_evolution(self._cost, bounds, init=population, maxiter=generations, polish=False, rng=rng)

    def refine(self) -> None:
        """Restart a simplex at the best gains until the evaluations are used up, each smaller than the last."""
        size = 0.3
        while self._count < self._evaluations:
            x = self.best
            inwards = np.where(x < self._centre + self._reach - size, 1, -1)
            simplex = np.vstack((x, x + size * np.diag(inwards)))
            options = {"initial_simplex": simplex, "adaptive": True, "xatol": 0.02 * size, "fatol": 1e-6}
            optimize.minimize(self._cost, x, method="Nelder-Mead", options=options)
            size = max(0.5 * size, 0.05)


def _text(gains: GainSet) -> str:
    return " ".join(f"{name}={value:.4g}" for name, value in gains.items())


@dataclass(frozen=True)
class Options:
    """Tune the gains of a controller and keep them in baselines/gains/NAME-REGIME.json, with where they come from.

    Exit status: 0 done, 2 wrong usage.
    """

    name: Annotated[Positional[str], arg(metavar="NAME")]
    """The controller."""
    regime: Annotated[Literal["slow", "cruise"], arg(metavar="slow|cruise")] = "cruise"
    """Speeds, limits and disturbances to tune for."""
    episodes: int = 256
    """Episodes of the objective, a multiple of 8: as many of each case."""
    seed: int = TUNING_SEED
    """Seed of the first of them."""
    evaluations: int = 400
    """How often they are run; 0 measures the gains that the search would begin at."""
    price: float = 0.0
    """What is minimised is the error times the mean squared change of the command to this power; 0: the error alone."""
    resume: bool = False
    """Begin at the gains that the file holds, not where the search that found them began."""
    dry: bool = False
    """Print only; leave the file as it is."""


def main(arguments: Sequence[str]) -> int:
    """Tune as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    _check(options)
    tunable, start = TUNABLES[options.name], _start(options)
    course = Course(options.regime, options.episodes, options.seed)
    gains = tune(tunable, course, start, options.evaluations, options.price)
    validation = Course(options.regime, VALIDATION_EPISODES, VALIDATION_SEED)
    expert, result = validation.run(make_policy("backstepping")), validation.run(tunable.factory(gains))
    record = {
        "policy": options.name,
        "regime": options.regime,
        "gains": gains,
        "start": dict(start),
        **_origin(options),
        "command": typed(PROGRAM, arguments),
        "episodes": options.episodes,
        "seed": options.seed,
        "evaluations": options.evaluations,
        "error_m": course.run(tunable.factory(gains)).error_m,
        "validation": {"episodes": VALIDATION_EPISODES, "seed": VALIDATION_SEED, **compared(result, expert)},
        "date": datetime.now(timezone.utc).date().isoformat(),
        "versions": {name: importlib.metadata.version(name) for name in ("gymnasium", "numpy", "scipy")},
    }
    print(json.dumps(record, indent=2))
    if not options.dry:
        FOLDER.mkdir(exist_ok=True)
        gain_file(options.name, options.regime).write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    return DONE


def _check(options: Options) -> None:
    """Raise UsageError if an option is wrong."""
    if options.name not in TUNABLES:
        raise UsageError(f"unknown controller {options.name!r}; allowed are {', '.join(TUNABLES)}")
    if options.episodes < len(CASES) or options.episodes % len(CASES):
        raise UsageError(f"--episodes is {options.episodes}; it must be a positive multiple of {len(CASES)}")
    if options.seed < TUNING_SEED or options.seed + options.episodes > VALIDATION_SEED:
        raise UsageError(f"--seed is {options.seed}; tuning episodes have {TUNING_SEED} ... {VALIDATION_SEED - 1}")
    if options.evaluations < 0:
        raise UsageError(f"--evaluations is {options.evaluations}; it must be at least 0")
    if not 0 <= options.price <= 1:
        raise UsageError(f"--price is {options.price}; it must be in [0, 1]")


def _start(options: Options) -> GainSet:
    """Return the gains that a search begins at."""
    tunable = TUNABLES[options.name]
    if tunable.start and not options.resume:
        return {name: getattr(tunable.start[options.regime], name) for name in tunable.names}
    part = "gains" if options.resume else "start"
    try:
        return load_gains(options.name, options.regime, tunable.names, part)
    except ValueError as error:
        raise UsageError(str(error)) from error


def _origin(options: Options) -> dict[str, str]:
    """Return where gains come from that no search has found."""
    if options.evaluations or TUNABLES[options.name].start:
        return {}
    return {"origin": gain_record(options.name, options.regime).get("origin", "set by hand, not by this tuner")}
