"""Hyper-parameters of the analytic policy gradient: objective, learning rates, optimisers, network."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import nn

from auv_gym.physics.intervals import check_number
from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.records import from_record
from baselines.agents.features import Inputs
from baselines.agents.networks import Gru, Mlp
from baselines.agents.space_features import SpaceInputs
from baselines.control.backstepping import Backstepping
from baselines.control.open_loop import NO_EXPERT
from baselines.evaluation.score import EXPERT, speed_range_of
from baselines.training.apg.closed_loop import Loss
from baselines.training.apg.muon import Muon
from baselines.training.apg.window import Objective
from baselines.training.config import Config, check_integer
from baselines.training.initial_agent import loaded
from baselines.training.run_folder import VALIDATIONS

PAIR = 2  # consecutive vehicles of the same group, so that groups have equal shares of drawn models
_SHARES = (
    "final_share",
    "warm_up",
    "restart",
    "average",
    "cruise_share",
    "drawn_share",
    "error_exponent",
)  # settings in [0, 1]
_WARM_UP = 0.1  # share of the time after a restart in which the rates rise
_WEIGHTS = ("derivative_bound", "effort_weight", "rate_weight", "cruise_effort_weight", "cruise_rate_weight")
"""Settings of 0 or more; those of cruise may be None."""


@dataclass(frozen=True)
class Settings:
    """Hyper-parameters of the analytic policy gradient."""

    n_envs: int = 128  # number of sub-environments
    n_steps: int = 50  # control steps of a window
    groups: int = 1  # number of groups of sub-environments, which can be computed in parallel
    learning_rate: float = 3e-3  # of biases and the last layer, by Adam
    matrix_learning_rate: float = 0.03  # of the other matrices, by Muon; 0: by Adam as well
    weight_decay: float = 0.02  # of these matrices; without it they grow until the closed loop is chaotic
    final_share: float = 0.03  # final over initial learning rates; they decrease along a cosine
    max_grad_norm: float = 0.05  # smaller than most norms, so that all windows have about the same weight
    warm_up: float = 0.0  # share of the run in which both rates rise from zero
    restart: float = 0.0  # share of the run after which they begin again at half of their initial values; 0: never
    average: float = 0.02  # share of the run over which weights are averaged; the agent has the averaged weights
    hidden_size: int = 64  # of each layer of the network
    effort_weight: float = 0.006  # [1] of the squared command in `closed_loop.Loss`
    rate_weight: float = 0.006  # [s^2] of its squared rate of change in `closed_loop.Loss`
    cruise_effort_weight: float | None = None  # `effort_weight` in cruise scenarios; None: the same
    cruise_rate_weight: float | None = None  # `rate_weight` in cruise scenarios; None: the same
    cruise_share: float = 0.5  # weight of the cruise scenarios in the loss, if there are both speed ranges
    derivative_bound: float = 0.0  # bound of a vehicle's derivatives, in medians over vehicles; 0: no bound
    error_exponent: float = 0.0  # 0: mean of errors, 1: mean of their logarithms, see `window.divided_by_error`
    memory: bool = True  # whether the network has recurrent units; otherwise it has two tanh layers
    integrals: bool = True  # include the integrals of the position error in the inputs of the network
    fine: bool = False  # include the errors on finer scales
    filters: bool = False  # include the estimates of Kalman filters
    preview: tuple[int, ...] = ()  # include the reference this many control periods ahead
    nominal_vehicle: bool = False  # include the nominal vehicle
    drawn_share: float = 0.0  # share of the sub-environments with drawn vehicle models, see `vehicle_models`
    validations: int = VALIDATIONS  # number of validations of a run, each with a checkpoint
    space: bool = field(default=False, compare=False)  # whether the scenarios are in space; not in records

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
            raise ValueError(f"groups is {self.groups}; with n_envs {self.n_envs} it must be at most {most}")
        if not isinstance(self.memory, bool):
            raise ValueError(f"memory is {self.memory!r}; it must be true or false")
        _ = self.network

    @property
    def inputs(self) -> Inputs | SpaceInputs:
        """The inputs of the network."""
        if self.space:
            return SpaceInputs(self.preview, self.fine, self.filters)
        return Inputs(self.preview, self.integrals, self.fine, self.filters, self.nominal_vehicle)

    @property
    def network(self) -> Gru | Mlp:
        """The sizes of the network."""
        inputs, size, outputs = len(self.inputs.features), self.hidden_size, len(self.inputs.model.channels)
        if self.memory:
            return Gru(inputs, size, size, size, outputs=outputs)
        return Mlp(inputs, (size, size), bound="tanh", outputs=outputs)

    def draws_vehicles(self, vehicle: Vehicle | None) -> bool:
        """Return whether vehicle models are drawn; they are drawn only in a training for the paper's vehicle."""
        return self.drawn_share > 0 and vehicle == PAPER_VEHICLE

    def objective(self, names: Sequence[str]) -> Objective:
        """Return the objective for scenarios of these names."""
        fast = np.array([speed_range_of(name) == "cruise" for name in names])
        cruise = (self.cruise_effort_weight, self.cruise_rate_weight)
        pairs = zip((self.effort_weight, self.rate_weight), cruise, strict=True)
        loss = Loss(*(np.where(fast, slow if at_cruise is None else at_cruise, slow) for slow, at_cruise in pairs))
        both = fast.any() and not fast.all()
        share = np.where(fast, self.cruise_share / max(1, fast.sum()), (1 - self.cruise_share) / max(1, (~fast).sum()))
        shares = share if both else np.ones(len(fast))
        return Objective(loss, shares / shares.sum(), self.derivative_bound, self.error_exponent)

    def windows(self, timesteps: int) -> int:
        """Return the number of windows in `timesteps` control steps, summed over vehicles."""
        return math.ceil(timesteps / (self.n_envs * self.n_steps))

    def share_at(self, progress: float) -> float:
        """Return the factor of the learning rates after a share `progress` of the run."""
        if progress < self.restart or not self.restart:
            done, warm_up, scale = progress / (self.restart or 1.0), self.warm_up / (self.restart or 1.0), 1.0
        else:
            done, warm_up, scale = (progress - self.restart) / (1.0 - self.restart + 1e-12), _WARM_UP, 0.5
        scale *= min(1.0, done / warm_up) if warm_up else 1.0
        return scale * (self.final_share + (1 - self.final_share) * 0.5 * (1 + math.cos(math.pi * min(done, 1.0))))

    def optimizers(self, network: nn.Module) -> tuple[torch.optim.Optimizer, ...]:
        """Return the optimisers of a network.

        `Muon` gives all directions of a matrix the same weight. The gradient through the simulator is nearly restricted
        to a few of them.
        """
        if self.matrix_learning_rate == 0:
            return (torch.optim.Adam(network.parameters(), lr=self.learning_rate),)
        *matrices, _ = (p for p in network.parameters() if p.ndim == 2)  # without the last layer's
        chosen = {id(p) for p in matrices}
        rest = [p for p in network.parameters() if id(p) not in chosen]
        muon = Muon(matrices, self.matrix_learning_rate, self.weight_decay)
        return muon, torch.optim.Adam(rest, lr=self.learning_rate)


