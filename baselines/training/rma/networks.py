"""The teacher that knows the extrinsics, the student's filters, and the ways of both through a window.

See `baselines.training.apg.passes` for what such a way is.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from baselines.agents.networks import FILTERS, Layers, Rma, Weights
from baselines.training.apg.passes import MlpPass, NetworkTape
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


class TeacherPass:
    """A `Pass` through a teacher, whose latent is computed for the whole window at once.

    Attributes:
        extrinsics: of the window, to be set before it runs, shape (T, rows, N).
    """

    extrinsics: Tensor

    def __init__(self, teacher: Teacher, tape: NetworkTape) -> None:
        self._teacher, self._tape, self._features = teacher, tape, tape.inputs.shape[1]
        steps, _, n = tape.inputs.shape
        inputs = teacher.sizes.inputs
        self._seen, self._d_seen = tape.inputs.new_zeros(steps, inputs, n), tape.inputs.new_zeros(inputs, n)
        self._d_latent = tape.inputs.new_zeros(steps, inputs - self._features, n)
        self._acting = MlpPass(teacher.acting, tape._replace(inputs=self._seen, d_inputs=self._d_seen))

    def begin(self) -> None:
        """See `Pass`."""
        with torch.enable_grad():
            self._latent = self._teacher.latent(self.extrinsics)
        self._seen[:, self._features :] = self._latent.detach()
        self._acting.begin()

    def forward(self, k: int) -> None:
        """See `Pass`."""
        self._seen[k, : self._features] = self._tape.inputs[k]
        self._acting.forward(k)

    def backward(self, k: int) -> None:
        """See `Pass`."""
        self._acting.backward(k)
        self._tape.d_inputs.copy_(self._d_seen[: self._features])
        self._d_latent[k] = self._d_seen[self._features :]

    def finish(self) -> None:
        """See `Pass`."""
        self._acting.finish()
        self._teacher.encoder.zero_grad()
        torch.autograd.backward(self._latent, self._d_latent)


@dataclass
class Student:
    """An agent's own network, which runs on NumPy."""

    sizes: Rma
    weights: Weights = field(default_factory=dict)  # to be set before a window runs


class StudentPass:
    """A `Pass` forward through a student, which keeps what it has seen and remembered."""

    def __init__(self, student: Student, tape: NetworkTape) -> None:
        self.student, self._tape = student, tape
        self._layers: Layers = ()

    @property
    def seen(self) -> Tensor:
        """The features of the window, shape (T, inputs, N)."""
        return self._tape.inputs

    @property
    def remembered(self) -> Tensor:
        """What was remembered before the window, shape (memory, N)."""
        return self._tape.hidden[0]

    def begin(self) -> None:
        """See `Pass`."""
        self._layers = self.student.sizes.prepared(self.student.weights, "float32")

    def forward(self, k: int) -> None:
        """See `Pass`."""
        tape = self._tape
        action, hidden = self.student.sizes.forward(self._layers, tape.inputs[k].numpy(), tape.hidden[k].numpy())
        tape.corrections[k + 1], tape.hidden[k + 1] = torch.from_numpy(action), torch.from_numpy(hidden)

    def backward(self, k: int) -> None:
        """Nothing: a student's policy is not trained."""

    def finish(self) -> None:
        """Nothing: a student's policy is not trained."""
