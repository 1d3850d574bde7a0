"""Convert the deterministic actor of a Stable-Baselines3 model to an agent that runs on NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor, nn

from baselines.agents.agent import Agent
from baselines.agents.networks import Lstm, Mlp
from baselines.training.config import Config

_ACTIVATIONS: dict[type, str] = {nn.Tanh: "tanh", nn.ReLU: "relu"}


def exported_network(policy: Any, config: Config) -> Agent:
    """Return the agent of a policy network of PPO, recurrent PPO, SAC, TQC, TD3 or ARS, or of similar ones.

    Raises:
        ValueError: the actor has other layers than linear ones with tanh or ReLU between them, after at most one layer
            of long short-term memory; CrossQ has others.
    """
    chain, bound = _actor(policy)
    linear = [layer for layer in chain if isinstance(layer, nn.Linear)]
    between = {_ACTIVATIONS.get(type(layer)) for layer in chain if not isinstance(layer, nn.Linear)} or {"tanh"}
    if not linear or len(between) != 1 or None in between or len(chain) != 2 * len(linear) - 1:
        raise ValueError(
            "the actor must consist of linear layers with tanh or ReLU between them; with use_sde set clip_mean to 0 "
            "in policy_kwargs"
        )
    sizes, activation = tuple(layer.out_features for layer in linear[:-1]), str(between.pop())
    weights: dict[str, NDArray[Any]] = {}
    for i, layer in enumerate(linear):
        for name, value in layer.named_parameters():
            weights[f"layers.{i}.{name}"] = _array(value)
    memory = getattr(policy, "lstm_actor", None)
    if memory is None:
        network: Lstm | Mlp = Mlp(linear[0].in_features, sizes, activation, bound)
    else:
        network = Lstm(memory.input_size, memory.hidden_size, sizes, activation, bound)
        weights |= _lstm_weights(memory)
    return Agent(network, weights, config.expert, config.authority, config.names)


def _lstm_weights(memory: nn.LSTM) -> dict[str, NDArray[Any]]:
    """Return the weights of a long short-term memory, with the sum of its two biases.

    Raises:
        ValueError: it has several layers, or another form than `networks.Lstm`.
    """
    if memory.num_layers != 1 or not memory.bias or memory.bidirectional or memory.proj_size:
        raise ValueError("the actor's memory must be one layer: set n_lstm_layers to 1, and leave out lstm_kwargs")
    values = {name.removesuffix("_l0"): _array(value) for name, value in memory.named_parameters()}
    bias = values.pop("bias_ih") + values.pop("bias_hh")
    return {"lstm.bias": bias, **{f"lstm.{name}": value for name, value in values.items()}}


def _array(value: Tensor) -> NDArray[Any]:
    return np.array(value.detach().cpu().numpy())


def _actor(policy: Any) -> tuple[list[nn.Module], str]:
    """Return the layers from the features to the mean action, and the name of its bound, see `networks._BOUNDS`."""
    if hasattr(policy, "mlp_extractor"):  # PPO, recurrent or not
        return [*policy.mlp_extractor.policy_net, policy.action_net], "clip"
    actor = getattr(policy, "actor", policy)
    if hasattr(actor, "latent_pi"):  # SAC and TQC
        return [*actor.latent_pi, actor.mu], "tanh"
    layers = list(getattr(actor, "mu", getattr(actor, "action_net", ())))  # TD3 and ARS
    squashed = bool(layers) and isinstance(layers[-1], nn.Tanh)
    return (layers[:-1], "tanh") if squashed else (layers, "clip")
