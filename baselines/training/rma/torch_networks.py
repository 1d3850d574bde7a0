"""The teacher that is told the extrinsics, and the student's filters, as torch modules."""

from __future__ import annotations

from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.agents.networks import FILTERS, Rma
from baselines.training.apg.torch_network import TorchMlp
from baselines.training.rma.extrinsics import EXTRINSICS


class Teacher(nn.Module):
    """Two tanh layers from the extrinsics to the latent, and the layers that act on features and latent."""

    def __init__(self, sizes: Rma, units: int) -> None:
        """Make the untrained teacher, whose actions are zero; `units` are those of the encoder's first layer."""
        super().__init__()
        self.sizes = sizes.acting
        self.encoder = nn.Sequential(
            nn.Linear(len(EXTRINSICS), units), nn.Tanh(), nn.Linear(units, sizes.latent), nn.Tanh()
        )
        self.acting = TorchMlp(sizes.acting)

    def latent(self, extrinsics: Tensor) -> Tensor:
        """Return the latent, shape (T, latent, N), of extrinsics (T, rows, N)."""
        latent: Tensor = self.encoder(extrinsics.transpose(1, 2))
        return latent.transpose(1, 2)


class Filters(nn.Module):
    """The layers of `networks.Rma` that estimate the latent; weights named and shaped as there."""

    def __init__(self, sizes: Rma) -> None:
        super().__init__()
        self.sizes = sizes
        self.embedding = nn.Linear(sizes.inputs, sizes.channels)
        outputs = [sizes.channels] * (len(FILTERS) - 1) + [sizes.latent]
        pairs = zip(FILTERS, outputs, strict=True)
        self.filters = nn.ModuleList(nn.Linear(instants * sizes.channels, out) for (instants, _), out in pairs)
        self._layers = cast("list[nn.Linear]", list(self.filters))

    def forward(self, features: Tensor, hidden: Tensor) -> Tensor:
        """Return the estimates of a window, shape (T, latent, N).

        Args:
            features: of its T steps, shape (T, inputs, N).
            hidden: what `Rma.forward` remembered before it, shape (memory, N).
        """
        given = torch.tanh(self.embedding(features.permute(2, 0, 1))).transpose(1, 2)  # (N, channels, T)
        pasts = torch.split(hidden, list(self.sizes.kept))
        for (instants, apart), layer, past in zip(FILTERS, self._layers, pasts, strict=True):
            before = past.view(-1, self.sizes.channels, past.shape[-1]).permute(2, 1, 0)
            weight = layer.weight.view(len(layer.weight), instants, -1).transpose(1, 2)
            sums = functional.conv1d(torch.cat((before, given), -1), weight, layer.bias, dilation=apart)
            given = torch.tanh(sums)
        return given.permute(2, 1, 0)
