"""The vehicles of a training; episodes begin only between windows of control steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.envs.sub_environments import ReadyEpisodes, SubEnvironments
from auv_gym.physics.namespaces import Array
from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.simulation import SAMPLE_ROWS, Parts
from baselines.agents.features import STANDARD
from baselines.agents.networks import OUTPUTS
from baselines.training.apg.closed_loop import known_rows
from baselines.training.apg.window import Carried

TRIALS = 4  # largest number of scenarios that are tried for an episode whose path cannot be planned


class TrainingVehicles:
    """A batch of N vehicles; vehicle i runs the episodes of an environment with seed + i, one after the other.

    A vehicle can have several scenarios with the same control period; its episodes cycle through them. No episode
    begins or ends within a window; a diverged vehicle continues until the end of the window. The first episodes have
    different lengths, so that not all episodes end at the same time.

    Args:
        scenarios: one for each vehicle.
        seed: of the episodes.
        window: number of control steps of a window.
        preview: control periods ahead, see `Preview`.
        variants: scenarios of each vehicle's episodes; empty: the one in `scenarios`.
        model: returns the nominal model of an episode for its vehicle; the plan and the vehicle itself do not change.

    Attributes:
        begins: whether an episode began at the last renewal, shape (N,).
        known: the nominal models of the vehicles, shape (`known_rows`, N), see `Vehicle.all_coefficients`.
    """

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        seed: int,
        window: int,
        preview: Sequence[int] = (),
        variants: Sequence[Sequence[Scenario]] = (),
        model: Callable[[Vehicle, np.random.Generator], Vehicle] | None = None,
    ) -> None:
        n = len(scenarios)
        self._variants = variants or [[scenario] for scenario in scenarios]
        self._begun = np.zeros(n, dtype=np.int64)  # number of episodes of each vehicle
        self._sub_envs = SubEnvironments(n, [own[0] for own in self._variants], None, None, preview)
        self._sub_envs.parts = reduce(Parts.joined, {s.parts: None for own in self._variants for s in own})
        self._seed, self._window = seed, window
        self._model, self._rng = model, np.random.default_rng([seed, n, 1])
        self.known: Array = np.empty((known_rows(self.parts), n))
        self._set_known(self._sub_envs.all)
        self._steps = np.array([s.steps for s in scenarios])
        self._failed = np.array([s.lost_distance**2 for s in scenarios])
        windows = np.maximum(self._steps // window, 1)
        self._left = window * (1 + np.arange(n) % windows)  # control steps of the running episodes
        self.begins = np.ones(n, dtype=bool)

    @property
    def parts(self) -> Parts:
        """The parts of the simulation that any vehicle uses."""
        return self._sub_envs.parts

    @property
    def constants(self) -> Array:
        """The rows of `simulation.Parameters` of the running episodes, shape (PARAMETER_ROWS, N)."""
        return self._sub_envs.constants

    def reset(self, hidden: int, memory: int = STANDARD.memory) -> Carried:
        """Begin an episode of every vehicle, and return the initial state.

        Args:
            hidden: number of rows of the network's memory.
            memory: number of rows of the features' memory.
        """
        n, beginning = len(self.begins), self._sub_envs.reset(self._seed, None)
        zeros = (np.zeros((rows, n)) for rows in (memory, OUTPUTS, hidden))
        return Carried(beginning.plant, beginning.seen, *zeros)

    def window(self) -> tuple[Array, Array]:
        """Return preview and samples of the T steps of the next window, and advance the time to its end.

        The preview has displacements x, y of the reference in the world [m], see `Preview.ahead`, shape (T, 2 P, N).
        The samples are those at the ends of the steps, shape (T, SAMPLE_ROWS, N).
        """
        self._left -= self._window
        sub_envs, n = self._sub_envs, len(self.begins)
        ahead, samples = (np.empty((self._window, rows, n)) for rows in (sub_envs.preview.columns, SAMPLE_ROWS))
        for k in range(self._window):
            if sub_envs.preview.periods:
                ahead[k] = sub_envs.preview.ahead(sub_envs.all, sub_envs.k).reshape(-1, n)
            samples[k] = sub_envs.next_sample()
            sub_envs.advance()
        return ahead, samples

    def renew(self, carried: Carried, squared_error: NDArray[Any]) -> Carried:
        """Begin new episodes of vehicles that are too far off, or whose episode ends within the next window."""
        self.begins = ~(squared_error <= self._failed) | (self._left < self._window)
        self._left[self.begins] = self._steps[self.begins]
        indices = self.begins.nonzero()[0]
        renewed = Carried(*(np.where(self.begins, 0.0, x) for x in carried))
        if len(indices):
            beginning = self._sub_envs.begin(indices, self._planned(indices))
            self._set_known(indices)
            renewed.state[:, indices], renewed.observation[:, indices] = beginning.plant, beginning.seen
        return renewed

    def _set_known(self, indices: NDArray[np.int64]) -> None:
        """Set the nominal models of new episodes."""
        for i in indices.tolist():
            vehicle = self._sub_envs.scenarios[i].vehicle
            nominal = self._model(vehicle, self._rng) if self._model else vehicle
            self.known[:, i] = (*nominal.coefficients, *nominal.cross_terms)[: len(self.known)]

    def _planned(self, indices: NDArray[np.int64]) -> list[ReadyEpisodes]:
        """Return the next episodes of some vehicles; if a path cannot be followed, their next scenarios are tried."""
        for left in reversed(range(TRIALS)):
            self._begun[indices] += 1
            for i in indices.tolist():
                self._sub_envs.scenarios[i] = self._variants[i][self._begun[i] % len(self._variants[i])]
            try:
                return self._sub_envs.next_episodes(indices)
            except ValueError:
                if not left or all(len(self._variants[i]) == 1 for i in indices.tolist()):
                    raise
        raise AssertionError("unreachable")
