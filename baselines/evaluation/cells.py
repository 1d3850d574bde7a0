"""Cells: the episodes of one scenario, which are the same for every policy."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.records import to_record
from auv_gym.scenarios.scenario import Scenario, path_record
from auv_gym.task.policy import Policy
from baselines.evaluation.metrics import Ended, steady_rmse
from baselines.evaluation.rollout import ControlStep, Repeatable, beginning


@dataclass(frozen=True)
class Cell:
    """Episodes of one scenario, the same for every policy."""

    scenario: Scenario
    episodes: tuple[Episode, ...]

    @cached_property
    def hash(self) -> str:
        """SHA-256 of scenario and episodes."""
        episodes = [to_record(episode) | {"path": path_record(episode.path)} for episode in self.episodes]
        return hashlib.sha256(json.dumps([self.scenario.to_dict(), episodes], sort_keys=True).encode()).hexdigest()

    @cached_property
    def beyond(self) -> NDArray[np.bool_]:
        """Whether the plan of each episode exceeds the limits, or there is none, in its mean current; shape (M,)."""
        return np.array([self.scenario.current is not None and _is_beyond(self.scenario, e) for e in self.episodes])


def _is_beyond(scenario: Scenario, episode: Episode) -> bool:
    try:
        return min(scenario.reserves(episode)) < 0
    except ValueError:  # in space, or with too many samples in the current, nothing is known
        return False


def drawn(scenario: Scenario, episodes: int, seed: int) -> Cell:
    """Return a cell of drawn episodes; episode i is that of an environment reset with `seed + i`.

    Raises:
        ValueError: no path of the scenario is feasible.
    """
    planner = scenario.planner
    generators = (seeding.np_random(seed + i)[0] for i in range(episodes))
    return Cell(scenario, tuple(scenario.drawn(rng, lambda e: planner.table(e.path))[0] for rng in generators))


class SideBySide:
    """All episodes of some cells in parallel; the results are those of `rollout` for each cell.

    Args:
        cells: cells whose scenarios have the same number of substeps.
    """

    def __init__(self, cells: Sequence[Cell]) -> None:
        self.cells = tuple(cells)
        self.of = np.repeat(np.arange(len(cells)), [len(cell.episodes) for cell in cells])
        self.steps = max(cell.scenario.steps for cell in cells)
        self._episodes = Repeatable(partial(beginning, [(cell.scenario, cell.episodes) for cell in cells]))

    def run(self, policy: Policy, watch: Callable[[int, ControlStep], None] = lambda *_: None) -> list[Ended]:
        """Run a policy and return the outcome of the episodes of each cell, arrays of shape (M,).

        Args:
            policy: a policy that is not `Privileged`.
            watch: called after each control step with its number and its results.

        Raises:
            PolicyError: the actions are not finite.
        """
        errors, failed = np.zeros((self.steps, len(self.of))), np.zeros(len(self.of), dtype=bool)
        for k, moment in enumerate(self._episodes.play(policy, self.steps)):
            watch(k, moment)
            errors[k] = moment.error
            failed |= moment.failed
        masks = (self.of == i for i in range(len(self.cells)))
        steps = (cell.scenario.steps for cell in self.cells)
        return [Ended(steady_rmse(errors[:n, mask]), failed[mask]) for n, mask in zip(steps, masks, strict=True)]
