"""Search gains by an evolution strategy, with the same number of evaluations for every controller.

It is the CMA-ES of N. Hansen and A. Ostermeier ("Completely derandomized self-adaptation in evolution strategies",
Evolutionary Computation 9(2):159-195, 2001) with a diagonal covariance, on the logarithms of the gains. Each generation
has new episodes, so that the gains do not overfit to a few of them. The episodes of a generation are the same for every
controller. At the end three sets of gains are compared on further episodes: the initial gains, the mean of the search
after half of the generations, and its last mean.
"""

from __future__ import annotations

import importlib.metadata
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from functools import partial
from typing import Any

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.physics.space import SpaceVehicle
from auv_gym.physics.vehicle import Vehicle
from auv_gym.task.policy import Policy
from baselines.evaluation.score import EXPERT, SETPOINT_EXPERT
from baselines.policies import make_policy
from baselines.tools.seeds import TUNING, TUNING_CHECK
from baselines.tuning.objective import Tunable, TuningEpisodes, compared

EVALUATIONS = 300
"""Evaluations of a search, the same for all controllers."""
TUNING_EPISODES = 32
"""Episodes of an evaluation."""
POPULATION = 12  # evaluations of a generation
FINALISTS = 3  # sets of gains in the final comparison
RUN_OFF = 4  # evaluations of each set in the final comparison
SPREAD = 0.4  # standard deviation of the logarithms of the gains in the first generation
LARGEST_CHANGE = 30.0  # bounds of the search: start / LARGEST_CHANGE, start * LARGEST_CHANGE
TUNING_SEED = TUNING.first  # first seed of the tuning episodes
VALIDATION_SEED = TUNING_CHECK.first  # first seed of the validation episodes
VALIDATION_EPISODES = 512
"""Episodes of the final comparison of the best gains with those of the expert."""

SHOW = partial(print, flush=True)  # displays the progress of a search
GainSet = Mapping[str, float]
Factory = Callable[[dict[str, float]], Policy]
"""Returns the policy with these gains at every speed."""
Draw = Callable[[int, int], TuningEpisodes]
"""Returns a number of episodes, drawn with seeds from the given one."""


@dataclass(frozen=True)
class Budget:
    """The size of a search; the defaults are those of all shipped gains."""

    evaluations: int = EVALUATIONS
    episodes: int = TUNING_EPISODES

    @property
    def generations(self) -> int:
        """Number of generations before the final comparison."""
        return max(0, (self.evaluations - FINALISTS * RUN_OFF) // POPULATION)

    @property
    def last_seed(self) -> int:
        """The seed after that of the last episode."""
        return TUNING_SEED + (self.generations + RUN_OFF) * self.episodes


def tune(
    factory: Factory, draw: Draw, start: GainSet, budget: Budget, show: Callable[[str], None] = SHOW
) -> dict[str, float]:
    """Return the best gains of a search.

    Args:
        factory: returns the controller with given gains.
        draw: returns episodes.
        start: initial gains, positive.
        budget: of the search.
        show: displays the progress.
    """
    names, centre = list(start), np.log(np.array(list(start.values())))
    finalists = [centre]
    begin = time.monotonic()

    def cost(x: Array, episodes: TuningEpisodes) -> float:
        result = episodes.run(factory(_gains(names, x)))
        return result.cost_m

    if budget.generations:
        import cma

        options: dict[str, Any] = {"popsize": POPULATION, "CMA_diagonal": True, "seed": 1, "verbose": -9}
        radius = np.log(LARGEST_CHANGE)
        options |= {"bounds": [(centre - radius).tolist(), (centre + radius).tolist()]}
        strategy = cma.CMAEvolutionStrategy(centre, SPREAD, options)
        for generation in range(budget.generations):
            episodes = draw(budget.episodes, TUNING_SEED + generation * budget.episodes)
            points = strategy.ask()
            costs = [cost(x, episodes) for x in points]
            strategy.tell(points, costs)
            show(f"{generation + 1:3d} {time.monotonic() - begin:6.0f} s  {np.median(costs):.5g}")
            if generation + 1 in (budget.generations // 2, budget.generations):
                finalists.append(np.array(strategy.result.xfavorite))
    episodes = draw(RUN_OFF * budget.episodes, TUNING_SEED + budget.generations * budget.episodes)
    ranked = sorted((cost(x, episodes), i) for i, x in enumerate(finalists))
    show(f"run-off {ranked}")
    return _gains(names, finalists[ranked[0][1]])


def search_record(
    tunable: Tunable,
    draw: Draw,
    start: GainSet,
    budget: Budget,
    vehicle: Vehicle | SpaceVehicle,
    check: int = VALIDATION_EPISODES,
    show: Callable[[str], None] = SHOW,
) -> dict[str, Any]:
    """Return the record of a search: gains, origin, and results on validation episodes.

    A search whose result is not better there than its start keeps the start.

    Args:
        tunable: the controller.
        draw: returns episodes.
        start: initial gains, positive.
        budget: of the search; without evaluations the gains are the initial ones.
        vehicle: nominal one, in the paper's units.
        check: number of validation episodes.
        show: displays the progress.
    """
    factory = partial(tunable.factory, vehicle=vehicle)
    found = tune(factory, draw, start, budget, show) if budget.evaluations else dict(start)
    episodes = draw(check, VALIDATION_SEED)
    before = episodes.run(factory(dict(start)))
    after = before if found == start else episodes.run(factory(dict(found)))
    gains, result = (found, after) if after.cost_m < before.cost_m else (dict(start), before)
    usual = SETPOINT_EXPERT if tunable.world == "setpoints" else EXPERT
    expert = episodes.run(make_policy(usual, vehicle=vehicle))
    return {
        "gains": gains,
        "start": dict(start),
        "evaluations": budget.evaluations,
        "episodes": budget.episodes,
        "world": tunable.world,
        "validation": {
            "episodes": check,
            "seed": VALIDATION_SEED,
            "start_cost_m": before.cost_m,
            **compared(result, expert),
        },
        "date": datetime.now(timezone.utc).date().isoformat(),
        "versions": {name: importlib.metadata.version(name) for name in ("cma", "gymnasium", "numpy", "scipy")},
    }


def _gains(names: Sequence[str], x: Array) -> dict[str, float]:
    """Return the gains of a point, by name."""
    return dict(zip(names, np.exp(x).tolist(), strict=True))
