"""Training with Stable-Baselines3: PPO, SAC, TD3 and TQC on the native vector environment."""

from __future__ import annotations

import inspect
import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from sb3_contrib import TQC
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, CallbackList
from stable_baselines3.common.noise import ActionNoise, NormalActionNoise
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecMonitor

from auv_gym.residual import VectorResidualAction
from baselines.agent import Agent
from baselines.training.callbacks import FrozenActor, ZeroCorrection
from baselines.training.config import Config
from baselines.training.run import Run, TrainingError
from baselines.training.sb3 import SB3VecEnv
from baselines.training.snapshot import restore
from baselines.training.tracker import Tracker, sound
from baselines.training.vec_features import VecFeatures

MODELS: Mapping[str, type[BaseAlgorithm]] = {"ppo": PPO, "sac": SAC, "td3": TD3, "tqc": TQC}
CALLBACKS: Mapping[str, type[BaseCallback]] = {
    f"{cls.__module__}.{cls.__name__}": cls for cls in (ZeroCorrection, FrozenActor)
}
WRAPPER = f"{VecFeatures.__module__}.{VecFeatures.__name__}"
_OURS = {"self", "policy", "env", "seed", "device", "verbose", "tensorboard_log", "_init_setup_model"}
_SCHEDULED = ("learning_rate", "clip_range", "clip_range_vf")


def check(config: Config) -> None:
    """Raise ValueError if a configuration cannot be trained."""
    make_model(config)
    _callbacks(config.hyperparameters.get("callback", []))


def train(run: Run) -> Agent:
    """Train as a run's configuration says, from its checkpoint if it has one; return the agent that validated best.

    Raises:
        OSError: the run's folder cannot be written to.
        TrainingError: the networks' weights have diverged.
    """
    config = run.config
    state = run.load_checkpoint()
    model = make_model(config)
    if state is not None:
        restore(model, state)
    tracker = Tracker(run, state)
    rest = config.timesteps - model.num_timesteps
    callbacks = CallbackList([*_callbacks(config.hyperparameters.get("callback", [])), tracker])
    if rest > 0:
        try:
            model.learn(rest, callbacks, log_interval=None, reset_num_timesteps=state is None)  # type: ignore[arg-type]
        except ValueError as error:  # torch refuses a distribution of numbers that are not finite
            if sound(model):
                raise
            raise TrainingError(f"training diverged after {model.num_timesteps} steps: lower learning_rate") from error
    return tracker.agent


def make_model(config: Config) -> BaseAlgorithm:
    """Return the untrained model of a configuration, with its environment.

    Raises:
        ValueError: a hyper-parameter is unknown or impossible.
    """
    cls, values = MODELS[config.algo], dict(config.hyperparameters)
    values.pop("callback", None)
    if (wrapper := values.pop("vec_env_wrapper", WRAPPER)) != WRAPPER:
        raise ValueError(f"hyper-parameter vec_env_wrapper is {wrapper!r}; here it must be {WRAPPER}")
    if (policy := values.pop("policy", "MlpPolicy")) != "MlpPolicy":
        raise ValueError(f"hyper-parameter policy is {policy!r}; here it must be MlpPolicy")
    n_envs, noise = values.pop("n_envs", 1), _noise(values)
    allowed = sorted(set(inspect.signature(cls).parameters) - _OURS)
    if unknown := [name for name in values if name not in allowed]:
        raise ValueError(f"unknown hyper-parameter {unknown[0]!r} of {config.algo}; allowed are {', '.join(allowed)}")
    env = make_training_env(config, n_envs)
    if noise is not None:
        values["action_noise"] = noise
    values |= {name: _schedule(name, values[name]) for name in _SCHEDULED if name in values}
    if isinstance(values.get("train_freq"), list):
        values["train_freq"] = tuple(values["train_freq"])
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", UserWarning)
            model = cls(policy, env, seed=config.seed, device="cpu", **values)
    except (AssertionError, AttributeError, KeyError, TypeError, ValueError, UserWarning) as error:
        raise ValueError(f"hyper-parameters of {config.algo}: {' '.join(str(error).split())}") from error
    env.seed(config.episode_seed)
    return model


def make_training_env(config: Config, n_envs: int) -> VecFeatures:
    """Return the vehicles that a configuration is trained on, as Stable-Baselines3 wants them."""
    if isinstance(n_envs, bool) or not isinstance(n_envs, int) or n_envs < 1:
        raise ValueError(f"hyper-parameter n_envs is {n_envs!r}; it must be an integer of at least 1")
    track = gym.make_vec(
        "auv_gym:UnderactuatedAUVTrack-v0",
        num_envs=n_envs,
        vectorization_mode="vector_entry_point",
        scenario=config.lanes(n_envs),
    )
    return VecFeatures(VecMonitor(SB3VecEnv(VectorResidualAction(track, config.make_expert(), config.authority))))


def _schedule(name: str, value: Any) -> Any:
    """Return a hyper-parameter as Stable-Baselines3 wants it: a number, or lin_NUMBER that falls to zero."""
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
    """Take rl_zoo3's two entries about noise on the action out of the hyper-parameters; return the noise."""
    kind, std = values.pop("noise_type", None), values.pop("noise_std", 0.0)
    if kind is None:
        return None
    if kind != "normal" or isinstance(std, bool) or not isinstance(std, (int, float)) or not std >= 0:
        raise ValueError(f"noise is {kind!r} of noise_std {std!r}; it must be normal, of a number of at least 0")
    return NormalActionNoise(np.zeros(2), np.full(2, float(std)))


def _callbacks(entries: Any) -> Sequence[BaseCallback]:
    """Return the callbacks that a configuration names, in rl_zoo3's way: names, or tables of a name's arguments.

    Training always starts at the expert, named or not.
    """
    made: list[BaseCallback] = []
    for entry in entries if isinstance(entries, (list, tuple)) else [entries]:
        name, arguments = next(iter(entry.items())) if isinstance(entry, Mapping) and len(entry) == 1 else (entry, {})
        if name not in CALLBACKS:
            raise ValueError(f"unknown callback {name!r}; allowed are {', '.join(CALLBACKS)}")
        try:
            made.append(CALLBACKS[name](**arguments))
        except TypeError as error:
            raise ValueError(f"callback {name}: {error}") from error
    return made if any(isinstance(callback, ZeroCorrection) for callback in made) else [ZeroCorrection(), *made]
