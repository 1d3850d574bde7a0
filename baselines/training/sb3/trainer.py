"""Train with Stable-Baselines3: PPO, SAC and TD3 on the vector environment of the package."""

from __future__ import annotations

import copy
import inspect
import math
import random
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.utils import LinearSchedule
from torch import nn

from auv_gym.envs.residual import VectorResidualAction
from auv_gym.physics.intervals import check_number
from auv_gym.scenarios.records import from_record, guarded
from auv_gym.task.policy import preview_of
from baselines.agents.agent import Agent
from baselines.agents.features import STANDARD, Inputs
from baselines.agents.networks import Mlp
from baselines.agents.space_features import SpaceInputs
from baselines.training.config import Config, check_integer
from baselines.training.run_folder import VALIDATIONS, RunFolder, TrainingError
from baselines.training.sb3.vec_env import SB3VecEnv
from baselines.training.sb3.vec_features import VecFeatures

ALGORITHM_CLASSES: Mapping[str, type[BaseAlgorithm]] = {"ppo": PPO, "sac": SAC, "td3": TD3}
"""Class of each algorithm."""
_NO_HYPERPARAMETERS = {
    "self", "policy", "env", "seed", "device", "verbose", "tensorboard_log", "action_noise", "_init_setup_model",
}  # fmt: skip
"""Arguments of these classes that are no hyper-parameters."""
_ACTIVATIONS: dict[type, str] = {nn.Tanh: "tanh", nn.ReLU: "relu"}
LARGEST_WEIGHT = 1e6  # magnitude of a weight from which the training counts as diverged


@dataclass(frozen=True)
class SB3Settings:
    """Hyper-parameters in addition to those of the algorithms' classes."""

    n_envs: int = 128  # number of sub-environments
    learning_rate: float = 3e-4  # initial learning rate
    final_share: float = 0.0  # final over initial learning rate; it decreases linearly
    initial_std: float | None = None
    """Initial standard deviation of the corrections before they are bounded, or with `use_sde` of each unit's
    contribution; None: that of Stable-Baselines3. TD3 has none."""
    noise_std: float = 0.0  # standard deviation of normal noise that is added to the corrections, for TD3
    frozen_steps: int = 0
    """Control steps, summed over vehicles, for which the actor of SAC or TD3 does not change, so that the critic first
    learns the values of the expert's actions."""
    error_weight: float = 0.0  # see `VecFeatures`
    reward_share: float = 1.0  # see `VecFeatures`
    lead: float = 1.0  # [s] see `VecFeatures`

    def __post_init__(self) -> None:
        check_integer("n_envs", self.n_envs, 1, 2**16)
        check_integer("frozen_steps", self.frozen_steps, 0, 10**12)
        for name, largest in (
            ("learning_rate", math.inf), ("final_share", 1), ("noise_std", 100), ("error_weight", 1e6),
            ("reward_share", 1e6), ("lead", 1e3),
        ):  # fmt: skip
            check_number(name, getattr(self, name), 0, largest)
        if self.initial_std is not None:
            check_number("initial_std", self.initial_std, 1e-9, 1e3)


_SETTINGS = [field.name for field in fields(SB3Settings)]


def check(config: Config) -> None:
    """Raise ValueError if a configuration cannot be trained."""
    exported_agent(make_model(config).policy, config)


def train(run: RunFolder) -> Agent:
    """Train an agent, from the run's checkpoint if it has one; return the agent of the best validation.

    Raises:
        OSError: the run's folder cannot be written to.
        TrainingError: the weights have diverged.
    """
    config = run.config
    if (state := run.load_checkpoint()) is None:
        model, validated = make_model(config), -1
    else:
        with run.restoring():
            model, validated = state["model"], state["timesteps"]
            random.setstate(state["python"])
            np.random.set_state(state["numpy"])  # noqa: NPY002, Stable-Baselines3 draws from it
            torch.set_rng_state(state["torch"])
    rest, tracker = config.timesteps - model.num_timesteps, Tracker(run, validated, model.use_sde)
    if state is not None:
        model.use_sde = False  # the exploration was drawn before the checkpoint; `learn` would draw it again
    if rest > 0:
        try:
            model.learn(rest, tracker, log_interval=None, reset_num_timesteps=state is None)
        except ValueError as error:  # torch rejects a distribution with parameters that are not finite
            if is_bounded(model):
                raise
            raise TrainingError(f"training diverged after {model.num_timesteps} steps: lower learning_rate") from error
    return replace(exported_agent(model.policy, config), weights=run.weights)


