"""When the vehicles that are trained on begin their episodes: between windows of control steps only."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.envs.lanes import Lanes, ReadyEpisodes
from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import Coefficients, Vehicle
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.simulation import SAMPLE_ROWS, Parts
from baselines.agents.features import STANDARD
from baselines.agents.networks import OUTPUTS
from baselines.training.apg.window import Carried

TURNS = 4  # of its scenarios that a vehicle tries at most until an episode can be planned


class TrainingVehicles:
    """A batch of N vehicles; vehicle i runs the episodes of an environment of seed + i, one after the other.

    Where a vehicle has several scenarios, of the same clock, each of its episodes is of the next one, round and round.

    In a window nothing begins or ends; a vehicle that is lost drifts on to its end. The first episodes are cut short by
    different amounts, so that not all end at once.

    Attributes:
        held_out: whether an episode began at the last renewal, shape (N,).
        known: the coefficients of the known models of the vehicles, shape (len(Coefficients._fields), N).
    """

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        seed: int,
        window: int,
        preview: Sequence[int] = (),
        turns: Sequence[Sequence[Scenario]] = (),
        known: Callable[[Vehicle, np.random.Generator], Vehicle] | None = None,
    ) -> None:
        """Make the vehicles; `window` control steps are run between beginnings.

        With `turns` each vehicle's episodes are of those scenarios in place of its only one. What `known` returns for
        an episode's known vehicle is known in its place; plans and the true vehicle stay what they are.
        """
        n = len(scenarios)
        self._turns = turns or [[scenario] for scenario in scenarios]
        self._begun = np.zeros(n, dtype=np.int64)  # episodes of each vehicle
        self._lanes = Lanes(n, [own[0] for own in self._turns], None, None, preview)
        self._lanes.parts = reduce(Parts.joined, {s.parts: None for own in self._turns for s in own})
        self._seed, self._window = seed, window
        self._model, self._rng = known, np.random.default_rng([seed, n, 1])
        self.known: Array = np.empty((len(Coefficients._fields), n))
        self._set_known(self._lanes.all)
        self._steps = np.array([s.steps for s in scenarios])
        self._failed = np.array([s.lost_distance**2 for s in scenarios])
        windows = np.maximum(self._steps // window, 1)
        self._left = window * (1 + np.arange(n) % windows)  # control steps of the running episodes
        self.held_out = np.ones(n, dtype=bool)

    @property
    def parts(self) -> Parts:
        """What is in use of the simulation."""
        return self._lanes.parts

    @property
    def constants(self) -> Array:
        """The rows of `simulation.Parameters` of the running episodes, shape (PARAMETER_ROWS, N)."""
        return self._lanes.constants

    def reset(self, hidden: int, memory: int = STANDARD.memory) -> Carried:
        """Begin an episode everywhere; return what is carried into it, for a network of so many hidden units.

        `memory` is how many rows its inputs remember.
        """
        n, beginning = len(self.held_out), self._lanes.reset(self._seed, None)
        nothing = (np.zeros((rows, n)) for rows in (memory, OUTPUTS, hidden))
        return Carried(beginning.plant, beginning.seen, *nothing)

    def window(self) -> tuple[Array, Array]:
        """Return what the next window brings, and let its time pass.

        For each of its T steps: where the reference will be, displacements x, y in the world [m] as `Preview.ahead` has
        them, shape (T, 2 P, N); and the sample at its end, shape (T, SAMPLE_ROWS, N).
        """
        self._left -= self._window
        lanes, n = self._lanes, len(self.held_out)
        ahead, samples = (np.empty((self._window, rows, n)) for rows in (lanes.preview.columns, SAMPLE_ROWS))
        for k in range(self._window):
            if lanes.preview.periods:
                ahead[k] = lanes.preview.ahead(lanes.all, lanes.k).reshape(-1, n)
            samples[k] = lanes.coming()
            lanes.advance()
        return ahead, samples

    def renew(self, carried: Carried, squared_error: NDArray[Any]) -> Carried:
        """Begin new episodes where they have ended, or would within the next window, or the vehicle is lost."""
        self.held_out = ~(squared_error <= self._failed) | (self._left < self._window)
        self._left[self.held_out] = self._steps[self.held_out]
        lanes = self.held_out.nonzero()[0]
        renewed = Carried(*(np.where(self.held_out, 0.0, x) for x in carried))
        if len(lanes):
            beginning = self._lanes.begin(lanes, self._planned(lanes))
            self._set_known(lanes)
            renewed.state[:, lanes], renewed.observation[:, lanes] = beginning.plant, beginning.seen
        return renewed

    def _set_known(self, lanes: NDArray[np.int64]) -> None:
        """Set the known models of episodes that begin."""
        for i in lanes.tolist():
            vehicle = self._lanes.scenarios[i].vehicle
            self.known[:, i] = (self._model(vehicle, self._rng) if self._model else vehicle).coefficients

    def _planned(self, lanes: NDArray[np.int64]) -> list[ReadyEpisodes]:
        """Return the next episodes of some vehicles; where no path can be followed each goes on to its next turn."""
        for left in reversed(range(TURNS)):
            self._begun[lanes] += 1
            for i in lanes.tolist():
                self._lanes.scenarios[i] = self._turns[i][self._begun[i] % len(self._turns[i])]
            try:
                return self._lanes.planned(lanes)
            except ValueError:
                if not left or all(len(self._turns[i]) == 1 for i in lanes.tolist()):
                    raise
        raise AssertionError("unreachable")
