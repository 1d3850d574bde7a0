"""Analytic policy gradient: back-propagation through the simulator, a window of control steps at a time.

The network corrects an expert. What it remembers is carried from window to window without the graph behind it, and the
loss is the tracking error itself: no value function, no exploration, no reward.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from auv_gym.intervals import check_number
from auv_gym.namespaces import ARRAYS
from auv_gym.policy import preview_of
from auv_gym.preview import encode_preview, shared_preview
from auv_gym.records import from_record
from auv_gym.task import decode_observation
from auv_gym.vehicle import PAPER_VEHICLE
from baselines.agents.agent import Agent
from baselines.agents.features import Inputs
from baselines.agents.networks import Gru, Mlp
from baselines.control.backstepping import Backstepping
from baselines.control.open_loop import NO_EXPERT
from baselines.evaluation.score import EXPERT, regime_of
from baselines.policy import Memory
from baselines.training.apg.closed_loop import ClosedLoop, Loss, law_of
from baselines.training.apg.fleet import Fleet
from baselines.training.apg.kernels import LoopKernels
from baselines.training.apg.torch_network import put, torch_network, weights_of
from baselines.training.apg.window import Array, Objective, Window
from baselines.training.beginning import loaded
from baselines.training.config import Config
from baselines.training.hulls import told, turns
from baselines.training.run_folder import VALIDATIONS, Run, TrainingError
from baselines.training.validation import PRECISION

SHARES = ("final_share", "warm_up", "average", "cruise_share", "hulls", "evenness")  # settings in [0, 1]
WEIGHTS = ("cut", "hull_weight", "effort_weight", "rate_weight", "cruise_effort_weight", "cruise_rate_weight")
"""Settings of 0 or more; those of cruise may be None."""
LOGS = 200  # how often in a run its progress is logged


@dataclass(frozen=True)
class Settings:
    """Hyper-parameters of the analytic gradient."""

    n_envs: int = 128  # vehicles side by side
    n_steps: int = 50  # control steps of a window
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
    hull: bool = False  # whether it is told the known vehicle
    hulls: float = 0.0  # share of the vehicles side by side whose hulls are drawn, see `hulls`
    hull_weight: float = 1.0  # what the loss of such a vehicle counts for beside that of another one
    validations: int = VALIDATIONS  # how often in the run the agent is validated, and a checkpoint kept

    def __post_init__(self) -> None:
        for name, high in (("n_envs", 2**16), ("n_steps", 10**4), ("validations", 1000)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= high:
                raise ValueError(f"{name} is {value!r}; it must be an integer in [1, {high}]")
        for name in ("learning_rate", "max_grad_norm"):
            check_number(name, getattr(self, name), 1e-9, 1e6)
        for name in (*SHARES, "matrix_learning_rate", "weight_decay"):
            check_number(name, getattr(self, name), 0, 1)
        for name in WEIGHTS:
            if getattr(self, name) is not None or not name.startswith("cruise"):
                check_number(name, getattr(self, name), 0, 1e6)
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

    def objective(self, names: Sequence[str], drawn: Sequence[bool] = ()) -> Objective:
        """Return what is learned in scenarios of these names; `drawn` says whose hull is drawn, () for nobody's."""
        fast = np.array([regime_of(name) == "cruise" for name in names])
        cruise = (self.cruise_effort_weight, self.cruise_rate_weight)
        pairs = zip((self.effort_weight, self.rate_weight), cruise, strict=True)
        loss = Loss(*(np.where(fast, slow if own is None else own, slow) for slow, own in pairs))
        both = fast.any() and not fast.all()
        share = np.where(fast, self.cruise_share / max(1, fast.sum()), (1 - self.cruise_share) / max(1, (~fast).sum()))
        shares = np.where(drawn or False, self.hull_weight, 1.0) * (share if both else np.ones(len(fast)))
        return Objective(loss, shares / shares.sum(), self.cut, self.evenness)

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
        raise ValueError("hulls are drawn, so the network must be told them: set hull=true, or hulls=0")
    if settings.hulls and config.expert != NO_EXPERT and not isinstance(config.make_expert(), Backstepping):
        raise ValueError(f"hulls are drawn, so the expert must be a form of {EXPERT} or {NO_EXPERT}: it is told them")
    shortest = min(scenario.steps for scenario, _ in config.scenarios)
    if settings.n_steps > shortest:
        raise ValueError(f"n_steps is {settings.n_steps}; it must be at most {shortest}, the steps of an episode")
    if config.origin:
        agent = loaded(config.origin)
        known = replace(settings.inputs, hull=settings.hull and agent.inputs.hull)  # a network can be told more
        sizes = replace(settings.network, inputs=agent.network.inputs)
        if known != agent.inputs or sizes != agent.network:
            raise ValueError(f"agent {config.origin.agent!r} has another network, or other inputs, than is asked for")
    return settings


