"""Callbacks for training a correction of an expert; rl_zoo3 can use them by name."""

from __future__ import annotations

import math
from typing import Any

import torch
from stable_baselines3.common.callbacks import BaseCallback
from torch import nn


class ZeroCorrection(BaseCallback):
    """Sets the untrained actor's correction to zero, so that training starts with the performance of the expert.

    Args:
        std: initial standard deviation of the corrections before they are bounded, or with `use_sde` of each unit's
            contribution; None does not change it. TD3's actor has none; its noise is added separately.
    """

    def __init__(self, std: float | None = None) -> None:
        super().__init__()
        self.std = std

    def _on_training_start(self) -> None:
        if self.num_timesteps > 0:  # resumed
            return
        policy: Any = self.model.policy
        with torch.no_grad():
            for actor in (policy, getattr(policy, "actor", None), getattr(policy, "actor_target", None)):
                for layer in last_layers(actor):
                    layer.weight.zero_()
                    layer.bias.zero_()
                if self.std is not None:
                    self._spread(actor, math.log(self.std))

    def _spread(self, actor: Any, log_std: float) -> None:
        spread = getattr(actor, "log_std", None)
        if isinstance(spread, nn.Parameter):  # PPO: a number for each action; with use_sde, for each unit too
            spread.fill_(log_std)
        elif isinstance(spread, nn.Linear):  # SAC and TQC: a function of the input
            spread.weight.zero_()
            spread.bias.fill_(log_std)

    def _on_step(self) -> bool:
        return True


def last_layers(actor: Any) -> list[nn.Linear]:
    """Return a list with the layer whose output is the actor's mean action; empty if there is no such layer."""
    if isinstance(getattr(actor, "action_net", None), nn.Linear):  # PPO's policy
        return [actor.action_net]
    mean = getattr(actor, "mu", None)  # a layer in SAC's and TQC's actor, the whole network in TD3's
    if isinstance(mean, nn.Linear):
        return [mean]
    return [layer for layer in mean if isinstance(layer, nn.Linear)][-1:] if isinstance(mean, nn.Sequential) else []


class FrozenActor(BaseCallback):
    """Freezes the actor of SAC, TQC or TD3 until the critic has learned the values of the expert's actions.

    Args:
        steps: control steps, summed over vehicles, for which it is frozen.
    """

    def __init__(self, steps: int) -> None:
        super().__init__()
        self.steps = steps

    def _on_rollout_start(self) -> None:
        policy: Any = self.model.policy
        policy.actor.requires_grad_(self.num_timesteps >= self.steps)

    def _on_step(self) -> bool:
        return True
