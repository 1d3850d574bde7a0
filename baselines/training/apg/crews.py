"""Where the groups of a training compute: in this process and, if it may have more, in others beside it."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack, closing
from functools import reduce
from operator import or_
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.tools.workers import Elsewhere
from baselines.training.apg.group import Group, Learned, Members, divided
from baselines.training.apg.settings import Settings
from baselines.training.config import Config


class Crew:
    """The groups of one process, each by its number."""

    def __init__(self, config: Config, settings: Settings, members: Mapping[int, Members]) -> None:
        self.groups = {k: Group(config, settings, each) for k, each in members.items()}

    def learn(self, weights: Mapping[str, NDArray[np.float32]]) -> dict[int, Learned]:
        """Return what comes of the groups' next windows."""
        return {k: group.learn(weights) for k, group in self.groups.items()}

    def state(self) -> dict[int, dict[str, Any]]:
        """Return what it takes the groups to go on."""
        return {k: group.state() for k, group in self.groups.items()}

    def restore(self, states: Mapping[int, Mapping[str, Any]]) -> None:
        """Go on from the states of these groups, and perhaps of others."""
        for k, group in self.groups.items():
            group.restore(states[k])


class Crews:
    """All groups of a training, until `close`. What they learn does not depend on how many processes compute it.

    Args:
        config: of the training.
        settings: its hyper-parameters.
        processes: that it may have, this one included; more than there are groups are not made.
    """

    def __init__(self, config: Config, settings: Settings, processes: int = 1) -> None:
        self.settings = settings
        members = dict(enumerate(divided(config, settings)))
        mine, *rest = ({k: m for k, m in members.items() if k % processes == j} for j in range(processes))
        with ExitStack() as stack:
            self._others = [stack.enter_context(closing(Elsewhere(Crew, config, settings, its))) for its in rest if its]
            self.own = Crew(config, settings, mine)
            self.close = stack.pop_all().close

    def learn(self, weights: Mapping[str, NDArray[np.float32]]) -> Learned:
        """Let all groups run their next window with a network of these weights, and return what comes of all of them.

        Raises:
            WorkerError: a process was lost.
        """
        found: dict[int, Learned] = reduce(or_, self._everywhere("learn", weights))
        losses, errors, gradients = zip(*(found[k] for k in sorted(found)), strict=True)
        summed = {name: reduce(np.add, [each[name] for each in gradients]) for name in gradients[0]}
        return Learned(sum(losses), sum(errors), summed)

    def state(self) -> dict[int, dict[str, Any]]:
        """Return what it takes to go on."""
        found: dict[int, dict[str, Any]] = reduce(or_, self._everywhere("state"))
        return found

    def restore(self, states: Mapping[int, Mapping[str, Any]]) -> None:
        """Go on from a state."""
        self._everywhere("restore", states)

    def _everywhere(self, method: str, *arguments: Any) -> list[Any]:
        """Call a method of all crews at once and return what each of them does."""
        answers = [other.call(method, *arguments) for other in self._others]
        return [getattr(self.own, method)(*arguments), *(answer() for answer in answers)]
