"""Vehicles side by side, and the gradient of a network's weights in the next window of theirs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import ARRAYS
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.observation import decode_observation
from auv_gym.task.policy import preview_of
from auv_gym.task.preview import encode_preview, shared_preview
from baselines.control.backstepping import Backstepping
from baselines.policy import Memory
from baselines.training.apg.closed_loop import ClosedLoop, law_of
from baselines.training.apg.fleet import Fleet
from baselines.training.apg.kernels import LoopKernels
from baselines.training.apg.settings import PAIR, Settings
from baselines.training.apg.torch_network import put, torch_network
from baselines.training.apg.window import Objective, Window
from baselines.training.config import Config
from baselines.training.hulls import believed, turns


class Learned(NamedTuple):
    """What comes of a window."""

    loss: float  # the group's part of the mean over all vehicles
    error: float  # [m] the group's part of the mean position error
    gradients: dict[str, NDArray[Any]]  # of the loss, by the names of the weights


@dataclass(frozen=True)
class Members:
    """Which vehicles a group has."""

    scenarios: Sequence[Scenario]  # one for each
    hulls: Sequence[Sequence[Scenario]]  # those that each goes through, see `hulls.turns`; none: the only one
    objective: Objective  # the shares are those in the mean over the vehicles of all groups
    seed: int  # of their episodes


def divided(config: Config, settings: Settings) -> list[Members]:
    """Return the vehicles of a training in its groups, which differ as little as can be in what they learn on."""
    lanes = config.lanes(settings.n_envs)
    hulls = turns(lanes, settings.hulls, config.episode_seed) if settings.draws_hulls(config.vehicle) else []
    objective = settings.objective([scenario.name for scenario in lanes], [len(own) > 1 for own in hulls])
    group, seed, found = np.arange(len(lanes)) // PAIR % settings.groups, config.episode_seed, list[Members]()
    for k in range(settings.groups):
        mine = (group == k).nonzero()[0]
        own = [hulls[i] for i in mine] if hulls else []
        found.append(Members([lanes[i] for i in mine], own, objective.of(mine), seed))
        seed += len(mine)
    return found


class Group:
    """Vehicles that go from window to window, beginning new episodes between them.

    Args:
        config: of the training.
        settings: its hyper-parameters.
        members: the vehicles.
    """

    def __init__(self, config: Config, settings: Settings, members: Members) -> None:
        self._expert = config.make_expert()
        preview, self._seen, self._seen_by_expert = shared_preview(settings.preview, preview_of(self._expert))
        told = believed if members.hulls else None
        self.fleet = Fleet(members.scenarios, members.seed, settings.n_steps, preview, members.hulls, told)
        self.carried = self.fleet.reset(settings.network.memory, settings.inputs.memory)
        self._memory: Memory | None = None  # of an expert on NumPy
        self._network = torch_network(settings.network)
        law, self._exact = law_of(self._expert)
        believer = self._expert if settings.hull and isinstance(self._expert, Backstepping) else None
        kernels = LoopKernels(ClosedLoop(law, settings.inputs, self.fleet.parts, believer), self._exact)
        self._part = len(members.scenarios) / settings.n_envs
        sizes = len(members.scenarios), settings.n_steps
        self._window = Window(kernels, self._network, *sizes, config.authority, members.objective)

    def learn(self, weights: Mapping[str, NDArray[np.float32]]) -> Learned:
        """Run the next window with a network of these weights, and begin new episodes behind it."""
        put(weights, self._network)
        ahead, samples = self.fleet.window()
        fresh, nothing = self.fleet.fresh, np.zeros_like(self.fleet.fresh)

        def act(k: int, observation: NDArray[Any]) -> NDArray[Any]:
            return self._act(observation, ahead[k], nothing if k else fresh)

        loss, error, carried, squared_error = self._window.run(
            self.carried,
            ahead[:, self._seen],
            samples,
            self.fleet.constants,
            None if self._exact else act,
            known=self.fleet.known,
        )
        self.carried = self.fleet.renew(carried, squared_error)
        gradients = {name: p.grad.numpy() for name, p in self._network.named_parameters() if p.grad is not None}
        return Learned(loss, self._part * error, gradients)

    def _act(self, observation: NDArray[Any], ahead: NDArray[Any], fresh: NDArray[np.bool_]) -> NDArray[Any]:
        """Return the action of an expert on NumPy, shape (ACTIONS, N)."""
        rows = observation.T.astype(np.float64)
        if self._seen_by_expert:
            ways = ahead[self._seen_by_expert].reshape(-1, 2, len(rows))
            rows = np.hstack((rows, encode_preview(ways, decode_observation(rows), ARRAYS, self.fleet.parts.span).T))
        action, self._memory = self._expert.predict(rows, self._memory, fresh)
        return action.T

    def state(self) -> dict[str, Any]:
        """Return what it takes to go on."""
        return {"fleet": self.fleet, "carried": self.carried, "memory": self._memory}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a state."""
        self.fleet, self.carried, self._memory = state["fleet"], state["carried"], state["memory"]
