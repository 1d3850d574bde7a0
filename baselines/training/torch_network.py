"""The network that the analytic gradient trains: `baselines.networks.Gru` on torch, its weights named alike."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from baselines.networks import ACTIONS, Gru
from baselines.training.closed_loop import TRUTHS

LONGEST_MEMORY = 200.0
"""Control steps that the slowest units of an untrained network remember."""


class TorchGru(nn.Module):
    """A tanh layer, gated recurrent units, a tanh layer and a linear head whose weights begin at zero.

    Before it has learned anything its actions are zero, so it begins as good as its expert.
    """

    def __init__(self, sizes: Gru) -> None:
        super().__init__()
        self.sizes = sizes
        self.encoder = nn.Linear(sizes.inputs, sizes.encoder)
        self.gru = nn.GRUCell(sizes.encoder, sizes.hidden)
        self.decoder = nn.Linear(sizes.hidden, sizes.decoder)
        self.head = nn.Linear(sizes.decoder, ACTIONS)
        self.estimator = nn.Linear(sizes.hidden, TRUTHS)  # used in training alone
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)
        # Forgets over 1 ... LONGEST_MEMORY steps: "chrono initialisation" (Tallec and Ollivier 2018).
        with torch.no_grad():
            times = torch.empty(sizes.hidden).uniform_(1, LONGEST_MEMORY)
            self.gru.bias_hh[sizes.hidden : 2 * sizes.hidden] = times.log()

    def forward(self, x: Tensor, hidden: Tensor) -> tuple[Tensor, Tensor]:
        """Return actions in [-1, 1], shape (N, ACTIONS), and the hidden state (N, hidden), for inputs (N, inputs)."""
        hidden = self.gru(torch.tanh(self.encoder(x)), hidden)
        action = self.head(torch.tanh(self.decoder(hidden)))
        return (torch.tanh(action) if self.sizes.bound == "tanh" else action.clamp(-1.0, 1.0)), hidden

    def weights(self) -> dict[str, NDArray[np.float32]]:
        """Return the weights as `Gru.shapes` names them."""
        return {
            name: tensor.detach().cpu().numpy().copy()
            for name, tensor in self.state_dict().items()
            if not name.startswith("estimator")
        }
