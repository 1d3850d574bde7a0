"""Vehicles to train on, side by side: episodes begin and end between windows of control steps only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from auv_gym import simulation
from auv_gym.envs.lanes import Beginning, Lanes
from auv_gym.namespaces import ARRAYS
from auv_gym.scenario import Scenario
from auv_gym.simulation import Parameters
from auv_gym.task import encode
from baselines.training.apg.closed_loop import Carried


class Fleet:
    """N vehicles, a scenario each; vehicle i runs the episodes of an environment of seed + i, one after the other.

    In a window nothing begins or ends, so the graph needs no masks; a vehicle that is lost drifts on to its end. The
    first episodes are cut short by different amounts, so that not all end at once.
    """

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        seed: int,
        window: int,
        preview: Sequence[int] = (),
        dtype: torch.dtype = torch.float32,
    ) -> None:
        """Make the fleet; `window` control steps are run between beginnings."""
        self._lanes = Lanes(len(scenarios), scenarios, None, None, preview)
        self._seed, self._window, self._dtype = seed, window, dtype
        self._steps = np.array([s.steps for s in scenarios])
        self._lost = torch.tensor([s.lost_distance**2 for s in scenarios], dtype=dtype)
        self.parts = self._lanes.parts
        self.parameters = self._tensor(self._lanes.constants)
        self._ends = self._steps.copy()  # of the running episodes
        self.fresh = np.ones(len(scenarios), dtype=bool)  # whether an episode began at the last renewal

    def _tensor(self, array: NDArray[np.float64]) -> Tensor:
        return torch.tensor(array, dtype=self._dtype)

    def reset(self, hidden: int) -> Carried:
        """Begin an episode everywhere; return what is carried into it, for a network of so many hidden units."""
        n = len(self._steps)
        windows = np.maximum(self._steps // self._window, 1)
        self._ends = self._window * (1 + np.arange(n) % windows)
        return self._begun(self._lanes.reset(self._seed, None), Carried.zeros(n, hidden, self._dtype))

    def renew(self, carried: Carried, squared_error: Tensor) -> Carried:
        """Begin new episodes where they have ended, or would within the next window, or the vehicle is lost."""
        lost = ~(squared_error <= self._lost).numpy()
        self.fresh = over = lost | (self._lanes.k + self._window > self._ends)
        if not over.any():
            return carried
        (lanes,) = over.nonzero()
        self._ends[lanes] = self._steps[lanes]
        return self._begun(self._lanes.begin(lanes), carried)

    def _begun(self, beginning: Beginning, carried: Carried) -> Carried:
        lanes, host = beginning.lanes, self._lanes
        constants = host.constants[:, lanes]
        p = Parameters.of(tuple(constants), host.parts)
        plant, terms = simulation.start(tuple(beginning.states), host.sample[:, lanes], p, ARRAYS)
        where = torch.as_tensor(lanes)
        state, observation, integrals, correction, hidden = (x.clone() for x in carried)
        state[:, where] = self._tensor(np.array(simulation.rows_of(plant)))
        observation[:, where] = self._tensor(encode(terms, ARRAYS))
        integrals[:, where], correction[:, where], hidden[where] = 0.0, 0.0, 0.0
        self.parameters = self._tensor(host.constants)
        return Carried(state, observation, integrals, correction, hidden)

    def window(self) -> tuple[Tensor, Tensor]:
        """Return what the next window brings, and wind on.

        For each of its control steps: where the reference will be, displacements in the world [m] as
        `auv_gym.preview.Preview.ahead` has them, shape (window, 2 P, N); and the sample behind it, (window, SAMPLE, N).
        """
        lanes, ahead, samples = self._lanes, [], []
        for _ in range(self._window):
            if lanes.preview.periods:
                ahead.append(lanes.preview.ahead(lanes.all, lanes.k))
            lanes.advance()
            samples.append(lanes.sample.copy())
        shape = self._window, lanes.preview.columns, len(lanes.all)
        return self._tensor(np.reshape(ahead, shape)), self._tensor(np.array(samples))
