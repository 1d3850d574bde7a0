"""Train with Stable-Baselines3: PPO, recurrent PPO, SAC, TD3 and TQC on the vector environment of the package."""

from __future__ import annotations

import inspect
import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import gymnasium as gym
import numpy as np
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, CallbackList
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.noise import ActionNoise, NormalActionNoise, OrnsteinUhlenbeckActionNoise
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecMonitor
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvWrapper

from auv_gym.envs.residual import VectorResidualAction
from auv_gym.scenarios.records import guarded
from auv_gym.task.policy import preview_of
from baselines.agents.agent import Agent
from baselines.training.config import Config, check_integer
from baselines.training.run_folder import VALIDATIONS, RunFolder, TrainingError
from baselines.training.sb3.callbacks import FrozenActor, ZeroCorrection
from baselines.training.sb3.export import exported_network
from baselines.training.sb3.snapshot import restore, restore_exploration, snapshot
from baselines.training.sb3.vec_env import SB3VecEnv
from baselines.training.sb3.vec_features import VecFeatures
from baselines.training.sb3.vec_reward import VecErrorCost

T = TypeVar("T")

ALGORITHM_CLASSES: Mapping[str, type[BaseAlgorithm]] = {
    "ppo": PPO,
    "ppo_lstm": RecurrentPPO,
    "sac": SAC,
    "td3": TD3,
    "tqc": TQC,
}
"""Class of each algorithm, by the names of rl_zoo3."""
_POLICIES = {"ppo_lstm": "MlpLstmPolicy"}
"""Policy of each algorithm whose policy is not MlpPolicy."""
_CALLBACKS: Mapping[str, type[BaseCallback]] = {
    f"{cls.__module__}.{cls.__name__}": cls for cls in (ZeroCorrection, FrozenActor)
}
_WRAPPERS: Mapping[str, type[VecEnvWrapper]] = {
    f"{cls.__module__}.{cls.__name__}": cls for cls in (VecErrorCost, VecFeatures)
}
_OURS = {"self", "policy", "env", "seed", "device", "verbose", "tensorboard_log", "_init_setup_model"}
_NOISES: Mapping[str, Callable[[Any, Any], ActionNoise]] = {
    "normal": NormalActionNoise,
    "ornstein-uhlenbeck": OrnsteinUhlenbeckActionNoise,
}
_MOST_VEHICLES = 2**16
LARGEST_WEIGHT = 1e6  # magnitude of a weight from which the training counts as diverged
_SCHEDULED = ("learning_rate", "clip_range", "clip_range_vf")


def check(config: Config) -> None:
    """Raise ValueError if a configuration cannot be trained."""
    exported_network(make_model(config).policy, config)
    _callbacks(config.hyperparameters.get("callback", []))


def train(run: RunFolder) -> Agent:
    """Train an agent, from the run's checkpoint if it has one; return the agent of the best validation.

    Raises:
        OSError: the run's folder cannot be written to.
        TrainingError: the weights have diverged.
    """
    config = run.config
    state = run.load_checkpoint()
    model = make_model(config)
    if state is not None:
        with run.restoring():
            restore(model, state)
    rest = config.timesteps - model.num_timesteps
    callbacks = CallbackList([*_callbacks(config.hyperparameters.get("callback", [])), Tracker(run, state)])
    if rest > 0:
        try:
            model.learn(rest, callbacks, log_interval=None, reset_num_timesteps=state is None)  # type: ignore[arg-type]
        except ValueError as error:  # torch rejects a distribution with parameters that are not finite
            if is_bounded(model):
                raise
            raise TrainingError(f"training diverged after {model.num_timesteps} steps: lower learning_rate") from error
    return replace(exported_network(model.policy, config), weights=run.weights)


def make_model(config: Config) -> BaseAlgorithm:
    """Return the untrained model of a configuration, with its environment.

    Raises:
        ValueError: a hyper-parameter is unknown or impossible.
    """
    cls, values = ALGORITHM_CLASSES[config.algo], dict(config.hyperparameters)
    values.pop("callback", None)
    own = _POLICIES.get(config.algo, "MlpPolicy")
    if (policy := values.pop("policy", own)) != own:
        raise ValueError(f"hyper-parameter policy is {policy!r}; of {config.algo} it must be {own}")
    n_envs, noise = values.pop("n_envs", 1), _noise(values)
    env = make_training_env(config, n_envs, values.pop("vec_env_wrapper", []))
    allowed = sorted(set(inspect.signature(cls).parameters) - _OURS)
    if unknown := [name for name in values if name not in allowed]:
        raise ValueError(f"unknown hyper-parameter {unknown[0]!r} of {config.algo}; allowed are {', '.join(allowed)}")
    if noise is not None:
        values["action_noise"] = noise
    values |= {name: _schedule(name, values[name]) for name in _SCHEDULED if name in values}
    if isinstance(values.get("train_freq"), list):
        values["train_freq"] = tuple(values["train_freq"])
    with guarded(f"hyper-parameters of {config.algo}"), warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)
        model = cls(policy, env, seed=config.seed, device="cpu", **values)
    env.seed(config.episode_seed)
    return model


