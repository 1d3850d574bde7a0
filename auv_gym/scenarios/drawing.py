"""Several episodes of a scenario drawn at once, as rows: the same episodes as drawn one by one by `Scenario.draw`."""

from __future__ import annotations

from collections.abc import Sequence
from operator import length_hint
from typing import NamedTuple

import numpy as np

from auv_gym.physics.namespaces import Indices
from auv_gym.planning.paths import PATHS, Family, Line, Path, unstack
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.scenario import DRAWS, RandomPath, Scenario


class DrawnPaths(NamedTuple):
    """Paths of one family."""

    members: Indices  # indices of their episodes, shape (n,)
    paths: Path  # the paths as one, see `stack`


class Drawing:
    """N random episodes of a scenario: first their paths, then the rest of those that can be planned.

    Attributes:
        seeds: noise seeds of the episodes.
        paths: the paths by family; empty if the path of the scenario is fixed.
    """

    def __init__(self, scenario: Scenario, generators: Sequence[np.random.Generator]) -> None:
        """Draw the same numbers from each of N generators as `Scenario.draw`, and make the paths."""
        n, path = len(generators), scenario.path
        self._scenario, self._numbers = scenario, np.empty((n, DRAWS))
        self.seeds = []
        for row, rng in zip(self._numbers, generators, strict=True):
            rng.random(out=row)
            self.seeds.append(int(rng.integers(2**63)))
        self.paths: list[DrawnPaths] = []
        self._used, self._speed = np.zeros(n, dtype=np.int64), np.empty(n)
        if not isinstance(path, RandomPath):
            self._speed[:] = path.speed
            return
        families = (self._numbers[:, 0] * len(path.families)).astype(np.int64)
        for family in set(families.tolist()):
            members = (families == family).nonzero()[0]
            numbers = iter(self._numbers[members, 1:].T)
            paths = path.member(family, numbers.__next__)
            self.paths.append(DrawnPaths(members, paths))
            self._used[members], self._speed[members] = DRAWS - length_hint(numbers), paths.speed

    def episodes(self, members: Indices) -> Episode:
        """Return n of the episodes as one with rows (n,) as numbers, noise seed 0 and straight lines as paths."""
        first = self._used[members]
        most = DRAWS - int(first.max())
        rows = self._numbers[members[:, None], first[:, None] + np.arange(most)]
        episode = self._scenario.episode(Line.member(self._speed[members]), iter(rows.T.copy()).__next__, 0)
        return self._scenario.completed(episode, np.array(self.seeds, dtype=np.uint64)[members])

    def single(self, members: Indices) -> list[Path]:
        """Return the path of each of these episodes."""
        path = self._scenario.path
        if not isinstance(path, RandomPath):
            return [path] * len(members)
        by_episode: dict[int, Path] = {}
        for indices, paths in self.paths:
            by_episode.update(zip(indices.tolist(), unstack(paths, len(indices)), strict=True))
        return [by_episode[j] for j in members.tolist()]


def drawn_as_rows(scenario: Scenario) -> bool:
    """Return whether the episodes of a scenario can be drawn as rows.

    That requires paths that can be stacked, and no effect with inputs of its own.
    """
    names = scenario.path.families if isinstance(scenario.path, RandomPath) else ()
    alike = all(issubclass(PATHS[name], Family) for name in names)
    return alike and not any(effect.Inputs._fields for effect in scenario.parts.effects)
