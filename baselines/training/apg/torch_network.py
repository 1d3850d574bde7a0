"""The networks of `baselines.agents.networks` as torch modules for training; the weights have the same names.

The modules only hold the weights; `passes` has the forward and backward pass.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from baselines.agents.networks import OUTPUTS, Gru, Mlp

LONGEST_MEMORY = 200.0
"""Longest time constant of the units of an untrained network, in control steps."""


class TorchGru(nn.Module):
    """A tanh layer, gated recurrent units, a tanh layer and a linear head with zero initial weights.

    The initial corrections are zero, so a training starts with the performance of the expert.
    """

    def __init__(self, sizes: Gru) -> None:
        super().__init__()
        self.sizes = sizes
        self.encoder = nn.Linear(sizes.inputs, sizes.encoder)
        self.gru = nn.GRUCell(sizes.encoder, sizes.hidden)
        self.decoder = nn.Linear(sizes.hidden, sizes.decoder)
        self.head = nn.Linear(sizes.decoder, OUTPUTS)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)
        # Time constants of 1 ... LONGEST_MEMORY steps: "chrono initialisation" (Tallec and Ollivier 2018).
        with torch.no_grad():
            times = torch.empty(sizes.hidden).uniform_(1, LONGEST_MEMORY)
            self.gru.bias_hh[sizes.hidden : 2 * sizes.hidden] = times.log()


class TorchMlp(nn.Module):
    """Tanh layers and a linear head with zero initial weights: a network without memory."""

    def __init__(self, sizes: Mlp) -> None:
        super().__init__()
        self.sizes = sizes
        wide = (sizes.inputs, *sizes.layers, OUTPUTS)
        layers = [nn.Linear(a, b) for a, b in itertools.pairwise(wide)]
        nn.init.zeros_(layers[-1].weight)
        nn.init.zeros_(layers[-1].bias)
        self.layers = nn.ModuleList(layers)


def torch_network(sizes: Gru | Mlp) -> TorchGru | TorchMlp:
    """Return an untrained network of these sizes, with tanh throughout."""
    return TorchGru(sizes) if isinstance(sizes, Gru) else TorchMlp(sizes)


def weights_of(network: nn.Module) -> dict[str, NDArray[np.float32]]:
    """Return the weights by the names of `baselines.agents.networks`."""
    return {name: tensor.detach().cpu().numpy().copy() for name, tensor in network.state_dict().items()}


def put(weights: Mapping[str, NDArray[np.float32]], network: nn.Module) -> None:
    """Set the weights of a network, by the names of `weights_of`; weights of additional last inputs become zero."""
    for name, tensor in network.state_dict().items():  # these tensors share their memory with the parameters
        given = torch.from_numpy(np.array(weights[name]))
        tensor.zero_()
        tensor[..., : given.shape[-1]] = given
