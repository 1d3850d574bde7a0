"""The ways of teacher and student through a window, see `baselines.training.apg.passes`."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from baselines.agents.networks import Layers, Rma, Weights
from baselines.training.apg.passes import MlpPass, Tape
from baselines.training.rma.torch_networks import Teacher


class TeacherPass:
    """A `Pass` through a teacher, whose latent is computed for the whole window at once.

    Attributes:
        extrinsics: of the window, to be set before it runs, shape (T, rows, N).
    """

    extrinsics: Tensor

    def __init__(self, teacher: Teacher, tape: Tape) -> None:
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

    def __init__(self, student: Student, tape: Tape) -> None:
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
