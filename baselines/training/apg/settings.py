"""Hyper-parameters of the analytic gradient, and what follows from them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import nn

from auv_gym.physics.intervals import check_number
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.records import from_record
from baselines.agents.features import Inputs
from baselines.agents.networks import Gru, Mlp
from baselines.control.backstepping import Backstepping
from baselines.control.open_loop import NO_EXPERT
from baselines.evaluation.score import EXPERT, speed_range_of
from baselines.training.apg.closed_loop import Loss
from baselines.training.apg.window import Objective
from baselines.training.beginning import loaded
from baselines.training.config import Config, check_integer
from baselines.training.run_folder import VALIDATIONS

PAIR = 2  # vehicles in a row that are of one group: one of them has drawn models where half of all do
_SHARES = ("final_share", "warm_up", "average", "cruise_share", "hulls", "evenness")  # settings in [0, 1]
_WEIGHTS = ("cut", "hull_weight", "effort_weight", "rate_weight", "cruise_effort_weight", "cruise_rate_weight")
"""Settings of 0 or more; those of cruise may be None."""


@dataclass(frozen=True)
class Settings:
    """Hyper-parameters of the analytic gradient."""

    n_envs: int = 128  # vehicles side by side
    n_steps: int = 50  # control steps of a window
    groups: int = 1  # of the vehicles, which can be computed at a time
    learning_rate: float = 3e-3  # of biases and the last layer, by Adam
    matrix_learning_rate: float = 0.03  # of the other matrices, by Muon; 0: by Adam as well
    weight_decay: float = 0.02  # of those matrices: without it they grow until the vehicles move in chaos
    final_share: float = 0.03  # of both rates that is left at the end; they fall along a cosine
    max_grad_norm: float = 0.05  # less than most gradients have, so that every window weighs the same
    warm_up: float = 0.0  # share of the run in which both rates rise from nothing
    average: float = 0.02  # share of the run over which weights are averaged; it is their average that an agent gets
    hidden_size: int = 64  # of each layer of the network
    effort_weight: float = 0.006  # [1] of the squared command in `closed_loop.Loss`
    rate_weight: float = 0.006  # [s^2] of its squared rate of change in `closed_loop.Loss`
    cruise_effort_weight: float | None = None  # `effort_weight` in scenarios of the cruise regime, if it is another
    cruise_rate_weight: float | None = None  # `rate_weight` in scenarios of the cruise regime, if it is another
    cruise_share: float = 0.5  # what the loss of cruise counts for, where both regimes are trained on
    cut: float = 0.0  # medians over vehicles beyond which a vehicle's derivatives are shortened; 0: never
    evenness: float = 0.0  # 0: errors count as they are, 1: by ratios, see `window.evened`
    memory: bool = True  # whether the network has recurrent units, else it is of two tanh layers
    integrals: bool = True  # whether it sees the integrals of the position error
    fine: bool = False  # whether it sees the errors on finer scales too
    filters: bool = False  # whether it sees what Kalman filters believe
    preview: tuple[int, ...] = ()  # where it sees the reference ahead, in control periods
    hull: bool = False  # whether it sees the known vehicle
    hulls: float = 0.0  # share of the vehicles side by side whose models are drawn, see `vehicle_models`
    hull_weight: float = 1.0  # what the loss of such a vehicle counts for beside that of another one
    validations: int = VALIDATIONS  # how often in the run the agent is validated, and a checkpoint kept

    def __post_init__(self) -> None:
        for name, high in (("n_envs", 2**16), ("n_steps", 10**4), ("groups", 2**15), ("validations", 1000)):
            check_integer(name, getattr(self, name), 1, high)
        for name in ("learning_rate", "max_grad_norm"):
            check_number(name, getattr(self, name), 1e-9, 1e6)
        for name in (*_SHARES, "matrix_learning_rate", "weight_decay"):
            check_number(name, getattr(self, name), 0, 1)
        for name in _WEIGHTS:
            if getattr(self, name) is not None or not name.startswith("cruise"):
                check_number(name, getattr(self, name), 0, 1e6)
        if self.groups > (most := max(1, self.n_envs // PAIR)):
            raise ValueError(f"groups is {self.groups}; n_envs is {self.n_envs}, which is enough for {most}")
        if not isinstance(self.memory, bool):
            raise ValueError(f"memory is {self.memory!r}; it must be true or false")
        _ = self.network

    @property
    def inputs(self) -> Inputs:
        """What the network sees."""
        return Inputs(self.preview, self.integrals, self.fine, self.filters, self.hull)

    @property
    def network(self) -> Gru | Mlp:
        """The sizes of the network."""
        inputs, size = len(self.inputs.features), self.hidden_size
        return Gru(inputs, size, size, size) if self.memory else Mlp(inputs, (size, size), bound="tanh")

    def draws_vehicles(self, vehicle: Vehicle | None) -> bool:
        """Return whether models are drawn beside this vehicle; beside another than the paper's, it alone is learned."""
        return self.hulls > 0 and vehicle == PAPER_VEHICLE

    def objective(self, names: Sequence[str], drawn: Sequence[bool] = ()) -> Objective:
        """Return what is learned in scenarios of these names; `drawn` says whose model is drawn, () for none."""
        fast = np.array([speed_range_of(name) == "cruise" for name in names])
        cruise = (self.cruise_effort_weight, self.cruise_rate_weight)
        pairs = zip((self.effort_weight, self.rate_weight), cruise, strict=True)
        loss = Loss(*(np.where(fast, slow if own is None else own, slow) for slow, own in pairs))
        both = fast.any() and not fast.all()
        share = np.where(fast, self.cruise_share / max(1, fast.sum()), (1 - self.cruise_share) / max(1, (~fast).sum()))
        shares = np.where(drawn or False, self.hull_weight, 1.0) * (share if both else np.ones(len(fast)))
        return Objective(loss, shares / shares.sum(), self.cut, self.evenness)

    def windows(self, timesteps: int) -> int:
        """Return how many windows of all vehicles there are in so many control steps, summed over vehicles."""
        return math.ceil(timesteps / (self.n_envs * self.n_steps))

    def share_at(self, progress: float) -> float:
        """Return the share of the learning rates that is left after a share `progress` of the run."""
        risen = min(1.0, progress / self.warm_up) if self.warm_up else 1.0
        return risen * (self.final_share + (1 - self.final_share) * 0.5 * (1 + math.cos(math.pi * min(progress, 1.0))))

    def optimizers(self, network: nn.Module) -> tuple[torch.optim.Optimizer, ...]:
        """Return what follows a network's gradient.

        Muon gives every direction in which a matrix can change the same weight (Jordan et al. 2024, "Muon: an optimizer
        for hidden layers in neural networks"); through the simulator a few of them have nearly all of the gradient.
        """
        if self.matrix_learning_rate == 0:
            return (torch.optim.Adam(network.parameters(), lr=self.learning_rate),)
        *matrices, _ = (p for p in network.parameters() if p.ndim == 2)  # without the last layer's
        chosen = {id(p) for p in matrices}
        rest = [p for p in network.parameters() if id(p) not in chosen]
        muon = torch.optim.Muon(matrices, lr=self.matrix_learning_rate, weight_decay=self.weight_decay)
        return muon, torch.optim.Adam(rest, lr=self.learning_rate)


def check(config: Config) -> Settings:
    """Return the settings of a configuration.

    Raises:
        ValueError: a hyper-parameter is unknown or wrong.
    """
    settings = from_record(Settings, config.hyperparameters, "hyper-parameters of apg")
    config.lanes(settings.n_envs)
    if settings.hulls and not settings.hull:
        raise ValueError("vehicles are drawn, so the network must see them: set hull=true, or hulls=0")
    if settings.hulls and config.expert != NO_EXPERT and not isinstance(config.make_expert(), Backstepping):
        raise ValueError(f"vehicles are drawn, so the expert must be {NO_EXPERT} or a form of {EXPERT}")
    shortest = min(scenario.steps for scenario, _ in config.scenarios)
    if settings.n_steps > shortest:
        raise ValueError(f"n_steps is {settings.n_steps}; it must be at most {shortest}, the steps of an episode")
    if config.origin:
        agent = loaded(config.origin)
        known = replace(settings.inputs, hull=settings.hull and agent.inputs.hull)  # a network can see more than that
        sizes = replace(settings.network, inputs=agent.network.inputs)
        if known != agent.inputs or sizes != agent.network:
            raise ValueError(f"agent {config.origin.agent!r} has another network, or other inputs, than is asked for")
    return settings
