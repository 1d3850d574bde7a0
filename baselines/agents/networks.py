"""Networks of trained agents in NumPy."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array

OUTPUTS = 2  # the corrections of surge and yaw
_LARGEST_LAYER = 4096  # most units of a layer
Weights = Mapping[str, NDArray[Any]]
Shapes = dict[str, tuple[int, ...]]
Layers = tuple[tuple[Array, Array], ...]
"""Linear layers: weight matrix and bias column of each."""

Function = Callable[[Array], Array]
ACTIVATIONS: dict[str, Function] = {"tanh": np.tanh, "relu": lambda x: np.maximum(x, 0.0)}
"""Activation functions of the hidden layers by name."""
_BOUNDS: dict[str, Function] = {"tanh": np.tanh, "clip": lambda x: np.clip(x, -1.0, 1.0)}
"""Functions that bound the output to [-1, 1]."""


@dataclass(frozen=True)
class Gru:
    """A tanh layer, gated recurrent units, a tanh layer and a linear head; units as in `torch.nn.GRUCell`."""

    kind: ClassVar[str] = "gru"
    inputs: int
    encoder: int = 64
    hidden: int = 64
    decoder: int = 64
    bound: str = "tanh"  # one of `_BOUNDS`
    outputs: int = OUTPUTS

    def __post_init__(self) -> None:
        _check_sizes(inputs=self.inputs, encoder=self.encoder, hidden=self.hidden, decoder=self.decoder)
        _check_choice("bound", self.bound, _BOUNDS)

    @property
    def memory(self) -> int:
        """Size of the hidden state."""
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
            **_layer("head", self.decoder, self.outputs),
        }

    def prepared(self, weights: Weights, precision: str = "float64") -> Layers:
        """Return the layers for `forward`; the weights of gates are multiplied by one half.

        The sigmoid of s is (1 + tanh(s / 2)) / 2, and multiplication by one half is exact.
        """
        half = np.repeat((0.5, 1.0), (2 * self.hidden, self.hidden))
        encoder, decoder, head = _columns(weights, ("encoder", "decoder", "head"), precision)
        of_inputs, of_hidden = (
            _column(half[:, None] * weights[f"gru.weight_{side}"], half * weights[f"gru.bias_{side}"], precision)
            for side in ("ih", "hh")
        )
        return encoder, of_inputs, of_hidden, decoder, head

    def forward(self, layers: Layers, x: Array, hidden: Array) -> tuple[Array, Array]:
        """Return actions in [-1, 1], shape (outputs, N), and the hidden state (memory, N).

        Args:
            layers: result of `prepared`.
            x: inputs, shape (inputs, N).
            hidden: as the last call returned it; zero at the start of an episode.
        """
        encoder, of_inputs, of_hidden, decoder, head = layers
        units, split = self.hidden, 2 * self.hidden
        x = _linear(encoder, x)
        given, own = _linear(of_inputs, np.tanh(x, x)), _linear(of_hidden, hidden)
        gates = given[:split]
        gates += own[:split]
        np.tanh(gates, gates)
        gates *= 0.5
        gates += 0.5
        n = gates[:units] * own[split:]
        n += given[split:]
        np.tanh(n, n)
        hidden = hidden - n
        hidden *= gates[units:]
        hidden += n
        x = _linear(decoder, hidden)
        return _BOUNDS[self.bound](_linear(head, np.tanh(x, x))), hidden


@dataclass(frozen=True)
class Mlp:
    """Linear layers with an activation between them, without memory."""

    kind: ClassVar[str] = "mlp"
    inputs: int
    layers: tuple[int, ...] = (64, 64)
    activation: str = "tanh"  # one of `ACTIVATIONS`
    bound: str = "clip"  # one of `_BOUNDS`
    outputs: int = OUTPUTS

    def __post_init__(self) -> None:
        object.__setattr__(self, "layers", tuple(self.layers))
        _check_sizes(inputs=self.inputs, **{f"layers[{i}]": n for i, n in enumerate(self.layers)})
        _check_choice("activation", self.activation, ACTIVATIONS)
        _check_choice("bound", self.bound, _BOUNDS)

    @property
    def memory(self) -> int:
        """Size of the hidden state, 0."""
        return 0

    @property
    def shapes(self) -> Shapes:
        """Shapes of the weights, by name."""
        sizes = (self.inputs, *self.layers, self.outputs)
        shapes: Shapes = {}
        for i, (a, b) in enumerate(itertools.pairwise(sizes)):
            shapes.update(_layer(f"layers.{i}", a, b))
        return shapes

    def prepared(self, weights: Weights, precision: str = "float64") -> Layers:
        """Return the layers for `forward`."""
        return _columns(weights, [f"layers.{i}" for i in range(len(self.layers) + 1)], precision)

    def forward(self, layers: Layers, x: Array, hidden: Array) -> tuple[Array, Array]:
        """Return actions in [-1, 1], shape (outputs, N), and `hidden` unchanged, as `Gru.forward`."""
        *inner, head = layers
        for layer in inner:
            x = ACTIVATIONS[self.activation](_linear(layer, x))
        return _BOUNDS[self.bound](_linear(head, x)), hidden


Network = Gru | Mlp
NETWORKS: dict[str, type[Gru] | type[Mlp]] = {cls.kind: cls for cls in (Gru, Mlp)}
"""Kinds of networks by name."""


def network_record(network: Network) -> dict[str, Any]:
    """Return the kind and the sizes of a network as plain values, without the usual number of outputs."""
    record = {"kind": network.kind, **{f.name: getattr(network, f.name) for f in fields(network)}}
    return record if network.outputs != OUTPUTS else {k: v for k, v in record.items() if k != "outputs"}


def network_of(record: Any) -> Network:
    """Return the network of a record, see `network_record`.

    Raises:
        ValueError: the kind is unknown, or a size is missing, unknown or out of range.
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
        wrong = sorted(set(weights) ^ set(shapes))
        raise ValueError(f"missing or unknown weights: {', '.join(wrong[:3])}")
    for name, shape in shapes.items():
        if weights[name].shape != shape:
            raise ValueError(f"weight {name} has shape {weights[name].shape}; the network needs {shape}")
        if weights[name].dtype.kind != "f" or not np.isfinite(weights[name]).all():
            raise ValueError(f"weight {name} has entries that are not finite numbers")


def _layer(name: str, inputs: int, outputs: int) -> Shapes:
    return {f"{name}.weight": (outputs, inputs), f"{name}.bias": (outputs,)}


def _columns(weights: Weights, names: Iterable[str], precision: str) -> Layers:
    return tuple(_column(weights[f"{name}.weight"], weights[f"{name}.bias"], precision) for name in names)


def _column(weight: Array, bias: Array, precision: str) -> tuple[Array, Array]:
    return np.ascontiguousarray(weight, precision), np.ascontiguousarray(bias[:, None], precision)


def _linear(layer: tuple[Array, Array], x: Array) -> Array:
    weight, bias = layer
    y: Array = np.dot(weight, x)
    y += bias
    return y


def _check_sizes(**sizes: Any) -> None:
    for name, size in sizes.items():
        if isinstance(size, bool) or not isinstance(size, int) or not 1 <= size <= _LARGEST_LAYER:
            raise ValueError(f"network {name} is {size!r}; it must be an integer in [1, {_LARGEST_LAYER}]")


def _check_choice(name: str, value: Any, allowed: Mapping[str, Any]) -> None:
    if value not in list(allowed):
        raise ValueError(f"network {name} is {value!r}; allowed are {', '.join(allowed)}")
