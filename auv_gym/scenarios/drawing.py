"""Episodes of one scenario drawn side by side, as rows: from the numbers, and in their order, that one alone takes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, cast

import numpy as np

from auv_gym.physics.namespaces import Array, Indices
from auv_gym.planning.paths import PATHS, Family, Path, unstack
from auv_gym.scenarios.episode import Episode
from auv_gym.scenarios.scenario import DRAWS, RandomPath, Scenario


class DrawnPaths(NamedTuple):
    """Paths of one family."""

    members: Indices  # of which of the episodes, shape (n,)
    paths: Path  # made one, see `stack`


class Drawing:
    """N episodes of a scenario whose numbers are drawn, their paths first.

    Attributes:
        seeds: of the episodes' noise.
        paths: by family; none if the scenario's path is not drawn.
    """

    def __init__(self, scenario: Scenario, generators: Sequence[np.random.Generator]) -> None:
        """Draw from each of N generators what `Scenario.draw` takes."""
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
            stream = _Stream(self._numbers[members, 1:].T)
            paths = path.member(family, stream)
            self.paths.append(DrawnPaths(members, paths))
            self._used[members], self._speed[members] = 1 + stream.used, paths.speed

    def episodes(self, members: Indices) -> Episode:
        """Return some of the episodes as one whose numbers are rows (n,); its path has a speed alone, and no noise."""
        first = self._used[members]
        most = DRAWS - int(first.max())
        rows = self._numbers[members[:, None], first[:, None] + np.arange(most)]
        path = cast(Path, _Speed(self._speed[members]))
        return self._scenario.episode(path, _Stream(rows.T.copy()), 0)

    def single(self, members: Indices) -> list[Path]:
        """Return the paths of some of the episodes, one by one."""
        path = self._scenario.path
        if not isinstance(path, RandomPath):
            return [path] * len(members)
        found: dict[int, Path] = {}
        for own, paths in self.paths:
            found.update(zip(own.tolist(), unstack(paths, len(own)), strict=True))
        return [found[j] for j in members.tolist()]


class _Stream:
    """Uniform numbers, a row for each call."""

    def __init__(self, rows: Array) -> None:
        self._rows, self.used = rows, 0

    def __call__(self) -> Array:
        self.used += 1
        row: Array = self._rows[self.used - 1]
        return row


class _Speed(NamedTuple):
    """What the other parts of a scenario need of paths."""

    speed: Array


def drawn_side_by_side(scenario: Scenario) -> bool:
    """Return whether a scenario's episodes are made of `Scenario.episode` alone, on paths that can be one."""
    names = scenario.path.families if isinstance(scenario.path, RandomPath) else ()
    alike = all(issubclass(PATHS[name], Family) for name in names)
    return alike and not scenario.sensors.outages and scenario.sensors.reckoning is None
