"""Save and restore the complete state of a Stable-Baselines3 model, so that a resumed training has the same result."""

from __future__ import annotations

import random
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.distributions import StateDependentNoiseDistribution
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvWrapper

_KEPT = (
    "action_space",
    "num_timesteps",
    "ep_info_buffer",
    "ep_success_buffer",
    "_episode_num",
    "_n_updates",
    "_num_timesteps_at_start",
    "_current_progress_remaining",
    "_last_obs",
    "_last_original_obs",
    "_last_episode_starts",
    "_last_lstm_states",
)
"""Attributes that are saved in addition to the parameters; each algorithm has some of them."""
_DRAWN = ("exploration_mat", "exploration_matrices")
"""Random matrices of state-dependent exploration."""


def snapshot(model: BaseAlgorithm) -> dict[str, Any]:
    """Return networks, optimisers, vehicles, buffer, counters and random generators; pickle them immediately."""
    _, variables = model._get_torch_save_params()
    return {
        "timesteps": model.num_timesteps,
        "parameters": model.get_parameters(),
        "variables": {name: getattr(model, name).detach().clone() for name in variables if hasattr(model, name)},
        "attributes": {name: vars(model)[name] for name in _KEPT if name in vars(model)},
        "experience": _experience(model),
        "action_noise": vars(model).get("action_noise"),
        "exploration": {name: vars(noise)[name].detach() for noise in _noises(model) for name in _DRAWN},
        "vehicles": [_own(layer) for layer in _layers(model.get_env())],
        "numpy": np.random.get_state(),  # noqa: NPY002, Stable-Baselines3 draws from it
        "torch": torch.get_rng_state(),
        "python": random.getstate(),
    }


def restore(model: BaseAlgorithm, state: dict[str, Any]) -> None:
    """Restore the state of `snapshot` in a model of the same configuration."""
    model.set_parameters(state["parameters"], exact_match=True, device="cpu")
    with torch.no_grad():
        for name, value in state["variables"].items():
            getattr(model, name).copy_(value)
    vars(model).update(state["attributes"])
    buffer: Any = getattr(model, "replay_buffer", None)
    if buffer is not None:
        buffer.pos, buffer.full = state["experience"]["pos"], state["experience"]["full"]
        for name, rows in state["experience"]["arrays"].items():
            vars(buffer)[name][: len(rows)] = rows
    for layer, values in zip(_layers(model.get_env()), state["vehicles"], strict=True):
        vars(layer).update(values)
    np.random.set_state(state["numpy"])  # noqa: NPY002
    torch.set_rng_state(state["torch"])
    random.setstate(state["python"])


def restore_exploration(model: BaseAlgorithm, state: Mapping[str, Any]) -> None:
    """Restore the matrices of state-dependent exploration, which a resumed model draws again at its first rollout."""
    for noise in _noises(model):
        vars(noise).update(state["exploration"])
    torch.set_rng_state(state["torch"])


def _noises(model: BaseAlgorithm) -> list[StateDependentNoiseDistribution]:
    """Return a list with the state-dependent exploration of a model; empty if it has none."""
    policy: Any = model.policy
    noise = getattr(getattr(policy, "actor", policy), "action_dist", None)
    return [noise] if isinstance(noise, StateDependentNoiseDistribution) else []


def _experience(model: BaseAlgorithm) -> dict[str, Any] | None:
    """Return the filled part of a replay buffer, None if there is none."""
    buffer: Any = getattr(model, "replay_buffer", None)
    if buffer is None:
        return None
    filled = buffer.buffer_size if buffer.full else buffer.pos
    arrays = {name: value for name, value in vars(buffer).items() if isinstance(value, np.ndarray)}
    return {"pos": buffer.pos, "full": buffer.full, "arrays": {k: v[:filled].copy() for k, v in arrays.items()}}


def _layers(env: VecEnv | None) -> Iterator[VecEnv]:
    """Yield the wrappers of an environment from the outermost to the innermost, then the environment itself."""
    while isinstance(env, VecEnvWrapper):
        yield env
        env = env.venv
    if env is not None:
        yield env


def _own(layer: VecEnv) -> dict[str, Any]:
    """Return the attributes of a layer, without those of a wrapper that cannot be pickled."""
    return {name: value for name, value in vars(layer).items() if name not in ("venv", "class_attributes")}
