"""The search for gains: an evolution strategy with the same number of evaluations for every controller.

It is the CMA-ES of N. Hansen and A. Ostermeier ("Completely derandomized self-adaptation in evolution strategies",
Evolutionary Computation 9(2):159-195, 2001) with a diagonal covariance, on the logarithms of the gains. Each generation
runs other episodes than the one before, so that gains are found that are good in all of them and not in a few; the
generations of every controller run the same ones. In the end a run-off on further episodes decides between the gains
that the search began at, its mean half way, and its last mean.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from auv_gym.installation import install
from auv_gym.physics.namespaces import Array
from auv_gym.task.policy import Policy
from baselines.tools.seeds import TUNING, TUNING_CHECK
from baselines.tuning.objective import Result, TuningEpisodes

EVALUATIONS = 300
"""How often episodes are run to tune a controller in a regime, the same for all."""
TUNING_EPISODES = 32
"""Episodes of an evaluation."""
POPULATION = 12  # evaluations of a generation
FINALISTS = 3  # gains that meet in the run-off
RUN_OFF = 4  # evaluations that each of them is given there
SPREAD = 0.4  # standard deviation of the logarithms of the gains in the first generation
LARGEST_CHANGE = 30.0  # gains are searched from start / LARGEST_CHANGE to start * LARGEST_CHANGE
TUNING_SEED = TUNING.first  # first seed of the episodes that gains are tuned on; an evaluation's begin far below
VALIDATION_SEED = TUNING_CHECK.first  # first seed of the episodes that gains are checked on
VALIDATION_EPISODES = 512  # that gains are checked on

GainSet = Mapping[str, float]
Factory = Callable[[dict[str, float]], Policy]
"""Makes the policy that has these gains at every speed."""
Courses = Callable[[int, int], TuningEpisodes]
"""Returns the course of so many episodes from a seed on."""


@dataclass(frozen=True)
class Budget:
    """What a search may spend; the defaults are everybody's."""

    evaluations: int = EVALUATIONS
    episodes: int = TUNING_EPISODES

    @property
    def generations(self) -> int:
        """How many generations there are beside the run-off."""
        return max(0, (self.evaluations - FINALISTS * RUN_OFF) // POPULATION)

    @property
    def last_seed(self) -> int:
        """The seed behind that of the last episode."""
        return TUNING_SEED + (self.generations + RUN_OFF) * self.episodes


def tune(
    factory: Factory, courses: Courses, start: GainSet, budget: Budget | None = None, price: float = 0.0
) -> dict[str, float]:
    """Return the best gains that were found.

    Args:
        factory: the controller.
        courses: the episodes.
        start: positive gains to begin at.
        budget: of the search.
        price: what is minimised is the error times the command's smoothness to this power.
    """
    budget = budget or Budget()
    names, centre = list(start), np.log(np.array(list(start.values())))
    finalists = [centre]
    begin = time.monotonic()

    def cost(x: Array, episodes: TuningEpisodes) -> float:
        result = episodes.run(factory(_gains(names, x)))
        return priced(result, price)

    if budget.generations:
        cma = strategies()
        options: dict[str, Any] = {"popsize": POPULATION, "CMA_diagonal": True, "seed": 1, "verbose": -9}
        reach = np.log(LARGEST_CHANGE)
        options |= {"bounds": [(centre - reach).tolist(), (centre + reach).tolist()]}
        strategy = cma.CMAEvolutionStrategy(centre, SPREAD, options)
        for generation in range(budget.generations):
            episodes = courses(budget.episodes, TUNING_SEED + generation * budget.episodes)
            points = strategy.ask()
            costs = [cost(x, episodes) for x in points]
            strategy.tell(points, costs)
            print(f"{generation + 1:3d} {time.monotonic() - begin:6.0f} s  {np.median(costs):.5g}", flush=True)
            if generation + 1 in (budget.generations // 2, budget.generations):
                finalists.append(np.array(strategy.result.xfavorite))
    episodes = courses(RUN_OFF * budget.episodes, TUNING_SEED + budget.generations * budget.episodes)
    ranked = sorted((cost(x, episodes), i) for i, x in enumerate(finalists))
    print("run-off", ranked, flush=True)
    return _gains(names, finalists[ranked[0][1]])


def strategies() -> Any:
    """Return the package of evolution strategies.

    Raises:
        ImportError: it is not installed.
    """
    try:
        import cma
    except ImportError as error:
        raise ImportError(f"tuning needs an evolution strategy: {install('tuning')}") from error
    return cma


def priced(result: Result, price: float) -> float:
    """Return what is minimised."""
    return result.error_m * result.smoothness**price if price else result.error_m


def _gains(names: Sequence[str], x: Array) -> dict[str, float]:
    """Return the gains of a point, by name."""
    return dict(zip(names, np.exp(x).tolist(), strict=True))
