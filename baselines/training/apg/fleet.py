"""When the vehicles that are trained on begin their episodes: between windows of control steps only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from auv_gym.envs.torch_sim import TorchSimulator
from auv_gym.scenario import Scenario
from auv_gym.task import SIZE
from baselines.training.apg.closed_loop import Carried


class Fleet:
    """N vehicles of a `TorchSimulator`; vehicle i runs the episodes of an environment of seed + i, one after the other.

    In a window nothing begins or ends, so the graph needs no masks; a vehicle that is lost drifts on to its end. The
    first episodes are cut short by different amounts, so that not all end at once.

    Attributes:
        simulator: where the vehicles are; its `constants` are what a control step needs besides a window.
        fresh: whether an episode began at the last renewal, shape (N,).
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
        n = len(scenarios)
        self.simulator = TorchSimulator(n, scenarios, dtype=dtype, compiled=False, preview=preview)
        self._seed, self._window = seed, window
        self._steps = np.array([s.steps for s in scenarios])
        self._lost = torch.tensor([s.lost_distance**2 for s in scenarios], dtype=dtype)
        windows = np.maximum(self._steps // window, 1)
        self._left = window * (1 + np.arange(n) % windows)  # control steps of the running episodes
        self.fresh = np.ones(n, dtype=bool)

    def reset(self, hidden: int) -> Carried:
        """Begin an episode everywhere; return what is carried into it, for a network of so many hidden units."""
        observation, _ = self.simulator.reset(seed=self._seed)
        nothing = Carried.zeros(len(self.fresh), hidden, observation.dtype)
        return nothing._replace(state=self.simulator.state, observation=_terms(observation))

    def window(self) -> tuple[Tensor, Tensor]:
        """Return what the next window brings, see `TorchSimulator.window`."""
        self._left -= self._window
        return self.simulator.window(self._window)

    def renew(self, carried: Carried, squared_error: Tensor) -> Carried:
        """Begin new episodes where they have ended, or would within the next window, or the vehicle is lost."""
        lost = ~(squared_error <= self._lost).numpy()
        self.fresh = lost | (self._left < self._window)
        self._left[self.fresh] = self._steps[self.fresh]
        observation = self.simulator.renew(carried.state, carried.observation, self.fresh)
        goes_on = torch.as_tensor(~self.fresh)
        return Carried(
            self.simulator.state,
            _terms(observation),
            torch.where(goes_on, carried.integrals, 0.0),
            torch.where(goes_on, carried.correction, 0.0),
            torch.where(goes_on[:, None], carried.hidden, 0.0),
        )


def _terms(observation: Tensor) -> Tensor:
    """Return observations (N, columns) without previews, (SIZE, N), laid out as a control step leaves them."""
    return observation[:, :SIZE].T.contiguous()
