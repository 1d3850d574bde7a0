"""The networks that trained agents are made of, run on NumPy alone."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from baselines.policy import Array

ACTIONS = 2  # outputs: the corrections of surge and yaw
LARGEST = 4096
"""Most units of a layer."""
Weights = Mapping[str, NDArray[Any]]
Shapes = dict[str, tuple[int, ...]]

Function = Callable[[Array], Array]
ACTIVATIONS: dict[str, Function] = {"tanh": np.tanh, "relu": lambda x: np.maximum(x, 0.0)}  # of the layers
BOUNDS: dict[str, Function] = {"tanh": np.tanh, "clip": lambda x: np.clip(x, -1.0, 1.0)}
"""What keeps the output in [-1, 1]."""


@dataclass(frozen=True)
class Gru:
    """A tanh layer, gated recurrent units, a tanh layer and a linear head; units as in `torch.nn.GRUCell`."""

    kind: ClassVar[str] = "gru"
    inputs: int
    encoder: int = 64
    hidden: int = 64
    decoder: int = 64
    bound: str = "tanh"  # one of `BOUNDS`

    def __post_init__(self) -> None:
        _check_sizes(inputs=self.inputs, encoder=self.encoder, hidden=self.hidden, decoder=self.decoder)
        _check_choice("bound", self.bound, BOUNDS)

    @property
    def memory(self) -> int:
        """Numbers that are remembered from one control instant to the next."""
        return self.hidden

    @property
    def shapes(self) -> Shapes:
        """Shapes of the weights, by name."""
        return {
            **_layer("encoder", self.inputs, self.encoder),
            "gru.weight_ih": (3 * self.hidden, self.encoder),
            "gru.weight_hh": (3 * self.hidden, self.hidden),
            "gru.bias_ih": (3 * self.hidden,),
            "gru.bias_hh": (3 * self.hidden,),
            **_layer("decoder", self.hidden, self.decoder),
            **_layer("head", self.decoder, ACTIONS),
        }

    def forward(self, w: Weights, x: Array, hidden: Array) -> tuple[Array, Array]:
        """Return actions in [-1, 1], shape (ACTIONS, N), and the hidden state (memory, N).

        Args:
            w: what `in_columns` gives.
            x: inputs, shape (inputs, N).
            hidden: as the last call returned it; zero at an episode's start.
        """
        x = _linear(w, "encoder", x)
        given, own = w["gru.weight_ih"] @ np.tanh(x, out=x), w["gru.weight_hh"] @ hidden
        given += w["gru.bias_ih"]
        own += w["gru.bias_hh"]
        split = 2 * self.hidden
        gates = given[:split]
        gates += own[:split]
        gates *= 0.5
        np.tanh(gates, out=gates)
        gates *= 0.5
        gates += 0.5  # the sigmoid
        n = gates[: self.hidden] * own[split:]
        n += given[split:]
        np.tanh(n, out=n)
        hidden = hidden - n
        hidden *= gates[self.hidden :]
        hidden += n
        x = _linear(w, "decoder", hidden)
        return BOUNDS[self.bound](_linear(w, "head", np.tanh(x, out=x))), hidden


@dataclass(frozen=True)
class Mlp:
    """Layers with an activation between them, without memory."""

    kind: ClassVar[str] = "mlp"
    inputs: int
    layers: tuple[int, ...] = (64, 64)
    activation: str = "tanh"  # one of `ACTIVATIONS`
    bound: str = "clip"  # one of `BOUNDS`

    def __post_init__(self) -> None:
        object.__setattr__(self, "layers", tuple(self.layers))
        _check_sizes(inputs=self.inputs, **{f"layers[{i}]": n for i, n in enumerate(self.layers)})
        _check_choice("activation", self.activation, ACTIVATIONS)
        _check_choice("bound", self.bound, BOUNDS)

    @property
    def memory(self) -> int:
        """Numbers that are remembered: none."""
        return 0

    @property
    def shapes(self) -> Shapes:
        """Shapes of the weights, by name."""
        sizes = (self.inputs, *self.layers, ACTIONS)
        shapes: Shapes = {}
        for i, (a, b) in enumerate(itertools.pairwise(sizes)):
            shapes.update(_layer(f"layers.{i}", a, b))
        return shapes

    def forward(self, w: Weights, x: Array, hidden: Array) -> tuple[Array, Array]:
        """Return actions in [-1, 1], shape (ACTIONS, N), and `hidden` untouched, as `Gru.forward`."""
        for i in range(len(self.layers)):
            x = ACTIVATIONS[self.activation](_linear(w, f"layers.{i}", x))
        return BOUNDS[self.bound](_linear(w, f"layers.{len(self.layers)}", x)), hidden


Network = Gru | Mlp
NETWORKS: dict[str, type[Gru] | type[Mlp]] = {cls.kind: cls for cls in (Gru, Mlp)}
"""Kinds of networks by name."""


def network_record(network: Network) -> dict[str, Any]:
    """Return a network's kind and sizes as plain values."""
    return {"kind": network.kind, **{f.name: getattr(network, f.name) for f in fields(network)}}


def network_of(record: Any) -> Network:
    """Return the network of what `network_record` returned.

    Raises:
        ValueError: the kind is unknown, a size is missing, unknown or out of range.
    """
    if not isinstance(record, Mapping) or record.get("kind") not in list(NETWORKS):
        raise ValueError(f"network is {record!r}; it must be a table whose kind is one of {', '.join(NETWORKS)}")
    cls, sizes = NETWORKS[record["kind"]], {key: value for key, value in record.items() if key != "kind"}
    try:
        return cls(**sizes)
    except TypeError as error:
        raise ValueError(
            f"network is {dict(record)!r}; its sizes are {', '.join(f.name for f in fields(cls))}"
        ) from error


def check_weights(network: Network, weights: Weights) -> None:
    """Raise ValueError if weights are missing, too many, of another shape, or not finite."""
    shapes = network.shapes
    if set(weights) != set(shapes):
        odd = sorted(set(weights) ^ set(shapes))
        raise ValueError(f"the weights differ from the network's in {', '.join(odd[:3])}")
    for name, shape in shapes.items():
        if weights[name].shape != shape:
            raise ValueError(f"weight {name} has shape {weights[name].shape}; the network needs {shape}")
        if weights[name].dtype.kind != "f" or not np.isfinite(weights[name]).all():
            raise ValueError(f"weight {name} has entries that are not finite numbers")


def in_columns(weights: Weights, precision: str = "float64") -> Weights:
    """Return weights as `forward` takes them: numbers of a precision, and biases as columns."""
    return {
        name: np.ascontiguousarray(w[:, None] if w.ndim == 1 else w, dtype=precision) for name, w in weights.items()
    }


def _layer(name: str, inputs: int, outputs: int) -> Shapes:
    return {f"{name}.weight": (outputs, inputs), f"{name}.bias": (outputs,)}


def _linear(w: Weights, name: str, x: Array) -> Array:
    y: Array = w[f"{name}.weight"] @ x
    y += w[f"{name}.bias"]
    return y


def _check_sizes(**sizes: Any) -> None:
    for name, size in sizes.items():
        if isinstance(size, bool) or not isinstance(size, int) or not 1 <= size <= LARGEST:
            raise ValueError(f"network {name} is {size!r}; it must be an integer in [1, {LARGEST}]")


def _check_choice(name: str, value: Any, allowed: Mapping[str, Any]) -> None:
    if value not in list(allowed):
        raise ValueError(f"network {name} is {value!r}; allowed are {', '.join(allowed)}")