def train(run: Run) -> Agent:
    """Train an agent and return the best one on the validation episodes.

    Raises:
        OSError: the run's folder cannot be written to.
        TrainingError: the gradient is not finite any more.
        ValueError: see `check`.
    """
    trainer = Trainer(run)
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

    def __init__(self, run: Run) -> None:
        """Begin a run, or take it up."""
        self.run, self.settings = run, check(run.config)
        config, settings = run.config, self.settings
        self.total = max(1, math.ceil(config.timesteps / (settings.n_envs * settings.n_steps)))
        torch.manual_seed(config.seed)
        self.network = torch_network(settings.network)
        if config.origin:
            put(loaded(config.origin).weights, self.network)
        kept = 1 - 1 / max(1.0, settings.average * self.total)
        self.averaged = AveragedModel(self.network, multi_avg_fn=get_ema_multi_avg_fn(kept))  # type: ignore[no-untyped-call]
        self.optimizers = settings.optimizers(self.network)
        self._rates = [group["lr"] for group in self._groups]
        self._expert = config.make_expert()
        preview, self._seen, self._seen_by_expert = shared_preview(settings.preview, preview_of(self._expert))
        lanes = config.lanes(settings.n_envs)
        drawn = settings.hulls and config.vehicle == PAPER_VEHICLE  # for another one, it alone is learned
        self._hulls = hulls = turns(lanes, settings.hulls, config.episode_seed) if drawn else []
        self.fleet = Fleet(lanes, config.episode_seed, settings.n_steps, preview, hulls, told if drawn else None)
        self.updates, self.skipped, self.score = 0, 0, -math.inf
        self.best = weights_of(self.averaged.module)
        self._memory: Memory | None = None  # of an expert on NumPy
        if (state := run.load_checkpoint()) is None:
            self.carried = self.fleet.reset(settings.network.memory, settings.inputs.memory)
        else:
            with run.restoring():
                self._restore(state)
        law, self._exact = law_of(self._expert)
        believer = self._expert if settings.hull and isinstance(self._expert, Backstepping) else None
        kernels = LoopKernels(ClosedLoop(law, settings.inputs, self.fleet.parts, believer), self._exact)
        objective = settings.objective([scenario.name for scenario in lanes], [len(own) > 1 for own in hulls])
        sizes = settings.n_envs, settings.n_steps
        self._window = Window(kernels, self.network, *sizes, config.authority, objective)

    @property
    def timesteps(self) -> int:
        """Control steps so far, summed over vehicles."""
        return self.updates * self.settings.n_envs * self.settings.n_steps

    def update(self) -> None:
        """Run one window, follow its gradient, and log, validate and save where it is time to."""
        share = self.settings.share_at(self.updates / self.total)
        for group, rate in zip(self._groups, self._rates, strict=True):
            group["lr"] = rate * share
        loss, error = self._run()
        norm = self._follow(self.network, self.settings.max_grad_norm)
        self.updates += 1
        if self._due(LOGS):
            self.run.log(self.timesteps, loss=loss, window_error_m=error, gradient_norm=norm)
        if self._due(self.settings.validations):
            self.validate()

    def _run(self) -> tuple[float, float]:
        """Return the mean loss of a window and its mean position error [m]; begin new episodes behind it."""
        ahead, samples = self.fleet.window()
        fresh, nothing = self.fleet.fresh, np.zeros_like(self.fleet.fresh)

        def act(k: int, observation: Array) -> Array:
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
        return loss, error

    def _act(self, observation: Array, ahead: Array, fresh: NDArray[np.bool_]) -> Array:
        """Return the action of an expert on NumPy, shape (ACTIONS, N)."""
        rows = observation.T.astype(np.float64)
        if self._seen_by_expert:
            ways = ahead[self._seen_by_expert].reshape(-1, 2, len(rows))
            rows = np.hstack((rows, encode_preview(ways, decode_observation(rows), ARRAYS, self.fleet.parts.span).T))
        action, self._memory = self._expert.predict(rows, self._memory, fresh)
        return action.T

    def validate(self) -> None:
        """Measure the agent on the validation episodes, keep the best, and save a checkpoint.

        The episodes are of the configuration's own vehicle, so where hulls are drawn the last one is kept.
        """
        weights = weights_of(self.averaged.module)
        policy = self.agent(weights).policy(vehicle=self.run.config.vehicle, precision=PRECISION)
        score = self.run.validate(policy, self.timesteps)
        if score > self.score or self._hulls:
            self.score, self.best = score, weights
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
            "score": self.score,
            "best": self.best,
            "network": self.network.state_dict(),
            "averaged": self.averaged.state_dict(),
            "optimizers": [optimizer.state_dict() for optimizer in self.optimizers],
            "fleet": self.fleet,
            "carried": self.carried,
            "memory": self._memory,
        }

    def _restore(self, state: dict[str, Any]) -> None:
        self.updates, self.skipped = state["updates"], state["skipped"]
        self.score, self.best = state["score"], state["best"]
        self.network.load_state_dict(state["network"])
        self.averaged.load_state_dict(state["averaged"])
        for optimizer, its in zip(self.optimizers, state["optimizers"], strict=True):
            optimizer.load_state_dict(its)
        self.fleet, self.carried, self._memory = state["fleet"], state["carried"], state["memory"]