def make_training_env(config: Config, n_envs: int, wrappers: Any = ()) -> VecFeatures:
    """Return the training environment of a configuration as a `VecEnv`.

    Args:
        config: the configuration.
        n_envs: number of sub-environments.
        wrappers: in the format of rl_zoo3, the innermost first; `VecFeatures` is added if it is not the last one.

    Raises:
        ValueError: there are too few sub-environments, or a wrapper is unknown.
    """
    check_integer("hyper-parameter n_envs", n_envs, 1, _MOST_VEHICLES)
    expert = config.make_expert()
    track = gym.make_vec(
        "auv_gym:UnderactuatedAUVTrack-v0",
        num_envs=n_envs,
        vectorization_mode="vector_entry_point",
        scenario=config.env_scenarios(n_envs),
        preview=preview_of(expert),
    )
    env: VecEnv = VecMonitor(SB3VecEnv(VectorResidualAction(track, expert, config.authority)))
    for make in _named(wrappers, _WRAPPERS, "vec_env_wrapper"):
        env = make(env)
    return env if isinstance(env, VecFeatures) else VecFeatures(env)


def _schedule(name: str, value: Any) -> Any:
    """Return a hyper-parameter for Stable-Baselines3: a number, or for lin_NUMBER a linear decrease to zero."""
    if isinstance(value, str):
        try:
            start = float(value.removeprefix("lin_"))
        except ValueError:
            start = math.nan
        if not value.startswith("lin_") or not math.isfinite(start):
            raise ValueError(f"hyper-parameter {name} is {value!r}; it must be a number, or lin_NUMBER falling to zero")
        return LinearSchedule(start, 0.0, 1.0)
    return value


def _noise(values: dict[str, Any]) -> ActionNoise | None:
    """Remove `noise_type` and `noise_std` from the hyper-parameters and return the action noise; None if not set."""
    kind, std = values.pop("noise_type", None), values.pop("noise_std", 0.0)
    if kind is None:
        return None
    if kind not in list(_NOISES) or isinstance(std, bool) or not isinstance(std, (int, float)) or not 0 <= std <= 100:
        kinds = " or ".join(_NOISES)
        raise ValueError(f"noise is {kind!r} of noise_std {std!r}; it must be {kinds}, of a number in [0, 100]")
    return _NOISES[kind](np.zeros(2), np.full(2, float(std)))


def _callbacks(entries: Any) -> list[BaseCallback]:
    """Return the callbacks of a configuration; `ZeroCorrection` is added if it is not among them."""
    made = [make() for make in _named(entries, _CALLBACKS, "callback")]
    return made if any(isinstance(callback, ZeroCorrection) for callback in made) else [ZeroCorrection(), *made]


def _named(entries: Any, table: Mapping[str, Callable[..., T]], kind: str) -> list[Callable[..., T]]:
    """Return the constructors of entries in the format of rl_zoo3: a name, or a table {name: arguments}.

    Args:
        entries: one or a list of them.
        table: allowed names and their constructors.
        kind: name of the hyper-parameter.

    Raises:
        ValueError: a name is unknown, or an argument is.
    """
    made: list[Callable[..., T]] = []
    for entry in entries if isinstance(entries, (list, tuple)) else [entries]:
        name, arguments = next(iter(entry.items())) if isinstance(entry, Mapping) and len(entry) == 1 else (entry, {})
        if name not in list(table):
            raise ValueError(f"unknown {kind} {name!r}; allowed are {', '.join(table)}")
        known = list(inspect.signature(table[name]).parameters)
        if not isinstance(arguments, Mapping) or not set(arguments) <= set(known):
            raise ValueError(f"{kind} {name} has arguments {arguments!r}; it takes {', '.join(known)}")
        made.append(partial(table[name], **arguments))
    return made


class Tracker(BaseCallback):
    """Logs and validates a model at the start, `VALIDATIONS` times a run and at the end, each time with a checkpoint.

    Args:
        run: for log and checkpoints.
        state: the checkpoint from which the model was restored, if any.
    """

    def __init__(self, run: RunFolder, state: Mapping[str, Any] | None = None) -> None:
        super().__init__()
        self.run = run
        self._validated: int = state["timesteps"] if state else -1
        self._resumed = state

    def _init_callback(self) -> None:
        self.model.set_logger(Logger(None, []))

    def _on_training_start(self) -> None:
        if self._resumed is None:
            self._validate()
        else:  # the model has just reset its noise, which the first rollout uses
            vars(self.model)["action_noise"] = self._resumed["action_noise"]

    def _on_rollout_start(self) -> None:
        if self._resumed is not None:
            restore_exploration(self.model, self._resumed)
            self._resumed = None
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
        self.run.validate(exported_network(self.model.policy, self.run.config), self.num_timesteps)
        self._validated = self.num_timesteps
        self.run.save_checkpoint(snapshot(self.model))

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