def make_model(config: Config) -> Any:
    """Return the untrained model of a configuration, with its environment; its first corrections are zero.

    Raises:
        ValueError: a hyper-parameter is unknown or impossible.
    """
    cls, (settings, values) = ALGORITHM_CLASSES[config.algo], separated(config)
    allowed = {*inspect.signature(cls).parameters} - _NO_HYPERPARAMETERS
    if unknown := [name for name in values if name not in allowed]:
        names = ", ".join(sorted({*allowed, *_SETTINGS}))
        raise ValueError(f"unknown hyper-parameter {unknown[0]!r} of {config.algo}; allowed are {names}")
    if cls is PPO and (settings.noise_std or settings.frozen_steps):
        raise ValueError("noise_std and frozen_steps are hyper-parameters of sac and td3 only; leave them out")
    first = settings.learning_rate
    values["learning_rate"] = LinearSchedule(first, first * settings.final_share, 1.0)
    if settings.noise_std:
        values["action_noise"] = NormalActionNoise(
            *(np.full(len(config.authority), std) for std in (0.0, settings.noise_std))
        )
    env = make_training_env(config)
    with guarded(f"hyper-parameters of {config.algo}"), warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        model = cls("MlpPolicy", env, seed=config.seed, device="cpu", **values)
    start_at_expert(model.policy, settings.initial_std)
    env.seed(config.episode_seed)
    return model


def separated(config: Config) -> tuple[SB3Settings, dict[str, Any]]:
    """Return the settings of a configuration, and the hyper-parameters of the algorithm's class.

    Raises:
        ValueError: a setting is wrong.
    """
    values = copy.deepcopy(dict(config.hyperparameters))
    ours = {name: values.pop(name) for name in _SETTINGS if name in values}
    return from_record(SB3Settings, ours, f"hyper-parameters of {config.algo}"), values


def make_training_env(config: Config) -> VecFeatures:
    """Return the training environment of a configuration as a `VecEnv`.

    Raises:
        ValueError: there are too few sub-environments, or a setting is wrong.
    """
    expert, (settings, _) = config.make_expert(), separated(config)
    track = gym.make_vec(
        f"auv_gym:UnderactuatedAUVTrack{'3D' if _inputs(config) != STANDARD else ''}-v0",
        num_envs=settings.n_envs,
        vectorization_mode="vector_entry_point",
        scenario=config.env_scenarios(settings.n_envs),
        preview=preview_of(expert),
    )
    residual = SB3VecEnv(VectorResidualAction(track, expert, config.authority))
    return VecFeatures(residual, settings.error_weight, settings.reward_share, settings.lead, _inputs(config))


def _inputs(config: Config) -> Inputs | SpaceInputs:
    """Return the features of a configuration, those in space if its scenarios are."""
    return SpaceInputs() if config.scenarios[0][0].vertical else STANDARD


def start_at_expert(policy: Any, std: float | None = None) -> None:
    """Set the actor's correction to zero, so that training starts with the performance of the expert.

    Args:
        policy: the untrained one.
        std: see `Settings.initial_std`.
    """
    layer: Any = actor_layers(policy)[0][-1]
    spread = getattr(getattr(policy, "actor", policy), "log_std", None)
    with torch.no_grad():
        if isinstance(layer, nn.Linear):
            layer.weight.zero_()
            layer.bias.zero_()
        if hasattr(policy, "actor_target"):
            policy.actor_target.load_state_dict(policy.actor.state_dict())
        if std is not None and isinstance(
            spread, nn.Parameter
        ):  # PPO: for each action; with use_sde, for each unit too
            spread.fill_(math.log(std))
        elif std is not None and isinstance(spread, nn.Linear):  # SAC: a function of the input
            spread.weight.zero_()
            spread.bias.fill_(math.log(std))


