"""Rapid motor adaptation: a teacher is told what vehicle and sea are like, a student estimates it from what it sees.

After Kumar et al. (2021), "RMA: rapid motor adaptation for legged robots". First, a teacher learns to act on features
and a latent, which an encoder makes of the extrinsics; here by the analytic gradient, in the paper by PPO. Then the
teacher's layers are frozen, and a student's filters learn the latent from the last features and actions, in episodes in
which the student itself acts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from auv_gym.physics.intervals import check_number
from auv_gym.physics.vehicle import PAPER_VEHICLE
from baselines.agents.agent import Agent
from baselines.agents.networks import LARGEST, Rma
from baselines.training.apg.closed_loop import ClosedLoop, law_of
from baselines.training.apg.fleet import Fleet
from baselines.training.apg.kernels import LoopKernels
from baselines.training.apg.passes import Tape
from baselines.training.apg.settings import Settings as Gradient
from baselines.training.apg.settings import check as check_gradient
from baselines.training.apg.torch_network import weights_of
from baselines.training.apg.trainer import LOGS, Descent
from baselines.training.apg.window import Window
from baselines.training.config import Config
from baselines.training.rma.extrinsics import extrinsics
from baselines.training.rma.passes import Student, StudentPass, TeacherPass
from baselines.training.rma.torch_networks import Filters, Teacher
from baselines.training.run_folder import Run
from baselines.training.validation import PRECISION


@dataclass(frozen=True)
class Settings:
    """Hyper-parameters: those of the analytic gradient but for `memory` and `groups`, for the teacher, and these."""

    latent: int = 8  # numbers that an encoder makes of the extrinsics
    channels: int = 12  # of the student's filters
    encoder_size: int = 32  # units of the encoder
    adaptation_share: float = 0.3  # of the control steps, in which the student learns
    adaptation_rate: float = 0.004  # its learning rate, which falls along a cosine as the teacher's does
    adaptation_batches: int = 8  # into which the vehicles of a window are divided
    gradient: Gradient = field(default_factory=lambda: Gradient(memory=False))

    def __post_init__(self) -> None:
        for name in ("latent", "channels", "encoder_size", "adaptation_batches"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= LARGEST:
                raise ValueError(f"{name} is {value!r}; it must be an integer in [1, {LARGEST}]")
        check_number("adaptation_share", self.adaptation_share, 0.01, 0.99)
        check_number("adaptation_rate", self.adaptation_rate, 1e-9, 1)

    @property
    def network(self) -> Rma:
        """The sizes of the network."""
        size = self.gradient.hidden_size
        return Rma(len(self.gradient.inputs.features), (size, size), self.latent, self.channels)


_OWN = tuple(f.name for f in fields(Settings) if f.name != "gradient")
"""Hyper-parameters beside those of the analytic gradient."""


def check(config: Config) -> Settings:
    """Return the settings of a configuration.

    Raises:
        ValueError: a hyper-parameter is unknown or wrong, or the expert is no law without memory.
    """
    allowed = (*_OWN, *(f.name for f in fields(Gradient) if f.name not in ("memory", "groups")))
    if unknown := [name for name in config.hyperparameters if name not in allowed]:
        raise ValueError(f"unknown hyper-parameter {unknown[0]!r} of rma; allowed are {', '.join(allowed)}")
    if not law_of(config.make_expert())[1]:
        raise ValueError(f"expert {config.expert!r} computes on NumPy; rma corrects laws alone, such as backstepping")
    own = {name: value for name, value in config.hyperparameters.items() if name in _OWN}
    rest = {name: value for name, value in config.hyperparameters.items() if name not in _OWN}
    return Settings(**own, gradient=check_gradient(replace(config, hyperparameters=rest | {"memory": False})))


def train(run: Run) -> Agent:
    """Train teacher and student and return the student that was best on the validation episodes.

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


