"""Rapid motor adaptation: a teacher is given vehicle and disturbances, a student estimates them from what it sees.

After Kumar et al. (2021), "RMA: rapid motor adaptation for legged robots". First, a teacher learns to act on features
and a latent, which an encoder makes of the extrinsics; here by the analytic gradient, in the paper by PPO. Then the
teacher's layers are frozen, and a student's filters learn the latent from the last features and actions, in episodes in
which the student itself acts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from auv_gym.physics.intervals import check_number
from auv_gym.physics.vehicle import PAPER_VEHICLE
from baselines.agents.agent import Agent
from baselines.agents.networks import LARGEST_LAYER, Rma, Weights
from baselines.training.apg.closed_loop import ClosedLoop, law_of
from baselines.training.apg.kernels import LoopKernels
from baselines.training.apg.passes import NetworkTape
from baselines.training.apg.settings import Settings as Gradient
from baselines.training.apg.settings import check as check_gradient
from baselines.training.apg.torch_network import weights_of
from baselines.training.apg.trainer import GradientTrainer
from baselines.training.apg.vehicles import TrainingVehicles
from baselines.training.apg.window import Window
from baselines.training.config import Config, check_integer
from baselines.training.rma.extrinsics import extrinsics
from baselines.training.rma.networks import Filters, Student, StudentPass, Teacher, TeacherPass
from baselines.training.run_folder import RunFolder


@dataclass(frozen=True)
class RmaSettings:
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
            check_integer(name, getattr(self, name), 1, LARGEST_LAYER)
        check_number("adaptation_share", self.adaptation_share, 0.01, 0.99)
        check_number("adaptation_rate", self.adaptation_rate, 1e-9, 1)

    @property
    def network(self) -> Rma:
        """The sizes of the network."""
        size = self.gradient.hidden_size
        return Rma(len(self.gradient.inputs.features), (size, size), self.latent, self.channels)


_OWN = tuple(f.name for f in fields(RmaSettings) if f.name != "gradient")
"""Hyper-parameters beside those of the analytic gradient."""


def check(config: Config) -> RmaSettings:
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
    return RmaSettings(**own, gradient=check_gradient(replace(config, hyperparameters=rest | {"memory": False})))


def train(run: RunFolder) -> Agent:
    """Train teacher and student and return the student that was best on the validation episodes.

    Raises:
        OSError: the run's folder cannot be written to.
        TrainingError: the gradient is not finite any more.
        ValueError: see `check`.
    """
    return RmaTrainer(run).train()


class RmaTrainer(GradientTrainer):
    """Networks, optimisers and vehicles of a run; goes on from the run's checkpoint, if there is one."""

    network: Teacher

    def __init__(self, run: RunFolder) -> None:
        """Begin a run, or take it up."""
        self.settings, config = check(run.config), run.config
        gradient, sizes = self.settings.gradient, self.settings.network
        total = max(2, gradient.windows(config.timesteps))
        self.lessons = min(total - 1, max(1, round(total * (1 - self.settings.adaptation_share))))
        torch.manual_seed(config.seed)
        teacher, self.filters = Teacher(sizes, self.settings.encoder_size), Filters(sizes)
        self.adam = torch.optim.Adam(self.filters.parameters(), lr=self.settings.adaptation_rate)
        more = {"filters": self.filters, "adam": self.adam}
        super().__init__(run, gradient, teacher, sizes, total, self.lessons, **more)
        lanes = config.lanes(gradient.n_envs)
        self.batch = TrainingVehicles(lanes, config.episode_seed, gradient.n_steps, gradient.preview)
        self.carried = self.batch.reset(0, gradient.inputs.memory)
        self.resume()

    @property
    def weights(self) -> Weights:
        """The student's weights: its own filters, and the layers of the teacher, averaged over the last updates."""
        return weights_of(self.filters) | weights_of(self.averaged.module.acting)  # type: ignore[arg-type]

    @property
    def vehicles(self) -> Any:
        """What it takes the vehicles to go on."""
        return self.batch, self.carried

    @vehicles.setter
    def vehicles(self, state: Any) -> None:
        self.batch, self.carried = state

    @cached_property
    def _lesson(self) -> tuple[Window, TeacherPass]:
        return self._window(self.network, TeacherPass)

    @cached_property
    def _exercise(self) -> tuple[Window, StudentPass]:
        return self._window(Student(self.settings.network), StudentPass)

    def _window(self, network: Any, way: Any) -> tuple[Window, Any]:
        """Return a window with vehicles that a network steers, and the way through that network."""
        made: list[Any] = []

        def kept(network: Any, tape: NetworkTape) -> Any:
            made.append(way(network, tape))
            return made[0]

        config, gradient = self.run.config, self.gradient
        law, exact = law_of(config.make_expert())
        kernels = LoopKernels(ClosedLoop(law, gradient.inputs, self.batch.parts), exact)
        objective = gradient.objective([scenario.name for scenario in config.lanes(gradient.n_envs)])
        sizes = gradient.n_envs, gradient.n_steps
        return Window(kernels, network, *sizes, config.authority, objective, kept), made[0]

    def learn(self) -> Mapping[str, float]:
        """Run one window, from which first the teacher learns and then the student."""
        return self._teach() if self.updates < self.lessons else self._adapt()

    def _run(self, window: Window, way: Any, back: bool) -> tuple[float, float, Tensor]:
        """Return mean loss and position error [m] of a window, and its extrinsics, which the way is given before."""
        ahead, samples = self.batch.window()
        known = self.run.config.vehicle or PAPER_VEHICLE
        way.extrinsics = torch.from_numpy(extrinsics(samples, self.batch.constants, known).astype(np.float32))
        given = self.carried, ahead, samples, self.batch.constants
        loss, error, carried, squared_error = window.run(*given, back=back)
        self.carried = self.batch.renew(carried, squared_error)
        return loss, error, way.extrinsics

    def _teach(self) -> Mapping[str, float]:
        """Let the teacher follow the gradient of a window."""
        self._set_rates(self.updates / self.lessons)
        loss, error, _ = self._run(*self._lesson, back=True)
        return {"loss": loss, "window_error_m": error, "gradient_norm": self._follow()}

    def _adapt(self) -> Mapping[str, float]:
        """Let the student act in a window and its filters learn the latent that the teacher would have had."""
        if len(self.carried.hidden) != self.sizes.memory:  # the first time
            self.carried = self.carried._replace(hidden=np.zeros((self.sizes.memory, self.gradient.n_envs)))
        window, way = self._exercise
        way.student.weights = self.weights
        _, error, truth = self._run(window, way, back=False)
        with torch.no_grad():
            latent = self.averaged.module.latent(truth)  # type: ignore[operator]
        progress = (self.updates - self.lessons) / (self.total - self.lessons)
        for group in self.adam.param_groups:
            group["lr"] = self.settings.adaptation_rate * self.gradient.share_at(progress)
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
        """Save a checkpoint; before the first window and as soon as the student learns, validate it too."""
        if self.updates == 0 or self.updates > self.lessons:
            super().validate()
        else:
            self.save()
