"""Compute the gradients of training windows in groups of vehicles, in one or several processes."""

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
from baselines.tools.workers import ProcessObject
from baselines.training.apg.closed_loop import ClosedLoop, law_of
from baselines.training.apg.kernels import LoopKernels
from baselines.training.apg.settings import PAIR, Settings
from baselines.training.apg.torch_network import put, torch_network
from baselines.training.apg.vehicles import TrainingVehicles
from baselines.training.apg.window import Objective, Window
from baselines.training.config import Config
from baselines.training.vehicle_models import variants_of, with_fixed_paths, with_model_error


class WindowGradient(NamedTuple):
    """Loss, error and gradients of one window."""

    loss: float  # share of the group in the mean over all vehicles
    error: float  # [m] share of the group in the mean position error
    gradients: dict[str, NDArray[Any]]  # of the loss, by the names of the weights


@dataclass(frozen=True)
class Members:
    """The vehicles of a group."""

    scenarios: Sequence[Scenario]  # one for each
    variants: Sequence[Sequence[Scenario]]  # scenarios of the episodes of each, see `variants_of`
    objective: Objective  # with shares in the mean over the vehicles of all groups
    seed: int  # of their episodes
    misinformed: bool = False  # whether the nominal models have errors, see `with_model_error`


def divided(config: Config, settings: Settings) -> list[Members]:
    """Return the groups of a training, with the scenarios distributed as evenly as possible."""
    scenarios = config.env_scenarios(settings.n_envs)
    draws = settings.draws_vehicles(config.vehicle)
    seed = config.episode_seed
    variants = variants_of(scenarios, settings.drawn_share, seed) if draws else with_fixed_paths(scenarios, seed)
    objective = settings.objective([scenario.name for scenario in scenarios])
    group, groups = np.arange(len(scenarios)) // PAIR % settings.groups, list[Members]()
    for k in range(settings.groups):
        mine = (group == k).nonzero()[0]
        groups.append(
            Members([scenarios[i] for i in mine], [variants[i] for i in mine], objective.of(mine), seed, draws)
        )
        seed += len(mine)
    return groups


class VehicleGroup:
    """Vehicles that run one window after the other; new episodes begin between windows.

    Args:
        config: of the training.
        settings: its hyper-parameters.
        members: the vehicles.
    """

    def __init__(self, config: Config, settings: Settings, members: Members) -> None:
        self._expert = config.make_expert()
        preview, self._seen, self._seen_by_expert = shared_preview(settings.preview, preview_of(self._expert))
        known = with_model_error if members.misinformed else None
        self.vehicles = TrainingVehicles(
            members.scenarios, members.seed, settings.n_steps, preview, members.variants, known
        )
        self.carried = self.vehicles.reset(settings.network.memory, settings.inputs.memory)
        self._memory: Memory | None = None  # of an expert that is not in the kernels
        self._network = torch_network(settings.network)
        law, self._exact = law_of(self._expert)
        informed = self._expert if members.misinformed and isinstance(self._expert, Backstepping) else None
        kernels = LoopKernels(ClosedLoop(law, settings.inputs, self.vehicles.parts, informed), self._exact)
        self._part = len(members.scenarios) / settings.n_envs
        sizes = len(members.scenarios), settings.n_steps
        self._window = Window(kernels, self._network, *sizes, config.authority, members.objective)

    def learn(self, weights: Mapping[str, NDArray[np.float32]]) -> WindowGradient:
        """Return the gradients of the next window with these weights, and begin new episodes after it."""
        put(weights, self._network)
        ahead, samples = self.vehicles.window()
        begins, none = self.vehicles.begins, np.zeros_like(self.vehicles.begins)

        def act(k: int, observation: NDArray[Any]) -> NDArray[Any]:
            return self._act(observation, ahead[k], none if k else begins)

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
        return WindowGradient(loss, self._part * error, gradients)

    def _act(self, observation: NDArray[Any], ahead: NDArray[Any], begins: NDArray[np.bool_]) -> NDArray[Any]:
        """Return the action of an expert that is not in the kernels, shape (OUTPUTS, N)."""
        rows = observation.T.astype(np.float64)
        if self._seen_by_expert:
            steps = ahead[self._seen_by_expert].reshape(-1, 2, len(rows))
            columns = encode_preview(steps, decode_observation(rows), ARRAYS, self.vehicles.parts.span)
            rows = np.hstack((rows, columns.T))
        action, self._memory = self._expert.predict(rows, self._memory, begins)
        return action.T

    def state(self) -> dict[str, Any]:
        """Return the state for a checkpoint."""
        return {"vehicles": self.vehicles, "carried": self.carried, "memory": self._memory}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore a state."""
        self.vehicles, self.carried, self._memory = state["vehicles"], state["carried"], state["memory"]


class Worker:
    """The groups of one process, by their numbers."""

    def __init__(self, config: Config, settings: Settings, members: Mapping[int, Members]) -> None:
        self.groups = {k: VehicleGroup(config, settings, each) for k, each in members.items()}

    def learn(self, weights: Mapping[str, NDArray[np.float32]]) -> dict[int, WindowGradient]:
        """Return the gradients of each group's next window."""
        return {k: group.learn(weights) for k, group in self.groups.items()}

    def state(self) -> dict[int, dict[str, Any]]:
        """Return the state of each group."""
        return {k: group.state() for k, group in self.groups.items()}

    def restore(self, states: Mapping[int, Mapping[str, Any]]) -> None:
        """Restore the states of these groups; others in `states` are ignored."""
        for k, group in self.groups.items():
            group.restore(states[k])


class Groups:
    """All groups of a training, until `close`. The gradients do not depend on the number of processes.

    Args:
        config: of the training.
        settings: its hyper-parameters.
        processes: number of processes, including this one; there is at most one for each group.
    """

    def __init__(self, config: Config, settings: Settings, processes: int = 1) -> None:
        self.settings = settings
        members = dict(enumerate(divided(config, settings)))
        mine, *rest = ({k: m for k, m in members.items() if k % processes == j} for j in range(processes))
        with ExitStack() as stack:
            self._others = [
                stack.enter_context(closing(ProcessObject(Worker, config, settings, part))) for part in rest if part
            ]
            self.own = Worker(config, settings, mine)
            self.close = stack.pop_all().close

    def learn(self, weights: Mapping[str, NDArray[np.float32]]) -> WindowGradient:
        """Return the gradients of the next window of all groups with these weights, summed over groups.

        Raises:
            WorkerError: a worker process has died.
        """
        found: dict[int, WindowGradient] = reduce(or_, self._everywhere("learn", weights))
        losses, errors, gradients = zip(*(found[k] for k in sorted(found)), strict=True)
        summed = {name: reduce(np.add, [each[name] for each in gradients]) for name in gradients[0]}
        return WindowGradient(sum(losses), sum(errors), summed)

    def state(self) -> dict[int, dict[str, Any]]:
        """Return the states of all groups."""
        states: dict[int, dict[str, Any]] = reduce(or_, self._everywhere("state"))
        return states

    def restore(self, states: Mapping[int, Mapping[str, Any]]) -> None:
        """Restore the states of all groups."""
        self._everywhere("restore", states)

    def _everywhere(self, method: str, *arguments: Any) -> list[Any]:
        """Call a method in all processes at the same time, and return the result of each."""
        answers = [other.call(method, *arguments) for other in self._others]
        return [getattr(self.own, method)(*arguments), *(answer() for answer in answers)]
