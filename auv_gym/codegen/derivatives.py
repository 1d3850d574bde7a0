"""Derivatives of a graph as nodes of the same graph: reverse mode for gradients, forward mode for Jacobians."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from auv_gym.codegen.graph import SYMBOLS, TRUTHS, Graph, Symbol, arguments_of

Pullback = tuple[Any, ...]
"""The contribution of an operation to the adjoint of each of its arguments; None where the derivative is zero."""


def _clip(_y: Symbol, a: Sequence[Symbol], g: Symbol) -> Pullback:
    x, low, high = a
    inside = SYMBOLS.where(x < low, 0.0, SYMBOLS.where(x > high, 0.0, g))
    below = None if low.value is not None else SYMBOLS.where(x < low, g, 0.0)
    above = None if high.value is not None else SYMBOLS.where(x < low, 0.0, SYMBOLS.where(x > high, g, 0.0))
    return inside, below, above


PULLBACKS: dict[str, Callable[[Symbol, Sequence[Symbol], Symbol], Pullback]] = {
    "add": lambda _y, _a, g: (g, g),
    "sub": lambda _y, _a, g: (g, -g),
    "mul": lambda _y, a, g: (g * a[1], g * a[0]),
    "div": lambda y, a, g: (g / a[1], -(g * y) / a[1]),
    "neg": lambda _y, _a, g: (-g,),
    "abs": lambda _y, a, g: (SYMBOLS.where(a[0] < 0.0, -g, SYMBOLS.where(a[0] > 0.0, g, 0.0)),),
    "sin": lambda _y, a, g: (g * SYMBOLS.cos(a[0]),),
    "cos": lambda _y, a, g: (-(g * SYMBOLS.sin(a[0])),),
    "exp": lambda y, _a, g: (g * y,),
    "log": lambda _y, a, g: (g / a[0],),
    "sqrt": lambda y, _a, g: (0.5 * g / y,),
    "arctan2": lambda _y, a, g: (
        g * a[1] / (a[0] * a[0] + a[1] * a[1]),
        -(g * a[0]) / (a[0] * a[0] + a[1] * a[1]),
    ),
    "floor": lambda _y, _a, _g: (None,),
    "single": lambda _y, _a, g: (g,),
    "clip": _clip,
    "where": lambda _y, a, g: (None, SYMBOLS.where(a[0], g, 0.0), SYMBOLS.where(a[0], 0.0, g)),
}
"""For each operation y = f(a) the function of y, a and the adjoint g of y that returns g times the derivatives of f.

The derivatives are in the order of the arguments. At a kink they are those of torch: 0 for |0|, 1 at the ends of
`clip`."""


def gradient(outputs: Sequence[Symbol], adjoints: Sequence[Any], inputs: Sequence[Symbol]) -> tuple[Symbol, ...]:
    """Return sum_k adjoint_k d output_k / d input_j for each input, by reverse mode.

    Args:
        outputs: the symbols to differentiate.
        adjoints: the weight of each output; symbols of the same graph, or numbers.
        inputs: any nodes of the graph; they are treated as independent variables.
    """
    graph = outputs[0].graph
    variables = {s.index for s in inputs}
    order = graph.needed(s.index for s in outputs)
    active = _active(graph, order, variables)
    bar: dict[int, Symbol] = {}
    for y, g in zip(outputs, adjoints, strict=True):
        _add(bar, y.index, graph.symbol(g))
    for i in reversed(order):
        if i in bar and i in active and i not in variables:
            y = Symbol(graph, i)
            for argument, share in zip(y.arguments, PULLBACKS[y.node[0]](y, y.arguments, bar[i]), strict=True):
                if share is not None and argument.index in active:
                    _add(bar, argument.index, graph.symbol(share))
    zero = graph.constant(0.0)
    return tuple(bar.get(s.index, zero) for s in inputs)


def directional(outputs: Sequence[Symbol], directions: Mapping[int, Any]) -> tuple[Symbol, ...]:
    """Return the directional derivative of each output, by forward mode.

    Args:
        outputs: the symbols to differentiate.
        directions: the component of the direction for each node, by its index; symbols of the same graph, or numbers.
    """
    graph = outputs[0].graph
    one, zero = graph.constant(1.0), graph.constant(0.0)
    order = graph.needed(s.index for s in outputs)
    active = _active(graph, order, set(directions))
    dot = {i: graph.symbol(d) for i, d in directions.items()}
    for i in order:
        if i in active and i not in dot:
            y = Symbol(graph, i)
            for argument, slope in zip(y.arguments, PULLBACKS[y.node[0]](y, y.arguments, one), strict=True):
                if slope is not None and argument.index in dot:
                    _add(dot, i, slope * dot[argument.index])
    return tuple(dot.get(s.index, zero) for s in outputs)


def jacobian(outputs: Sequence[Symbol], inputs: Sequence[Symbol]) -> tuple[tuple[Symbol, ...], ...]:
    """Return d output_k / d input_j by forward mode, one row for each output."""
    columns = [directional(outputs, {s.index: 1.0}) for s in inputs]
    return tuple(zip(*columns, strict=True))


def _active(graph: Graph, order: Sequence[int], variables: set[int]) -> set[int]:
    """Return the nodes of `order` that depend on one of the nodes `variables`, these included.

    The dependence through truth values is left out, since its derivative is zero.
    """
    active: set[int] = set()
    for i in order:
        node = graph.nodes[i]
        if i in variables or (node[0] not in TRUTHS and any(a in active for a in arguments_of(node))):
            active.add(i)
    return active


def _add(sums: dict[int, Symbol], index: int, share: Symbol) -> None:
    sums[index] = sums[index] + share if index in sums else share