def actor_layers(policy: Any) -> tuple[list[nn.Module], str]:
    """Return the layers from the features to the mean action, and the name of its bound, see `networks._BOUNDS`."""
    if hasattr(policy, "mlp_extractor"):  # PPO
        return [*policy.mlp_extractor.policy_net, policy.action_net], "clip"
    if hasattr(policy.actor, "latent_pi"):  # SAC
        return [*policy.actor.latent_pi, policy.actor.mu], "tanh"
    return [*policy.actor.mu][:-1], "tanh"  # TD3, whose last layer is the bound


def exported_agent(policy: Any, config: Config) -> Agent:
    """Return the deterministic actor of a model as an agent that runs on NumPy.

    Raises:
        ValueError: the actor has other layers than linear ones with tanh or ReLU between them.
    """
    chain, bound = actor_layers(policy)
    linear = [layer for layer in chain if isinstance(layer, nn.Linear)]
    between = {_ACTIVATIONS.get(type(layer)) for layer in chain if not isinstance(layer, nn.Linear)} or {"tanh"}
    if len(between) != 1 or None in between or len(chain) != 2 * len(linear) - 1:
        raise ValueError(
            "the actor must consist of linear layers with tanh or ReLU between them; with use_sde set clip_mean to 0 "
            "in policy_kwargs"
        )
    sizes = tuple(layer.out_features for layer in linear[:-1])
    weights = {
        f"layers.{i}.{name}": np.array(value.detach().numpy())
        for i, layer in enumerate(linear)
        for name, value in layer.named_parameters()
    }
    network = Mlp(linear[0].in_features, sizes, str(between.pop()), bound, len(config.authority))
    return Agent(
        network,
        weights,
        config.expert,
        config.authority,
        config.names,
        inputs=_inputs(config),
        whole_model=config.whole_model,
    )


class Tracker(BaseCallback):
    """Logs and validates a model at the start, `VALIDATIONS` times a run and at the end, each time with a checkpoint.

    A checkpoint is the whole model with its environment, replay buffer and counters, and the random generators. So a
    resumed training gives the same agent.

    Args:
        run: for log and checkpoints.
        validated: control steps at the last validation; -1 without any.
        use_sde: whether exploration depends on the state; a resumed model needs it from the first rollout on.
    """

    def __init__(self, run: RunFolder, validated: int, use_sde: bool) -> None:
        super().__init__()
        self.run = run
        self._validated, self._use_sde = validated, use_sde
        self._frozen_steps = separated(run.config)[0].frozen_steps

    def _init_callback(self) -> None:
        self.model.set_logger(Logger(None, []))

    def _on_rollout_start(self) -> None:
        self.model.use_sde = self._use_sde
        if self._frozen_steps:
            policy: Any = self.model.policy
            policy.actor.requires_grad_(self.num_timesteps >= self._frozen_steps)
        every = self.run.config.timesteps / VALIDATIONS
        if self.num_timesteps // every > self._validated // every:
            self._validate()
        else:
            self.run.report(self.num_timesteps)

    def _on_training_end(self) -> None:
        if self.num_timesteps > self._validated:
            self._validate()

    def _on_step(self) -> bool:
        return True

    def _validate(self) -> None:
        if not is_bounded(self.model):
            raise TrainingError(f"training diverged after {self.num_timesteps} steps: lower learning_rate")
        self.run.log(self.num_timesteps, **self._learned())
        self.run.validate(exported_agent(self.model.policy, self.run.config), self.num_timesteps)
        self._validated = self.num_timesteps
        self.run.save_checkpoint(
            {
                "timesteps": self.num_timesteps,
                "model": self.model,
                "python": random.getstate(),
                "numpy": np.random.get_state(),  # noqa: NPY002
                "torch": torch.get_rng_state(),
            }
        )

    def _learned(self) -> dict[str, float]:
        """Return the values that the algorithm has logged since the last call, and the mean return of the episodes."""
        values = {k: float(v) for k, v in self.logger.name_to_value.items() if isinstance(v, (int, float, np.number))}
        self.logger.dump()
        if self.model.ep_info_buffer:
            values["return"] = float(np.mean([episode["r"] for episode in self.model.ep_info_buffer]))
        return values


def is_bounded(model: BaseAlgorithm) -> bool:
    """Return whether all weights of a model are smaller than `LARGEST_WEIGHT`."""
    return all(bool((p.abs() < LARGEST_WEIGHT).all()) for p in model.policy.parameters())
