"""Tune a controller's gains on episodes of its own: `python -m baselines.tuning --help`.

The objective is the error that the score is made of: the mean over the eight cases of a regime of the tail RMSE, that
of an episode at most the distance from which it counts as lost. Gains are searched on a logarithmic scale.
"""

from __future__ import annotations

import copy
import importlib.metadata
import json
import shlex
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timezone
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import optimize
from tyro.conf import Positional, arg

from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.residual import Policy
from auv_gym.scenario import CASES, PRESETS
from baselines import make_policy
from baselines.backstepping import Backstepping, Gains
from baselines.command_line import DONE, UsageError, parse, run
from baselines.gain_files import FOLDER, gain_file, load_gains
from baselines.integral import integral_law
from baselines.lqi import lqi
from baselines.memory import Array

PROGRAM = "python -m baselines.tuning"
TUNING_SEED = 10_000_000
VALIDATION_SEED = 20_000_000
"""First seeds of the episodes that gains are tuned on and checked on; an evaluation's begin far below."""
VALIDATION_EPISODES = 1024
LARGEST_TAIL = {"slow": 0.6, "cruise": 2.0}
"""Tail RMSE [m] from which an episode counts as lost; its error is capped there."""

GainSet = Mapping[str, float]


@dataclass(frozen=True)
class Tunable:
    """A controller whose gains can be tuned."""

    factory: Callable[[dict[str, float]], Policy]  # the policy with these gains at every speed
    start: Mapping[str, GainSet]  # gains to begin the search at, by regime; all above 0
    ratio: float = 30.0  # gains are searched from start / ratio to start * ratio


LAW = {"k": 0.5, "k1": 0.7, "cu": 0.5, "ku": 0.7, "c": 0.6, "kc": 0.6, "cr": 0.1}
CRUISE_LAW = {"k": 0.918, "k1": 0.335, "cu": 0.028, "ku": 1.016, "c": 1.189, "kc": 0.102, "cr": 0.478}
INTEGRAL = {"rate": 0.1, "horizon": 5.0}
LQI_WEIGHTS = {
    "heading": 0.3, "velocity": 0.5, "turn": 1.0, "surge_effort": 1.0, "surge_rate": 0.3, "yaw_effort": 1.0,
    "yaw_rate": 0.3, "lag": 0.2, "rate": 0.2, "horizon": 5.0,
}  # fmt: skip

TUNABLES: dict[str, Tunable] = {
    "backstepping": Tunable(lambda gains: Backstepping(Gains(**gains)), {"slow": LAW, "cruise": CRUISE_LAW}),
    "integral": Tunable(
        lambda gains: integral_law("printed", gains),
        {"slow": {**LAW, **INTEGRAL}, "cruise": {**CRUISE_LAW, **INTEGRAL}},
    ),
    "integral-normalised": Tunable(
        lambda gains: integral_law("normalised", gains),
        dict.fromkeys(("slow", "cruise"), {**LAW, "reference_speed": 0.1, **INTEGRAL}),
    ),
    "lqi": Tunable(lqi, {"slow": LQI_WEIGHTS, "cruise": LQI_WEIGHTS}),
}
"""What can be tuned, by name: add an entry here."""


@dataclass(frozen=True)
class Result:
    """What a policy does in a regime."""

    error_m: float  # mean over cases of the capped tail RMSE
    case_error_m: dict[str, float]  # the same by case
    lost: float  # share of the episodes whose tail RMSE reaches the cap
    effort: float  # mean square command
    smoothness: float  # mean squared change of the command


