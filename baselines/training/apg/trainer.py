"""Analytic policy gradient: back-propagation through the simulator, truncated to windows of control steps.

The network corrects an expert. Its memory is carried from window to window without derivatives. The loss is the
tracking error itself; there is no value function, no exploration and no reward.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import closing
from typing import Any

import torch
from torch import nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from baselines.agents.agent import Agent
from baselines.agents.networks import Weights
from baselines.training.apg.groups import Groups
from baselines.training.apg.settings import check
from baselines.training.apg.torch_network import put, torch_network, weights_of
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
    """
    with closing(Groups(run.config, check(run.config), run.processes)) as groups:
        return ApgTrainer(run, groups).train()


class ApgTrainer:
    """Network, optimisers and vehicles of a run; it resumes from the run's checkpoint, if there is one."""

    def __init__(self, run: RunFolder, groups: Groups) -> None:
        self.run, self.groups, self.settings, config = run, groups, groups.settings, run.config
        run.keeps_last = self.settings.draws_vehicles(config.vehicle)  # the validation has the paper's vehicle only
        torch.manual_seed(config.seed)
        self.network, self.total = torch_network(self.settings.network), self.settings.windows(config.timesteps)
        if config.origin:
            put(loaded(config.origin).weights, self.network)
        kept = 1 - 1 / max(1.0, self.settings.average * self.total)
        average = get_ema_multi_avg_fn(kept)  # type: ignore[no-untyped-call]
        self.averaged = AveragedModel(self.network, multi_avg_fn=average)
        self.optimizers = self.settings.optimizers(self.network)
        self._rates = [group["lr"] for optimizer in self.optimizers for group in optimizer.param_groups]
        self._modules: dict[str, Any] = {"network": self.network, "averaged": self.averaged}
        self._modules |= {f"optimizer {i}": optimizer for i, optimizer in enumerate(self.optimizers)}
        self.updates = 0  # so far
        self.skipped = 0  # consecutive updates with a gradient that was not finite
        self._resume()

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
        """Train on one window; log, validate and save a checkpoint at their intervals."""
        learned = self.learn()
        self.updates += 1
        validates = self._due(self.settings.validations)
        if validates or self._due(LOGS):
            self.run.log(self.timesteps, **learned)
        if validates:
            self.validate()

    def validate(self) -> None:
        """Validate the agent, and save a checkpoint."""
        self.run.validate(self.agent(self.weights), self.timesteps)
        self.save()

    def agent(self, weights: Weights) -> Agent:
        """Return the agent of these weights."""
        config, inputs = self.run.config, self.settings.inputs
        return Agent(self.settings.network, weights, config.expert, config.authority, config.names, inputs=inputs)

    def save(self) -> None:
        """Save a checkpoint."""
        self.run.save_checkpoint(
            {
                "timesteps": self.timesteps,
                "updates": self.updates,
                "skipped": self.skipped,
                "modules": {name: part.state_dict() for name, part in self._modules.items()},
                "vehicles": self.groups.state(),
                "generator": torch.get_rng_state(),
            }
        )

    def _resume(self) -> None:
        """Restore the run's checkpoint, if there is one."""
        if (state := self.run.load_checkpoint()) is None:
            return
        with self.run.restoring():
            self.updates, self.skipped = state["updates"], state["skipped"]
            self.groups.restore(state["vehicles"])
            for name, part in self._modules.items():
                part.load_state_dict(state["modules"][name])
            torch.set_rng_state(state["generator"])

    def learn(self) -> Mapping[str, float]:
        """Take an optimiser step with the gradient of a window of all groups; return the values to log."""
        self._set_rates(self.updates / self.total)
        learned = self.groups.learn(weights_of(self.network))
        for name, p in self.network.named_parameters():
            p.grad = torch.from_numpy(learned.gradients[name])
        return {"loss": learned.loss, "window_error_m": learned.error, "gradient_norm": self._follow()}

    def _due(self, times: int) -> bool:
        """Return whether this update is one of `times` evenly spaced ones, of which the last is the end of the run."""
        return self.updates * times // self.total > (self.updates - 1) * times // self.total

    def _set_rates(self, progress: float) -> None:
        """Set the learning rates after a share `progress` of the run."""
        share = self.settings.share_at(progress)
        groups = [group for optimizer in self.optimizers for group in optimizer.param_groups]  # new ones after `resume`
        for group, rate in zip(groups, self._rates, strict=True):
            group["lr"] = rate * share

    def _follow(self) -> float:
        """Take an optimiser step if the network's gradient is finite, and return its norm.

        Raises:
            TrainingError: too many consecutive gradients were not finite.
        """
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