class Trainer(Descent):
    """Networks, optimisers and vehicles of a run; goes on from the run's checkpoint, if there is one."""

    def __init__(self, run: Run) -> None:
        """Begin a run, or take it up."""
        self.run, self.settings = run, check(run.config)
        config, gradient, sizes = run.config, self.settings.gradient, self.settings.network
        self.total = max(2, math.ceil(config.timesteps / (gradient.n_envs * gradient.n_steps)))
        self.lessons = min(self.total - 1, max(1, round(self.total * (1 - self.settings.adaptation_share))))
        torch.manual_seed(config.seed)
        self.teacher, self.filters = Teacher(sizes, self.settings.encoder_size), Filters(sizes)
        kept = 1 - 1 / max(1.0, gradient.average * self.lessons)
        self.averaged = AveragedModel(self.teacher, multi_avg_fn=get_ema_multi_avg_fn(kept))  # type: ignore[no-untyped-call]
        self.optimizers = gradient.optimizers(self.teacher)
        self.adam = torch.optim.Adam(self.filters.parameters(), lr=self.settings.adaptation_rate)
        self._rates = [group["lr"] for optimizer in self.optimizers for group in optimizer.param_groups]
        self.fleet = Fleet(config.lanes(gradient.n_envs), config.episode_seed, gradient.n_steps, gradient.preview)
        self.updates, self.skipped = 0, 0
        self.best = self.weights
        self.carried = self.fleet.reset(0, gradient.inputs.memory)
        if (state := run.load_checkpoint()) is not None:
            with run.restoring():
                self._restore(state)

    @property
    def timesteps(self) -> int:
        """Control steps so far, summed over vehicles."""
        return self.updates * self.settings.gradient.n_envs * self.settings.gradient.n_steps

    @property
    def weights(self) -> dict[str, NDArray[np.float32]]:
        """The student's weights: its own filters, and the layers of the teacher, averaged over the last updates."""
        return weights_of(self.filters) | weights_of(self.averaged.module.acting)  # type: ignore[arg-type]

    @cached_property
    def _kernels(self) -> LoopKernels:
        law, exact = law_of(self.run.config.make_expert())
        return LoopKernels(ClosedLoop(law, self.settings.gradient.inputs, self.fleet.parts), exact)

    @cached_property
    def _lesson(self) -> tuple[Window, TeacherPass]:
        return self._window(self.teacher, TeacherPass)

    @cached_property
    def _exercise(self) -> tuple[Window, StudentPass]:
        return self._window(Student(self.settings.network), StudentPass)

    def _window(self, network: Any, way: Any) -> tuple[Window, Any]:
        """Return a window with vehicles that a network steers, and the way through that network."""
        made: list[Any] = []

        def kept(network: Any, tape: Tape) -> Any:
            made.append(way(network, tape))
            return made[0]

        config, gradient = self.run.config, self.settings.gradient
        objective = gradient.objective([scenario.name for scenario in config.lanes(gradient.n_envs)])
        sizes = gradient.n_envs, gradient.n_steps
        return Window(self._kernels, network, *sizes, config.authority, objective, kept), made[0]

    def update(self) -> None:
        """Run one window, learn from it, and log, validate and save where it is time to."""
        learned = self._teach() if self.updates < self.lessons else self._adapt()
        self.updates += 1
        if self._due(LOGS) or self._due(self.settings.gradient.validations):
            self.run.log(self.timesteps, **learned)
        if self._due(self.settings.gradient.validations):
            self.validate()

    def _run(self, window: Window, tell: Any, back: bool) -> tuple[float, float, Tensor]:
        """Return mean loss and position error [m] of a window, and its extrinsics, which `tell` is given before."""
        ahead, samples = self.fleet.window()
        known = self.run.config.vehicle or PAPER_VEHICLE
        told = torch.from_numpy(extrinsics(samples, self.fleet.constants, known).astype(np.float32))
        tell(told)
        given = self.carried, ahead, samples, self.fleet.constants
        loss, error, carried, squared_error = window.run(*given, back=back)
        self.carried = self.fleet.renew(carried, squared_error)
        return loss, error, told

    def _teach(self) -> Mapping[str, float]:
        """Let the teacher follow the gradient of a window."""
        window, way = self._lesson
        gradient = self.settings.gradient
        for group, rate in zip(self._groups, self._rates, strict=True):
            group["lr"] = rate * gradient.share_at(self.updates / self.lessons)
        loss, error, _ = self._run(window, lambda told: setattr(way, "extrinsics", told), back=True)
        norm = self._follow(self.teacher, gradient.max_grad_norm)
        return {"loss": loss, "window_error_m": error, "gradient_norm": norm}

    def _adapt(self) -> Mapping[str, float]:
        """Let the student act in a window and its filters learn the latent that the teacher would have had."""
        if len(self.carried.hidden) != self.settings.network.memory:  # the first time
            nothing = np.zeros((self.settings.network.memory, self.settings.gradient.n_envs))
            self.carried = self.carried._replace(hidden=nothing)
        window, way = self._exercise
        way.student.weights = self.weights
        _, error, told = self._run(window, lambda _: None, back=False)
        with torch.no_grad():
            latent = self.averaged.module.latent(told)  # type: ignore[operator]
        progress = (self.updates - self.lessons) / (self.total - self.lessons)
        for group in self.adam.param_groups:
            group["lr"] = self.settings.adaptation_rate * self.settings.gradient.share_at(progress)
        losses = []
        for lanes in torch.randperm(latent.shape[-1]).chunk(self.settings.adaptation_batches):
            estimate = self.filters(way.seen[..., lanes], way.remembered[:, lanes])
            loss = (estimate - latent[..., lanes]).square().mean()
            self.adam.zero_grad()
            loss.backward()
            self.adam.step()
            losses.append(float(loss.detach()))
        spread = float(latent.var(dim=(0, 2)).mean())
        return {"window_error_m": error, "latent_error": float(np.mean(losses)), "latent_variance": spread}

    def validate(self) -> None:
        """Save a checkpoint; as soon as the student learns, validate it and keep the best."""
        if self.updates == 0 or self.updates > self.lessons:
            weights = self.weights
            policy = self.agent(weights).policy(vehicle=self.run.config.vehicle, precision=PRECISION)
            if self.run.validate(policy, self.timesteps):
                self.best = weights
        self.run.save_checkpoint(self._state())

    def agent(self, weights: Any) -> Agent:
        """Return the agent of these weights."""
        config, settings = self.run.config, self.settings
        return Agent(
            settings.network, weights, config.expert, config.authority, config.names, inputs=settings.gradient.inputs
        )

    def _state(self) -> dict[str, Any]:
        return {
            "timesteps": self.timesteps,
            "plain": {name: getattr(self, name) for name in _PLAIN},
            "modules": [part.state_dict() for part in self._modules()],
            "generator": torch.get_rng_state(),
        }

    def _modules(self) -> list[Any]:
        return [self.teacher, self.averaged, self.filters, self.adam, *self.optimizers]

    def _restore(self, state: dict[str, Any]) -> None:
        for name, value in state["plain"].items():
            setattr(self, name, value)
        for part, its in zip(self._modules(), state["modules"], strict=True):
            part.load_state_dict(its)
        torch.set_rng_state(state["generator"])


_PLAIN = ("updates", "skipped", "best", "fleet", "carried")
"""What a trainer keeps as it is."""
