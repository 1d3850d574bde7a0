"""Analytic policy gradient: back-propagation through the simulator, a window of control steps at a time.

The network corrects an expert. What it remembers is carried from window to window without the graph behind it, and the
loss is the tracking error itself: no value function, no exploration, no reward.
"""

from __future__ import annotations

import math
from contextlib import closing
from typing import Any

import torch
from torch import nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from baselines.agents.agent import Agent
from baselines.training.apg.crews import Crews
from baselines.training.apg.settings import check
from baselines.training.apg.torch_network import put, torch_network, weights_of
from baselines.training.beginning import loaded
from baselines.training.run_folder import Run, TrainingError
from baselines.training.validation import PRECISION

LOGS = 200  # how often in a run its progress is logged


def train(run: Run) -> Agent:
    """Train an agent and return the one that is kept: of the best validation, or where hulls are drawn of the last one.

    Raises:
        OSError: the run's folder cannot be written to.
        TrainingError: the gradient is not finite any more.
        ValueError: see `check`.
    """
    with closing(Crews(run.config, check(run.config), run.processes)) as crews:
        trainer = Trainer(run, crews)
        if not trainer.updates:
            trainer.validate()
        while trainer.updates < trainer.total:
            trainer.update()
        return trainer.agent(trainer.best)


class Descent:
    """What trainers share that follow the gradient of a window: its steps, and when something is due in the run."""

    PATIENCE = 50
    """Updates in a row that may be skipped for a gradient that is not finite."""
    updates: int  # so far
    total: int  # updates of the whole run
    skipped: int  # updates in a row whose gradient was not finite
    optimizers: tuple[torch.optim.Optimizer, ...]
    averaged: AveragedModel

    @property
    def _groups(self) -> list[dict[str, Any]]:
        return [group for optimizer in self.optimizers for group in optimizer.param_groups]

    def _due(self, times: int) -> bool:
        """Return whether one of so many moments, spread evenly over the run, has come; the last one is its end."""
        return self.updates * times // self.total > (self.updates - 1) * times // self.total

    def _follow(self, network: nn.Module, max_grad_norm: float) -> float:
        """Take a step along a network's gradient, if it is finite, and return its norm.

        Raises:
            TrainingError: too many in a row were not finite.
        """
        norm = float(nn.utils.clip_grad_norm_(network.parameters(), max_grad_norm))
        if math.isfinite(norm):
            for optimizer in self.optimizers:
                optimizer.step()
            self.averaged.update_parameters(network)
            self.skipped = 0
        elif self.skipped >= self.PATIENCE:
            raise TrainingError(f"{self.skipped} gradients in a row were not finite; lower learning_rate or n_steps")
        else:
            self.skipped += 1
        return norm


class Trainer(Descent):
    """Network, optimiser and vehicles of a run; goes on from the run's checkpoint, if there is one."""

    def __init__(self, run: Run, crews: Crews) -> None:
        """Begin a run with these vehicles, or take it up."""
        self.run, self.crews, self.settings = run, crews, crews.settings
        config, settings = run.config, self.settings
        run.keeps_last = settings.draws_hulls(config.vehicle)  # of validations, which are of that vehicle alone
        self.total = max(1, math.ceil(config.timesteps / (settings.n_envs * settings.n_steps)))
        torch.manual_seed(config.seed)
        self.network = torch_network(settings.network)
        if config.origin:
            put(loaded(config.origin).weights, self.network)
        kept = 1 - 1 / max(1.0, settings.average * self.total)
        self.averaged = AveragedModel(self.network, multi_avg_fn=get_ema_multi_avg_fn(kept))  # type: ignore[no-untyped-call]
        self.optimizers = settings.optimizers(self.network)
        self._rates = [group["lr"] for group in self._groups]
        self.updates, self.skipped = 0, 0
        self.best = weights_of(self.averaged.module)
        if (state := run.load_checkpoint()) is not None:
            with run.restoring():
                self._restore(state)

    @property
    def timesteps(self) -> int:
        """Control steps so far, summed over vehicles."""
        return self.updates * self.settings.n_envs * self.settings.n_steps

    def update(self) -> None:
        """Run one window, follow its gradient, and log, validate and save where it is time to."""
        share = self.settings.share_at(self.updates / self.total)
        for group, rate in zip(self._groups, self._rates, strict=True):
            group["lr"] = rate * share
        learned = self.crews.learn(weights_of(self.network))
        for name, p in self.network.named_parameters():
            p.grad = torch.from_numpy(learned.gradients[name])
        norm = self._follow(self.network, self.settings.max_grad_norm)
        self.updates += 1
        if self._due(LOGS):
            self.run.log(self.timesteps, loss=learned.loss, window_error_m=learned.error, gradient_norm=norm)
        if self._due(self.settings.validations):
            self.validate()

    def validate(self) -> None:
        """Measure the agent on the validation episodes, keep the best or the last one, and save a checkpoint."""
        weights = weights_of(self.averaged.module)
        policy = self.agent(weights).policy(vehicle=self.run.config.vehicle, precision=PRECISION)
        if self.run.validate(policy, self.timesteps):
            self.best = weights
        self.run.save_checkpoint(self._state())

    def agent(self, weights: Any) -> Agent:
        """Return the agent of these weights."""
        config, settings = self.run.config, self.settings
        return Agent(settings.network, weights, config.expert, config.authority, config.names, inputs=settings.inputs)

    def _state(self) -> dict[str, Any]:
        return {
            "timesteps": self.timesteps,
            "updates": self.updates,
            "skipped": self.skipped,
            "best": self.best,
            "network": self.network.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimizers": [optimizer.state_dict() for optimizer in self.optimizers],
            "crews": self.crews.state(),
        }

    def _restore(self, state: dict[str, Any]) -> None:
        self.updates, self.skipped, self.best = state["updates"], state["skipped"], state["best"]
        self.network.load_state_dict(state["network"])
        self.averaged.load_state_dict(state["averaged"])
        for optimizer, its in zip(self.optimizers, state["optimizers"], strict=True):
            optimizer.load_state_dict(its)
        self.crews.restore(state["crews"])
