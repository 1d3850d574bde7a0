"""Analytic policy gradient: back-propagation through the simulator, truncated to windows of control steps.

The network corrects an expert. Its memory is carried from window to window without derivatives. The loss is the
tracking error itself; there is no value function, no exploration and no reward.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing
from functools import reduce
from typing import Any

import numpy as np
import torch
from torch import nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from baselines.agents.agent import Agent
from baselines.agents.networks import Weights
from baselines.tools.workers import ProcessObjects
from baselines.training.apg.network import put, torch_network, weights_of
from baselines.training.apg.settings import check
from baselines.training.apg.vehicle_group import VehicleGroup, WindowGradient, divided
from baselines.training.initial_agent import loaded
from baselines.training.run_folder import RunFolder, TrainingError

LOGS = 200  # number of logged updates of a run
PATIENCE = 50  # largest number of consecutive updates that are skipped because of a gradient that is not finite


def train(run: RunFolder) -> Agent:
    """Train an agent; return that of the best validation, or that of the last one if vehicle models are drawn.

    Raises:
        OSError: the run's folder cannot be written to.
        TrainingError: too many consecutive gradients are not finite.
        ValueError: see `settings.check`.
        WorkerError: a worker process has died.
    """
    with closing(ApgTrainer(run)) as trainer:
        return trainer.train()


class ApgTrainer:
    """Network, optimisers and vehicles of a run; it resumes from the run's checkpoint, if there is one.

    The vehicles are in groups, which can be in several processes. The gradients do not depend on the number of
    processes. Call `close` at the end.
    """

    def __init__(self, run: RunFolder) -> None:
        self.run, self.settings, config = run, check(run.config), run.config
        run.keeps_last = self.settings.draws_vehicles(config.vehicle)  # the validation has the paper's vehicle only
        state = run.load_checkpoint()
        torch.manual_seed(config.seed)
        self.network, self.total = torch_network(self.settings.network), self.settings.windows(config.timesteps)
        if config.origin:
            put(loaded(config.origin).weights, self.network)
        decay = 1 - 1 / max(1.0, self.settings.average * self.total)
        average = get_ema_multi_avg_fn(decay)  # type: ignore[no-untyped-call]
        self.averaged = AveragedModel(self.network, multi_avg_fn=average)
        self.optimizers = self.settings.optimizers(self.network)
        self._rates = [group["lr"] for optimizer in self.optimizers for group in optimizer.param_groups]
        self._modules: dict[str, Any] = {"network": self.network, "averaged": self.averaged}
        self._modules |= {f"optimizer {i}": optimizer for i, optimizer in enumerate(self.optimizers)}
        self.updates = 0  # so far
        self.skipped = 0  # consecutive updates with a gradient that was not finite
        states = [None] * self.settings.groups
        if state is not None:
            with run.restoring():
                self.updates, self.skipped, states = state["updates"], state["skipped"], state["groups"]
                for name, part in self._modules.items():
                    part.load_state_dict(state["modules"][name])
        members = divided(config, self.settings)
        arguments = [(config, self.settings, *group) for group in zip(members, states, strict=True)]
        self.groups = ProcessObjects(VehicleGroup, arguments, run.processes)
        self.close = self.groups.close

    @property
    def weights(self) -> Weights:
        """The agent's weights: a moving average over the updates."""
        return weights_of(self.averaged.module)

    @property
    def timesteps(self) -> int:
        """Control steps so far, summed over vehicles."""
        return self.updates * self.settings.n_envs * self.settings.n_steps

    def train(self) -> Agent:
        """Train to the end of the run and return the selected agent."""
        if not self.updates:
            self.validate()
        while self.updates < self.total:
            self.update()
        return self.agent(self.run.weights)

    def update(self) -> None:
        """Train on one window of all groups; log, validate and save a checkpoint at their intervals.

        Raises:
            TrainingError: too many consecutive gradients were not finite.
            WorkerError: a worker process has died.
        """
        share = self.settings.share_at(self.updates / self.total)
        groups = [group for optimizer in self.optimizers for group in optimizer.param_groups]
        for group, rate in zip(groups, self._rates, strict=True):
            group["lr"] = rate * share
        window = summed(self.groups.call("learn", weights_of(self.network)))
        for name, p in self.network.named_parameters():
            p.grad = torch.from_numpy(window.gradients[name])
        norm = self._step()
        self.updates += 1
        validates = self._due(self.settings.validations)
        if validates or self._due(LOGS):
            self.run.log(self.timesteps, loss=window.loss, window_error_m=window.error, gradient_norm=norm)
        if validates:
            self.validate()

    def validate(self) -> None:
        """Validate the agent, and save a checkpoint."""
        self.run.validate(self.agent(self.weights), self.timesteps)
        self.run.save_checkpoint(
            {
                "timesteps": self.timesteps,
                "updates": self.updates,
                "skipped": self.skipped,
                "modules": {name: part.state_dict() for name, part in self._modules.items()},
                "groups": self.groups.call("state"),
            }
        )

    def agent(self, weights: Weights) -> Agent:
        """Return the agent of these weights."""
        c, network, inputs = self.run.config, self.settings.network, self.settings.inputs
        return Agent(network, weights, c.expert, c.authority, c.names, inputs=inputs, whole_model=c.whole_model)

    def _due(self, times: int) -> bool:
        """Return whether this update is one of `times` evenly spaced ones, of which the last is the end of the run."""
        return self.updates * times // self.total > (self.updates - 1) * times // self.total

    def _step(self) -> float:
        """Take an optimiser step if the network's gradient is finite, and return its norm."""
        norm = float(nn.utils.clip_grad_norm_(self.network.parameters(), self.settings.max_grad_norm))
        if math.isfinite(norm):
            for optimizer in self.optimizers:
                optimizer.step()
            self.averaged.update_parameters(self.network)
            self.skipped = 0
        elif self.skipped >= PATIENCE:
            raise TrainingError(f"{self.skipped} gradients in a row were not finite; lower learning_rate or n_steps")
        else:
            self.skipped += 1
        return norm


def summed(windows: Sequence[WindowGradient]) -> WindowGradient:
    """Return loss, error and gradients of all groups, of which each has its share."""
    losses, errors, gradients = zip(*windows, strict=True)
    names = gradients[0]
    return WindowGradient(
        sum(losses), sum(errors), {name: reduce(np.add, [group[name] for group in gradients]) for name in names}
    )
