"""Groups of vehicles, the gradient of a network's weights in their next windows, and where they are computed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import reduce
from operator import or_
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
from baselines.tools.workers import Elsewhere
from baselines.training.apg.closed_loop import ClosedLoop, law_of
from baselines.training.apg.kernels import LoopKernels
from baselines.training.apg.settings import PAIR, Settings
from baselines.training.apg.torch_network import put, torch_network
from baselines.training.apg.vehicles import TrainingVehicles
from baselines.training.apg.window import Objective, Window
from baselines.training.config import Config
from baselines.training.vehicle_models import variants_of, with_model_error


class Learned(NamedTuple):
    """What comes of a window."""

    loss: float  # the group's part of the mean over all vehicles
    error: float  # [m] the group's part of the mean position error
    gradients: dict[str, NDArray[Any]]  # of the loss, by the names of the weights


@dataclass(frozen=True)
class Members:
    """Which vehicles a group has."""

    scenarios: Sequence[Scenario]  # one for each
    variants: Sequence[Sequence[Scenario]]  # those that each goes through, see `variants_of`; none: the only one
    objective: Objective  # the shares are those in the mean over the vehicles of all groups
    seed: int  # of their episodes


def divided(config: Config, settings: Settings) -> list[Members]:
    """Return the vehicles of a training in its groups, which differ as little as can be in what they learn on."""
    lanes = config.lanes(settings.n_envs)
    draws = settings.draws_vehicles(config.vehicle)
    variants = variants_of(lanes, settings.hulls, config.episode_seed) if draws else []
    objective = settings.objective([scenario.name for scenario in lanes], [len(own) > 1 for own in variants])
    group, seed, found = np.arange(len(lanes)) // PAIR % settings.groups, config.episode_seed, list[Members]()
    for k in range(settings.groups):
        mine = (group == k).nonzero()[0]
        own = [variants[i] for i in mine] if variants else []
        found.append(Members([lanes[i] for i in mine], own, objective.of(mine), seed))
        seed += len(mine)
    return found


class VehicleGroup:
    """Vehicles that go from window to window, beginning new episodes between them.

    Args:
        config: of the training.
        settings: its hyper-parameters.
        members: the vehicles.
    """

    def __init__(self, config: Config, settings: Settings, members: Members) -> None:
        self._expert = config.make_expert()
        preview, self._seen, self._seen_by_expert = shared_preview(settings.preview, preview_of(self._expert))
        known = with_model_error if members.variants else None
        self.vehicles = TrainingVehicles(
            members.scenarios, members.seed, settings.n_steps, preview, members.variants, known
        )
        self.carried = self.vehicles.reset(settings.network.memory, settings.inputs.memory)
        self._memory: Memory | None = None  # of an expert on NumPy
        self._network = torch_network(settings.network)
        law, self._exact = law_of(self._expert)
        informed = self._expert if settings.hull and isinstance(self._expert, Backstepping) else None
        kernels = LoopKernels(ClosedLoop(law, settings.inputs, self.vehicles.parts, informed), self._exact)
        self._part = len(members.scenarios) / settings.n_envs
        sizes = len(members.scenarios), settings.n_steps
        self._window = Window(kernels, self._network, *sizes, config.authority, members.objective)

    def learn(self, weights: Mapping[str, NDArray[np.float32]]) -> Learned:
        """Run the next window with a network of these weights, and begin new episodes behind it."""
        put(weights, self._network)
        ahead, samples = self.vehicles.window()
        held_out, nothing = self.vehicles.held_out, np.zeros_like(self.vehicles.held_out)

        def act(k: int, observation: NDArray[Any]) -> NDArray[Any]:
            return self._act(observation, ahead[k], nothing if k else held_out)

        loss, error, carried, squared_error = self._window.run(
            self.carried,
            ahead[:, self._seen],
            samples,
            self.vehicles.constants,
            None if self._exact else act,
            known=self.vehicles.known,
        )
        self.carried = self.vehicles.renew(carried, squared_error)
        gradients = {name: p.grad.numpy() for name, p in self._network.named_parameters() if p.grad is not None}
        return Learned(loss, self._part * error, gradients)

    def _act(self, observation: NDArray[Any], ahead: NDArray[Any], held_out: NDArray[np.bool_]) -> NDArray[Any]:
        """Return the action of an expert on NumPy, shape (ACTIONS, N)."""
        rows = observation.T.astype(np.float64)
        if self._seen_by_expert:
            ways = ahead[self._seen_by_expert].reshape(-1, 2, len(rows))
            rows = np.hstack((rows, encode_preview(ways, decode_observation(rows), ARRAYS, self.vehicles.parts.span).T))
        action, self._memory = self._expert.predict(rows, self._memory, held_out)
        return action.T

    def state(self) -> dict[str, Any]:
        """Return what it takes to go on."""
        return {"vehicles": self.vehicles, "carried": self.carried, "memory": self._memory}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a state."""
        self.vehicles, self.carried, self._memory = state["vehicles"], state["carried"], state["memory"]


class Worker:
    """The groups of one process, each by its number."""

    def __init__(self, config: Config, settings: Settings, members: Mapping[int, Members]) -> None:
        self.groups = {k: VehicleGroup(config, settings, each) for k, each in members.items()}

    def learn(self, weights: Mapping[str, NDArray[np.float32]]) -> dict[int, Learned]:
        """Return what each group learns from its next window."""
        return {k: group.learn(weights) for k, group in self.groups.items()}

    def state(self) -> dict[int, dict[str, Any]]:
        """Return what it takes each group to go on."""
        return {k: group.state() for k, group in self.groups.items()}

    def restore(self, states: Mapping[int, Mapping[str, Any]]) -> None:
        """Go on from the states of these groups, and perhaps of others."""
        for k, group in self.groups.items():
            group.restore(states[k])


class Groups:
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
            self._others = [
                stack.enter_context(closing(Elsewhere(Worker, config, settings, its))) for its in rest if its
            ]
            self.own = Worker(config, settings, mine)
            self.close = stack.pop_all().close

    def learn(self, weights: Mapping[str, NDArray[np.float32]]) -> Learned:
        """Let all groups run their next window with a network of these weights, and return the sum over groups.

        Raises:
            WorkerError: a process was lost.
        """
        found: dict[int, Learned] = reduce(or_, self._everywhere("learn", weights))
        count_failures, errors, gradients = zip(*(found[k] for k in sorted(found)), strict=True)
        summed = {name: reduce(np.add, [each[name] for each in gradients]) for name in gradients[0]}
        return Learned(sum(count_failures), sum(errors), summed)

    def state(self) -> dict[int, dict[str, Any]]:
        """Return what it takes to go on."""
        found: dict[int, dict[str, Any]] = reduce(or_, self._everywhere("state"))
        return found

    def restore(self, states: Mapping[int, Mapping[str, Any]]) -> None:
        """Go on from a state."""
        self._everywhere("restore", states)

    def _everywhere(self, method: str, *arguments: Any) -> list[Any]:
        """Call a method in all processes at once and return what each of them does."""
        answers = [other.call(method, *arguments) for other in self._others]
        return [getattr(self.own, method)(*arguments), *(answer() for answer in answers)]
