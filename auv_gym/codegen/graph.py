"""A graph of arithmetic, recorded by running an equation on symbols.

The project's equations take components and a namespace of elementary functions (`auv_gym.physics.namespaces`). With
symbols as numbers and `SYMBOLS` as the namespace they record a graph. Each operation adds a node, or reuses the node of
the same operation, so common subexpressions are merged. Operations on constants are evaluated at once.

Only simplifications that are exact in floating point are made (x * 1, x / 1, x - 0, -(-x)), and the order of a sum is
kept. The printed code of a graph therefore gives the same bits as the equation. `structural` allows further
simplifications, for sparse matrices.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from ctypes import c_float
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from auv_gym.physics.namespaces import FLOATS, Namespace, scaled_components

Key = tuple[Any, ...]


def floor(x: float) -> float:
    """Return the largest integer that is at most x; for an infinity x itself, as in C and NumPy."""
    return x // 1.0 if -math.inf < x < math.inf else x


OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a: -a,
    "abs": abs,
    "sin": math.sin,
    "cos": math.cos,
    "exp": math.exp,
    "log": math.log,
    "sqrt": math.sqrt,
    "arctan2": math.atan2,
    "floor": floor,
    "single": lambda a: c_float(a).value,
    "clip": FLOATS.clip,
    "where": FLOATS.where,
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "not": lambda a: not a,
}
"""The functions of the operations on floats; `single` rounds to single precision."""
TRUTHS = frozenset(("lt", "le", "and", "or", "not"))
"""Operations with a truth value as result."""
COMMUTATIVE = frozenset(("add", "mul", "and", "or"))
"""Operations whose arguments can be exchanged."""


def evaluated(operation: str, *numbers: Any) -> Any:
    """Return the result of an operation on numbers; inf or nan where Python raises an error, as in C and NumPy."""
    try:
        return OPERATIONS[operation](*numbers)
    except (ArithmeticError, ValueError):
        with np.errstate(all="ignore"):
            return float(getattr(np, "divide" if operation == "div" else operation)(*numbers))


@dataclass
class Graph:
    """A list of nodes in the order of their recording, in which they can be computed.

    A node is a tuple of its operation and the indices of its arguments. The nodes ("input", name) and
    ("constant", value, text) have no arguments. With `structural`, x + 0 becomes x and x * 0 becomes 0; this is wrong
    only for infinities, nan and the sign of zero.
    """

    structural: bool = False
    nodes: list[Key] = field(default_factory=list)
    _index: dict[Key, int] = field(default_factory=dict)

    def input(self, name: str) -> Symbol:
        """Return the symbol of an input; equal names are the same input."""
        return self._node(("input", name))

    def constant(self, value: float | bool) -> Symbol:
        """Return the symbol of a number or a truth value."""
        value = value if isinstance(value, bool) else float(value)
        return self._node(("constant", value, repr(value)))  # the text distinguishes True and 1.0, -0.0 and 0.0

    def symbol(self, value: Any) -> Symbol:
        """Return a number as a constant of this graph; return a symbol unchanged.

        Raises:
            ValueError: the symbol belongs to another graph.
        """
        if not isinstance(value, Symbol):
            return self.constant(value)
        if value.graph is not self:
            raise ValueError("symbols of two graphs cannot be mixed")
        return value

    def apply(self, operation: str, *arguments: Any) -> Symbol:
        """Return the symbol of an operation of `OPERATIONS` on symbols or numbers."""
        symbols = [self.symbol(a) for a in arguments]
        known = [s.value for s in symbols]
        if None not in known:
            return self.constant(evaluated(operation, *known))
        if (simple := _simplified(operation, symbols, known)) is not None:
            return simple
        if self.structural and (simple := _without_zeros(operation, symbols, known)) is not None:
            return simple
        indices = [s.index for s in symbols]
        if operation in COMMUTATIVE:
            indices.sort()
        return self._node((operation, *indices))

    def _node(self, key: Key) -> Symbol:
        if key not in self._index:
            self._index[key] = len(self.nodes)
            self.nodes.append(key)
        return Symbol(self, self._index[key])

    def needed(self, outputs: Iterable[int]) -> list[int]:
        """Return the indices of the outputs and of all nodes that they depend on, in the order of computation."""
        wanted, stack = set(), list(outputs)
        while stack:
            if (i := stack.pop()) not in wanted:
                wanted.add(i)
                stack += arguments_of(self.nodes[i])
        return sorted(wanted)


def arguments_of(node: Key) -> tuple[int, ...]:
    """Return the indices of a node's arguments."""
    return () if node[0] in ("input", "constant") else node[1:]


