"""The networks of `baselines.agents.networks` for training: torch modules, and their passes through a window.

A module only holds the weights, which have the same names. Its forward and backward pass run through a window step by
step, with matrix products of torch. The last axis of all arrays is that of the N vehicles, as in the kernels. The
gradients of the weights are sums of products over all steps.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from functools import cache
from typing import NamedTuple, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from auv_gym.codegen.derivatives import gradient
from auv_gym.codegen.graph import Symbol
from auv_gym.codegen.kernel import Kernel
from baselines.agents.networks import Gru, Mlp

_tanh_back = torch.ops.aten.tanh_backward.grad_input  # (d_y, y, grad_input=d_x) of y = tanh(x)
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
        self.head = nn.Linear(sizes.decoder, sizes.outputs)
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
        wide = (sizes.inputs, *sizes.layers, sizes.outputs)
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
        values = torch.from_numpy(np.array(weights[name]))
        tensor.zero_()
        tensor[..., : values.shape[-1]] = values


class NetworkArrays(NamedTuple):
    """Inputs and outputs of a network in a window of T steps."""

    inputs: Tensor  # shape (T, inputs, N)
    hidden: Tensor  # shape (T + 1, memory, N)
    corrections: Tensor  # shape (T + 1, OUTPUTS, N)
    d_inputs: Tensor  # derivatives of the loss with respect to the inputs of a step, shape (inputs, N)
    d_correction: Tensor  # with respect to the correction of a step, shape (OUTPUTS, N)


@cache
def gates_back(precision: str) -> Kernel:
    """Return the adjoint kernel of gated recurrent units, h' = n + z (h - n).

    `gates` are r, z, n and m: reset gate, update gate, candidate n = tanh(i + r m), and m. `d_gates` are the
    derivatives with respect to the arguments of the sigmoids of r and z, to i, and to m.
    """

    def equation(gates: list[Symbol], hidden: list[Symbol], d_hidden: list[Symbol]) -> dict[str, list[Symbol]]:
        r, z, n, m = gates
        following = n + z * (hidden[0] - n)
        d_z, d_n, d_h = gradient([following], d_hidden, (z, n, hidden[0]))
        d_i = d_n * (1.0 - n * n)
        return {"d_gates": [d_i * m * (r * (1.0 - r)), d_z * (z * (1.0 - z)), d_i, d_i * r], "d_hidden": [d_h]}

    rows = {"gates": 4, "hidden": 1, "d_hidden": 1}
    return Kernel.traced(equation, rows, ("gates", "hidden", "d_gates"), precision=precision)


class Layer:
    """A linear layer with tanh, y = tanh(W x + b), at each step.

    Args:
        layer: weights and bias.
        x: inputs, shape (T, inputs, N).
        y: outputs, shape (T, outputs, N).
        d_x: output for the derivatives with respect to the inputs of a step, shape (inputs, N).
    """

    def __init__(self, layer: nn.Linear, x: Tensor, y: Tensor, d_x: Tensor | None = None) -> None:
        self._layer, self._x, self.d_x = layer, x, torch.empty_like(x[0]) if d_x is None else d_x
        self.d_y = torch.empty_like(y[0])
        self.d_sums = torch.empty_like(y)  # derivatives with respect to W x + b
        self._weight, self._bias = layer.weight.detach(), layer.bias.detach()[:, None]
        self._transposed, self._xs, self._ys = self._weight.t(), x.unbind(), y.unbind()
        self._ds = self.d_sums.unbind()

    def forward(self, k: int) -> None:
        """Compute y of step k."""
        torch.addmm(self._bias, self._weight, self._xs[k], out=self._ys[k]).tanh_()

    def backward(self, k: int, d_y: Tensor) -> None:
        """Compute `d_sums` of step k."""
        _tanh_back(d_y, self._ys[k], grad_input=self._ds[k])

    def through(self, k: int) -> Tensor:
        """Return `d_x` of step k, after `backward`."""
        return torch.mm(self._transposed, self._ds[k], out=self.d_x)

    def finish(self) -> None:
        """Set the gradients of W and b."""
        self._layer.weight.grad = _products(self.d_sums, self._x)
        self._layer.bias.grad = self.d_sums.sum((0, 2))


class GruPass:
    """Forward and backward pass of a `TorchGru` through a window."""

    def __init__(self, network: TorchGru, arrays: NetworkArrays) -> None:
        (steps, _, n), sizes = arrays.inputs.shape, network.sizes
        encoded, decoded, gates, self._d_gates = (
            arrays.inputs.new_empty(steps, rows, n)
            for rows in (sizes.encoder, sizes.decoder, 4 * sizes.hidden, 4 * sizes.hidden)
        )
        self._gru, self._units, self._encoded, self._hidden = network.gru, sizes.hidden, encoded, arrays.hidden
        self.d_hidden = arrays.inputs.new_empty(sizes.hidden, n)  # derivatives for the state of the current step
        self._d_correction = arrays.d_correction
        self._encoder = Layer(network.encoder, arrays.inputs, encoded, arrays.d_inputs)
        self._decoder = Layer(network.decoder, arrays.hidden[1:], decoded)
        self._head = Layer(network.head, decoded, arrays.corrections[1:])
        self._forward = [
            (*rows, *_parts(g)) for *rows, g in zip(encoded, arrays.hidden[:-1], arrays.hidden[1:], gates, strict=True)
        ]
        self._backward = [_parts(g) for g in self._d_gates]
        self._gates_back = gates_back(str(gates.dtype).removeprefix("torch.")).bound(
            gates=gates.view(steps, 4, -1).numpy(),
            hidden=arrays.hidden[:-1].view(steps, 1, -1).numpy(),
            d_gates=self._d_gates.view(steps, 4, -1).numpy(),
            d_hidden=self.d_hidden.view(1, -1).numpy(),
        )

    def begin(self) -> None:
        """Read the current weights."""
        split = 2 * self._units
        self._of_inputs, of_hidden = self._gru.weight_ih.detach(), self._gru.weight_hh.detach()
        self._of_hidden, self._of_memory = of_hidden[:split], of_hidden[split:]
        bias = self._gru.bias_hh.detach()
        shared = torch.cat((bias[:split], torch.zeros_like(bias[split:])))
        self._bias, self._memory_bias = (self._gru.bias_ih.detach() + shared)[:, None], bias[split:, None]
        self.d_hidden.zero_()

    def forward(self, k: int) -> None:
        """Compute correction and hidden state k + 1 from inputs and hidden state k."""
        self._encoder.forward(k)
        x, hidden, following, sums, shared, (r, z, n, m) = self._forward[k]
        torch.addmm(self._bias, self._of_inputs, x, out=sums)
        shared.addmm_(self._of_hidden, hidden).sigmoid_()
        torch.addmm(self._memory_bias, self._of_memory, hidden, out=m)
        n.addcmul_(r, m).tanh_()
        torch.lerp(n, hidden, z, out=following)
        self._decoder.forward(k)
        self._head.forward(k)

    def backward(self, k: int) -> None:
        """Compute the derivatives with respect to the inputs of step k; call it from the last step to the first."""
        self._head.backward(k, self._d_correction)
        self._decoder.backward(k, self._head.through(k))
        self.d_hidden.add_(self._decoder.through(k))
        self._gates_back(k, 1)
        d_sums, d_shared, (*_, d_m) = self._backward[k]
        self.d_hidden.addmm_(self._of_hidden.t(), d_shared).addmm_(self._of_memory.t(), d_m)
        torch.mm(self._of_inputs.t(), d_sums, out=self._encoder.d_y)
        self._encoder.backward(k, self._encoder.d_y)
        self._encoder.through(k)

    def finish(self) -> None:
        """Set the gradients of the weights, summed over the window."""
        for layer in (self._encoder, self._decoder, self._head):
            layer.finish()
        split, before = 3 * self._units, self._hidden[:-1]
        d_sums, d_m = self._d_gates[:, :split], self._d_gates[:, split:]
        d_shared = d_sums[:, : 2 * self._units]
        gru, bias = self._gru, self._d_gates.sum((0, 2))
        gru.weight_ih.grad = _products(d_sums, self._encoded)
        gru.weight_hh.grad = torch.cat((_products(d_shared, before), _products(d_m, before)))
        gru.bias_ih.grad, gru.bias_hh.grad = bias[:split], torch.cat((bias[: 2 * self._units], bias[split:]))


class MlpPass:
    """Forward and backward pass of a `TorchMlp` through a window."""

    def __init__(self, network: TorchMlp, arrays: NetworkArrays) -> None:
        self._d_correction, (steps, _, n) = arrays.d_correction, arrays.inputs.shape
        self.d_hidden = arrays.inputs.new_empty(0, n)
        wide = [arrays.inputs.new_empty(steps, size, n) for size in network.sizes.layers]
        values = (arrays.inputs, *wide, arrays.corrections[1:])
        self._layers = [
            Layer(cast(nn.Linear, layer), x, y, None if i else arrays.d_inputs)
            for i, (layer, (x, y)) in enumerate(zip(network.layers, itertools.pairwise(values), strict=True))
        ]

    def begin(self) -> None:
        """See `GruPass`."""

    def forward(self, k: int) -> None:
        """See `GruPass`."""
        for layer in self._layers:
            layer.forward(k)

    def backward(self, k: int) -> None:
        """See `GruPass`."""
        d_y = self._d_correction
        for layer in reversed(self._layers):
            layer.backward(k, d_y)
            d_y = layer.through(k)

    def finish(self) -> None:
        """See `GruPass`."""
        for layer in self._layers:
            layer.finish()


def _parts(gates: Tensor) -> tuple[Tensor, Tensor, list[Tensor]]:
    """Return views of the gates r, z, n, m: the first three together, the first two together, and each of the four."""
    *three, last = gates.chunk(4)
    return gates[: -len(last)], gates[: 2 * len(last)], [*three, last]


def _products(d_y: Tensor, x: Tensor) -> Tensor:
    """Return the sum of d_y x^T over the steps."""
    return torch.addbmm(d_y.new_empty(d_y.shape[1], x.shape[1]), d_y, x.transpose(1, 2), beta=0)