class Course:
    """Episodes of the eight cases of a regime, side by side, to be run again and again by different policies.

    Args:
        regime: "slow" or "cruise".
        episodes: how many, a multiple of eight; episode i is of case i modulo 8.
        seed: episode i is drawn with seed + i.
    """

    def __init__(self, regime: str, episodes: int, seed: int) -> None:
        self.cases = np.arange(episodes) % len(CASES)
        self.cap = LARGEST_TAIL[regime]
        presets = [PRESETS[f"{regime}-{case}"] for case in CASES]
        self.steps, self.lost_distance = presets[0].steps, presets[0].lost_distance
        # Nothing ends or begins within the run: one step more than are run, and vehicles go on when they are lost.
        scenarios = [replace(s, steps=s.steps + 1, lost_distance=64.0) for s in presets]
        self._env = UnderactuatedAUVTrackVectorEnv(episodes, [scenarios[i] for i in self.cases.tolist()])
        self._observation, _ = self._env.reset(seed=seed)

    def run(self, policy: Policy) -> Result:
        """Return what a policy does on the course."""
        env, observation = copy.deepcopy(self._env), self._observation
        memory, first = None, np.ones(len(self.cases), dtype=bool)
        square, worst, effort, change = (np.zeros(len(self.cases)) for _ in range(4))
        last: NDArray[np.float32] | None = None
        for k in range(self.steps):
            action, memory = policy.predict(observation, memory, first)
            observation, *_, info = env.step(action)
            first = np.zeros_like(first)
            error = info["position_error"]
            worst = np.maximum(worst, error)
            square += error**2 * (k >= self.steps // 3)
            effort += np.square(action).mean(axis=1)
            change += 0.0 if last is None else np.square(action - last).mean(axis=1)
            last = action
        tail = np.sqrt(square / (self.steps - self.steps // 3))
        tail = np.where((worst > self.lost_distance) | ~(tail < self.cap), self.cap, tail)
        errors = [float(tail[self.cases == i].mean()) for i in range(len(CASES))]
        return Result(
            error_m=float(np.mean(errors)),
            case_error_m=dict(zip(CASES, errors, strict=True)),
            lost=float(np.mean(tail == self.cap)),
            effort=float(effort.mean()) / self.steps,
            smoothness=float(change.mean()) / (self.steps - 1),
        )


def tune(tunable: Tunable, course: Course, start: GainSet, evaluations: int, seed: int = 0) -> dict[str, float]:
    """Return the best gains that were found on a course.

    Two fifths of the evaluations go to a differential evolution between the bounds, the rest to Nelder and Mead's
    simplex from the best that it found.

    Args:
        tunable: the controller.
        course: the episodes.
        start: gains to begin at; 0 evaluations return them.
        evaluations: how often the course may be run.
        seed: of the search.
    """
    names = list(start)
    centre = np.log(np.array([start[name] for name in names]))
    reach = np.log(tunable.ratio)
    best: tuple[float, Array] = (np.inf, centre)
    count, begin = 0, time.monotonic()

    def objective(x: Array) -> float:
        nonlocal best, count
        if count >= evaluations:
            raise StopIteration
        inside = np.clip(x, centre - reach, centre + reach)
        gains = dict(zip(names, np.exp(inside).tolist(), strict=True))
        error = course.run(tunable.factory(gains)).error_m + float(np.abs(x - inside).sum())
        count += 1
        if error < best[0]:
            best = error, inside
            seconds = time.monotonic() - begin
            print(f"{count:5d} {seconds:6.0f} s {error:8.4f} m  {_text(gains)}", flush=True)
        return error

    def explore() -> None:
        """Evolve a population of three per gain within a factor of 4 about the start, which is one of it."""
        rng = np.random.default_rng(seed)
        population = centre + min(np.log(4.0), reach) * rng.uniform(-1, 1, (3 * len(names), len(names)))
        population[0] = centre
        bounds = optimize.Bounds(centre - reach, centre + reach)
        generations = max(0, round(0.4 * evaluations / len(population)) - 1)
        optimize.differential_evolution(objective, bounds, init=population, maxiter=generations, polish=False, rng=rng)

    def refine() -> None:
        """Restart a simplex at the best gains until the evaluations are used up, each smaller than the last."""
        size = 0.3
        while count < evaluations:
            simplex = np.vstack((best[1], best[1] + size * np.diag(np.where(best[1] < centre + reach - size, 1, -1))))
            options = {"initial_simplex": simplex, "adaptive": True, "xatol": 0.02 * size, "fatol": 1e-6}
            optimize.minimize(objective, best[1], method="Nelder-Mead", options=options)
            size = max(0.5 * size, 0.05)

    try:
        if evaluations:
            explore()
            refine()
    except StopIteration:
        pass
    return dict(zip(names, np.exp(best[1]).tolist(), strict=True))


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
    resume: bool = False
    """Begin at the gains that the file holds already."""
    dry: bool = False
    """Print only; leave the file as it is."""


def main(arguments: Sequence[str]) -> int:
    """Tune as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    if options.name not in TUNABLES:
        raise UsageError(f"unknown controller {options.name!r}; allowed are {', '.join(TUNABLES)}")
    if options.episodes < len(CASES) or options.episodes % len(CASES):
        raise UsageError(f"--episodes is {options.episodes}; it must be a positive multiple of {len(CASES)}")
    if options.seed < TUNING_SEED or options.seed + options.episodes > VALIDATION_SEED:
        raise UsageError(f"--seed is {options.seed}; tuning episodes have {TUNING_SEED} ... {VALIDATION_SEED - 1}")
    if options.evaluations < 0:
        raise UsageError(f"--evaluations is {options.evaluations}; it must be at least 0")
    tunable, regime = TUNABLES[options.name], options.regime
    start: GainSet = tunable.start[regime]
    if options.resume:
        try:
            start = load_gains(options.name, regime, list(start))
        except ValueError as error:
            raise UsageError(str(error)) from error
    course = Course(regime, options.episodes, options.seed)
    gains = tune(tunable, course, start, options.evaluations)
    tuned = course.run(tunable.factory(gains))
    validation = Course(regime, VALIDATION_EPISODES, VALIDATION_SEED)
    expert, result = validation.run(make_policy("backstepping")), validation.run(tunable.factory(gains))
    record = {
        "policy": options.name,
        "regime": regime,
        "gains": gains,
        "command": f"{PROGRAM} {shlex.join(arguments)}",
        "episodes": options.episodes,
        "seed": options.seed,
        "evaluations": options.evaluations,
        "error_m": tuned.error_m,
        "validation": {"episodes": VALIDATION_EPISODES, "seed": VALIDATION_SEED, **compared(result, expert)},
        "date": datetime.now(timezone.utc).date().isoformat(),
        "versions": {name: importlib.metadata.version(name) for name in ("gymnasium", "numpy", "scipy")},
    }
    print(json.dumps(record, indent=2))
    if not options.dry:
        FOLDER.mkdir(exist_ok=True)
        gain_file(options.name, regime).write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    return DONE


def compared(result: Result, expert: Result) -> dict[str, Any]:
    """Return a result with what it is relative to the expert's: 1 - its error, effort and smoothness ratio."""
    return {
        **asdict(result),
        "expert_error_m": expert.error_m,
        "score": 1 - result.error_m / expert.error_m,
        "effort_ratio": result.effort / expert.effort,
        "smoothness_ratio": result.smoothness / expert.smoothness,
    }


if __name__ == "__main__":
    sys.exit(run(main, PROGRAM))
