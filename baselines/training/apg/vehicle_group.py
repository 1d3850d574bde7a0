"""A group of vehicles that run one window of control steps after the other, and the gradient of each window."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.effects.space import MAX_PITCH
from auv_gym.envs.sub_environments import ReadyEpisodes, SubEnvironments
from auv_gym.physics.namespaces import Array
from auv_gym.physics.space import SpaceVehicle
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.policy import preview_of
from auv_gym.task.preview import shared_preview, with_preview
from auv_gym.task.simulation import Parts
from baselines.control.backstepping import Backstepping
from baselines.policy import Memory
from baselines.training.apg.closed_loop import ClosedLoop, known_rows, law_of
from baselines.training.apg.kernels import LoopKernels
from baselines.training.apg.network import put, torch_network
from baselines.training.apg.settings import PAIR, Settings
from baselines.training.apg.window import Carried, Objective, TrainingWindow
from baselines.training.config import Config
from baselines.training.vehicle_models import variants_of, with_fixed_paths, with_model_error

TRIALS = 4  # largest number of scenarios that are tried for an episode whose path cannot be planned
_STATE = ("sub_envs", "carried", "begins", "known", "_episodes", "_left", "_memory", "_rng")
"""Attributes of a `VehicleGroup` that a window changes."""


class WindowGradient(NamedTuple):
    """Loss, error and gradients of one window."""

    loss: float  # share of the group in the mean over all vehicles
    error: float  # [m] share of the group in the mean position error
    gradients: dict[str, NDArray[Any]]  # of the loss, by the names of the weights


@dataclass(frozen=True)
class Members:
    """The vehicles of a group."""

    variants: Sequence[Sequence[Scenario]]  # scenarios of the episodes of each vehicle, see `variants_of`
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
        indices = (group == k).nonzero()[0]
        groups.append(Members([variants[i] for i in indices], objective.of(indices), seed, draws))
        seed += len(indices)
    return groups


class VehicleGroup:
    """A batch of N vehicles; vehicle i runs the episodes of an environment with seed + i, one after the other.

    The episodes of a vehicle cycle through its scenarios, which have the same control period. No episode begins or ends
    within a window; a diverged vehicle continues until the end of the window. The first episodes have different
    lengths, so that not all episodes end at the same time.

    Args:
        config: of the training.
        settings: its hyper-parameters.
        members: the vehicles.
        state: of `state()`; None: the first episodes begin.

    Attributes:
        sub_envs: the vehicles' episodes.
        carried: the state at the start of the next window.
        begins: whether an episode began at the last renewal, shape (N,).
        known: the nominal models of the vehicles, shape (`known_rows`, N), see `Vehicle.all_coefficients`. Plan and
            motion do not depend on them.
    """

    def __init__(
        self, config: Config, settings: Settings, members: Members, state: Mapping[str, Any] | None = None
    ) -> None:
        self._config, self._settings, self._members = config, settings, members
        self.expert = config.make_expert()
        self._first = [scenarios[0] for scenarios in members.variants]
        self._axes = settings.inputs.model.layout.axes
        preview, self._network_columns, self._expert_columns = shared_preview(
            settings.preview, preview_of(self.expert), self._axes
        )
        if state is None:
            self._begin(preview)
        else:
            vars(self).update(state)

    def _begin(self, preview: Sequence[int]) -> None:
        """Begin the first episode of every vehicle."""
        n, seed, window, inputs = len(self._first), self._members.seed, self._settings.n_steps, self._settings.inputs
        parts = {scenario.parts: None for scenarios in self._members.variants for scenario in scenarios}
        self.sub_envs = SubEnvironments(self._first, preview, parts=reduce(Parts.joined, parts))
        self._memory: Memory | None = None  # of an expert that is not in the kernels
        self._rng = np.random.default_rng([seed, n, 1])  # of the model errors
        self.known: Array = np.empty((known_rows(self.sub_envs.parts), n))
        self._set_known(self.sub_envs.all)
        self._episodes = np.zeros(n, dtype=np.int64)  # number of earlier episodes of each vehicle
        windows = np.maximum(np.array([scenario.steps for scenario in self._first]) // window, 1)
        self._left = window * (1 + np.arange(n) % windows)  # control steps of the running episodes
        self.begins = np.ones(n, dtype=bool)
        episodes = self.sub_envs.reset(seed, None)
        network = self._settings.network
        zeros = (np.zeros((rows, n)) for rows in (inputs.memory, network.outputs, network.memory))
        self.carried = Carried(episodes.plant, episodes.observation, *zeros)

    def state(self) -> dict[str, Any]:
        """Return the state for a checkpoint."""
        return {name: vars(self)[name] for name in _STATE}

    @cached_property
    def _window(self) -> TrainingWindow:
        law, exact = law_of(self.expert)
        informed = self.expert if self._members.misinformed and isinstance(self.expert, Backstepping) else None
        loop = ClosedLoop(law, self._settings.inputs, self.sub_envs.parts, informed)
        if isinstance(known := self._config.known, SpaceVehicle):
            loop = replace(loop, in_space=known)
        kernels = LoopKernels(loop, exact)
        network, steps = torch_network(self._settings.network), self._settings.n_steps
        return TrainingWindow(kernels, network, steps, self._config.authority, self._members.objective)

    def learn(self, weights: Mapping[str, NDArray[np.float32]]) -> WindowGradient:
        """Return the gradients of the next window with these weights, and begin new episodes after it."""
        window = self._window
        put(weights, window.network)
        ahead, samples = self.exogenous_inputs()

        def act(k: int, observation: NDArray[Any]) -> NDArray[Any]:
            return self.expert_action(observation, ahead[k], self.begins if k == 0 else np.zeros_like(self.begins))

        loss, error, carried, squared_error = window.run(
            self.carried, ahead[:, self._network_columns], samples, self.sub_envs.constants, act, self.known
        )
        self.renew(carried, squared_error)
        gradients = {name: p.grad.numpy() for name, p in window.network.named_parameters() if p.grad is not None}
        return WindowGradient(loss, len(self.begins) / self._settings.n_envs * error, gradients)

    def exogenous_inputs(self) -> tuple[Array, Array]:
        """Return preview and samples of the T steps of the next window, and advance the time to its end.

        The preview has displacements x, y of the reference in the world [m], see `Preview.ahead`, shape (T, 2 P, N).
        The samples are those at the ends of the steps, shape (T, `Parts.sample_rows`, N).
        """
        steps, sub_envs, n = self._settings.n_steps, self.sub_envs, len(self.begins)
        self._left -= steps
        ahead, samples = (np.empty((steps, rows, n)) for rows in (sub_envs.preview.columns, sub_envs.parts.sample_rows))
        for k in range(steps):
            if sub_envs.preview.periods:
                ahead[k] = sub_envs.preview.ahead(sub_envs.all, sub_envs.k).reshape(-1, n)
            samples[k] = sub_envs.next_sample()
            sub_envs.advance()
        return ahead, samples

    def expert_action(self, observation: NDArray[Any], ahead: NDArray[Any], begins: NDArray[np.bool_]) -> NDArray[Any]:
        """Return the action of an expert that is not in the kernels, shape (OUTPUTS, N), and update its memory.

        Args:
            observation: shape (SIZE, N).
            ahead: preview in the world [m], see `exogenous_inputs`.
            begins: whether an episode begins, shape (N,).
        """
        rows = observation.T.astype(np.float64)
        if self._expert_columns:
            steps, parts = ahead[self._expert_columns].reshape(-1, self._axes, len(rows)), self.sub_envs.parts
            rows = with_preview(rows.T, steps, parts.bound_factor, parts.model).T
        action, self._memory = self.expert.predict(rows, self._memory, begins)
        return action.T

    def renew(self, carried: Carried, squared_error: NDArray[Any]) -> None:
        """Begin new episodes of vehicles that are too far off, or whose episode ends within the next window.

        Args:
            carried: the state at the end of the window.
            squared_error: of the position [m^2] there, shape (N,).
        """
        failed = ~(squared_error <= np.array([scenario.lost_distance**2 for scenario in self._first]))
        names = self.sub_envs.parts.model.state
        if "theta" in names:
            failed |= ~(np.abs(carried.state[names.index("theta")]) < MAX_PITCH)
        self.begins = failed | (self._left < self._settings.n_steps)
        self.carried = Carried(*(np.where(self.begins, 0.0, x) for x in carried))
        indices = self.begins.nonzero()[0]
        self._left[indices] = [self._first[i].steps for i in indices]
        if len(indices):
            episodes = self.sub_envs.begin(indices, self._planned(indices))
            self._set_known(indices)
            self.carried.state[:, indices], self.carried.observation[:, indices] = episodes.plant, episodes.observation

    def _set_known(self, indices: NDArray[np.int64]) -> None:
        """Set the nominal models of new episodes."""
        for i in indices.tolist():
            vehicle = self.sub_envs.scenarios[i].vehicle
            nominal = with_model_error(vehicle, self._rng) if self._members.misinformed else vehicle
            self.known[:, i] = (*nominal.coefficients, *nominal.cross_terms)[: len(self.known)]

    def _planned(self, indices: NDArray[np.int64]) -> list[ReadyEpisodes]:
        """Return the next episodes of some vehicles; if a path cannot be followed, their next scenarios are tried."""
        variants = self._members.variants
        for left in reversed(range(TRIALS)):
            self._episodes[indices] += 1
            for i in indices.tolist():
                self.sub_envs.scenarios[i] = variants[i][self._episodes[i] % len(variants[i])]
            try:
                return self.sub_envs.next_episodes(indices)
            except ValueError:
                if not left or all(len(variants[i]) == 1 for i in indices.tolist()):
                    raise
        raise AssertionError("unreachable")
