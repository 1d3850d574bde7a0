"""The optimiser Muon in single precision.

`torch.optim.Muon` computes in bfloat16. Processors without instructions for it take ten times as long as here.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor

_COEFFICIENTS = (3.4445, -4.7750, 2.0315)
"""Coefficients of the Newton-Schulz iteration, as in the source of `Muon`."""
_ITERATIONS = 5
_LEAST_NORM = 1e-7  # so that a zero matrix stays zero


class Muon(torch.optim.Optimizer):
    """Gradient descent with momentum whose steps are orthogonal matrices, so that all directions have the same weight.

    K. Jordan et al., "Muon: an optimizer for hidden layers in neural networks", 2024
    (https://kellerjordan.github.io/posts/muon).

    Args:
        matrices: the parameters, two-dimensional.
        lr: learning rate; the step of an A x B matrix is longer by sqrt(A / B) if this is above 1.
        weight_decay: decay of the weights in a step, relative to the learning rate.
        momentum: of Nesterov.
    """

    def __init__(self, matrices: Iterable[Tensor], lr: float, weight_decay: float, momentum: float = 0.95) -> None:
        super().__init__(matrices, {"lr": lr, "weight_decay": weight_decay, "momentum": momentum})

    @torch.no_grad()
    def step(self, closure: Any = None) -> None:  # type: ignore[override]
        """Change the parameters that have a gradient; `closure` is not used."""
        for group in self.param_groups:
            lr, momentum = group["lr"], group["momentum"]
            for p in group["params"]:
                if p.grad is None:
                    continue
                state = self.state[p]
                if not state:
                    state["momentum_buffer"] = torch.zeros_like(p)
                mean = state["momentum_buffer"]
                mean.lerp_(p.grad, 1 - momentum)
                p.mul_(1 - lr * group["weight_decay"])
                rows, columns = p.shape
                p.sub_(orthogonalised(p.grad.lerp(mean, momentum)), alpha=lr * math.sqrt(max(1.0, rows / columns)))


def orthogonalised(matrix: Tensor) -> Tensor:
    """Return a matrix with the singular vectors of a given one, and with singular values of about 1 (0.7 to 1.2)."""
    a, b, c = _COEFFICIENTS
    x = matrix / matrix.norm().clamp(min=_LEAST_NORM)
    tall = x.shape[0] > x.shape[1]
    wide: Tensor = x.T if tall else x
    for _ in range(_ITERATIONS):
        square = wide @ wide.T
        wide = torch.addmm(wide, torch.addmm(square, square, square, beta=b, alpha=c), wide, beta=a)
    return wide.T if tall else wide