def _simplified(operation: str, symbols: Sequence[Symbol], known: Sequence[Any]) -> Symbol | None:
    """Return the symbol that is exactly equal to the result of an operation; None if the operation is needed."""
    if operation == "mul" and 1.0 in known:
        return symbols[1 - known.index(1.0)]
    if operation == "div" and known[1] == 1.0:
        return symbols[0]
    if operation == "sub" and known[1] == 0.0 and math.copysign(1.0, known[1]) > 0:
        return symbols[0]
    if operation in ("neg", "not") and (node := symbols[0].node)[0] == operation:
        return Symbol(symbols[0].graph, node[1])
    if operation in ("and", "or") and (True in known or False in known):
        other = symbols[1] if known[0] is not None else symbols[0]
        decided = (operation == "or") == next(k for k in known if k is not None)
        return symbols[0].graph.constant(operation == "or") if decided else other
    if operation == "clip" and known[1] == -math.inf and known[2] == math.inf:
        return symbols[0]
    if operation == "where" and known[0] is not None:
        return symbols[1] if known[0] else symbols[2]
    if operation == "where" and symbols[1].index == symbols[2].index:
        return symbols[1]
    return None


def _without_zeros(operation: str, symbols: Sequence[Symbol], known: Sequence[Any]) -> Symbol | None:
    """Return the symbol of a sum, difference, product or quotient with a zero argument; None if there is none.

    The result is correct for all finite numbers, except for the sign of zero.
    """
    if 0.0 not in known or operation not in ("add", "sub", "mul", "div"):
        return None
    first = known[0] == 0.0
    if operation == "mul" or (operation == "div" and first):
        return symbols[0].graph.constant(0.0)
    if operation == "sub" and first:
        return -symbols[1]
    return None if operation == "div" else symbols[1 if first else 0]


@dataclass(frozen=True, eq=False)
class Symbol:
    """A node of a graph with the arithmetic operators of a number."""

    graph: Graph = field(repr=False)
    index: int

    @property
    def node(self) -> Key:
        """The operation and the indices of its arguments."""
        return self.graph.nodes[self.index]

    @property
    def value(self) -> Any:
        """The number of a constant; None for another node."""
        return self.node[1] if self.node[0] == "constant" else None

    @property
    def arguments(self) -> list[Symbol]:
        """The arguments of the operation as symbols."""
        return [Symbol(self.graph, i) for i in arguments_of(self.node)]

    def __add__(self, other: Any) -> Symbol:
        return self.graph.apply("add", self, other)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Symbol:
        return self.graph.apply("sub", self, other)

    def __rsub__(self, other: Any) -> Symbol:
        return self.graph.apply("sub", other, self)

    def __mul__(self, other: Any) -> Symbol:
        return self.graph.apply("mul", self, other)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Symbol:
        return self.graph.apply("div", self, other)

    def __rtruediv__(self, other: Any) -> Symbol:
        return self.graph.apply("div", other, self)

    def __pow__(self, power: int) -> Symbol:
        if power != 2:  # only squares have the same bits in Python, NumPy and C
            raise ValueError(f"the power of a symbol is {power!r}; it must be 2")
        return self * self

    def __neg__(self) -> Symbol:
        return self.graph.apply("neg", self)

    def __abs__(self) -> Symbol:
        return self.graph.apply("abs", self)

    def __lt__(self, other: Any) -> Symbol:
        return self.graph.apply("lt", self, other)

    def __le__(self, other: Any) -> Symbol:
        return self.graph.apply("le", self, other)

    def __gt__(self, other: Any) -> Symbol:
        return self.graph.apply("lt", other, self)

    def __ge__(self, other: Any) -> Symbol:
        return self.graph.apply("le", other, self)

    def __and__(self, other: Any) -> Symbol:
        return self.graph.apply("and", self, other)

    __rand__ = __and__

    def __or__(self, other: Any) -> Symbol:
        return self.graph.apply("or", self, other)

    __ror__ = __or__

    def __xor__(self, other: bool) -> Symbol:
        return ~self if other else self

    def __invert__(self) -> Symbol:
        return self.graph.apply("not", self)

    def __bool__(self) -> bool:
        raise TypeError("a symbol has no truth value; use `where` to select one of two values")


def _applied(operation: str) -> Callable[..., Any]:
    """Return the namespace function that records an operation on symbols, or evaluates it if no argument is one."""

    def function(*arguments: Any) -> Any:
        graph = next((a.graph for a in arguments if isinstance(a, Symbol)), None)
        return evaluated(operation, *arguments) if graph is None else graph.apply(operation, *arguments)

    return function


single = _applied("single")  # not part of the namespaces
CALLED = ("sin", "cos", "sqrt", "exp", "log", "arctan2", "floor", "clip", "where")  # operations that namespaces have
SYMBOLS: Namespace = Namespace(
    **{name: _applied(name) for name in CALLED},
    hypot=lambda x, y: SYMBOLS.sqrt(x * x + y * y),
    arcsin=lambda x: SYMBOLS.arctan2(x, SYMBOLS.sqrt((1.0 - x) * (1.0 + x))),
    scaled=scaled_components,
    bounded=lambda rows, bounds: [SYMBOLS.clip(x, -b, b) for x, b in zip(rows, bounds.numbers, strict=True)],
    stack=list,
)
"""The namespace of symbols."""