def check(config: Config) -> Settings:
    """Return the settings of a configuration.

    Raises:
        ValueError: a hyper-parameter is unknown or wrong.
    """
    settings = from_record(Settings, config.hyperparameters, "hyper-parameters of apg")
    settings = replace(settings, space=config.scenarios[0][0].vertical is not None)
    if settings.space and settings.nominal_vehicle:
        raise ValueError("there are no nominal vehicles in space: leave out nominal_vehicle")
    config.env_scenarios(settings.n_envs)
    if settings.drawn_share and not settings.nominal_vehicle:
        raise ValueError(
            "vehicles are drawn, so they must be inputs of the network: set nominal_vehicle=true, or drawn_share=0"
        )
    if settings.drawn_share and config.expert != NO_EXPERT and not isinstance(config.make_expert(), Backstepping):
        raise ValueError(f"vehicles are drawn, so the expert must be {NO_EXPERT} or a form of {EXPERT}")
    shortest = min(scenario.steps for scenario, _ in config.scenarios)
    if settings.n_steps > shortest:
        raise ValueError(f"n_steps is {settings.n_steps}; it must be at most {shortest}, the steps of an episode")
    if config.origin:
        agent = loaded(config.origin)
        inputs = settings.inputs
        if isinstance(inputs, Inputs):  # the nominal vehicle can be added
            inputs = replace(inputs, nominal_vehicle=settings.nominal_vehicle and agent.inputs.nominal_vehicle)
        sizes = replace(settings.network, inputs=agent.network.inputs)
        if inputs != agent.inputs or sizes != agent.network:
            raise ValueError(f"agent {config.origin.agent!r} has another network, or other inputs, than the settings")
    return settings
