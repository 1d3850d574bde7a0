"""A graph of arithmetic, recorded by running an equation on symbols.

The project's equations take components and a namespace of elementary functions (`auv_gym.physics.namespaces`). With
symbols for numbers and `SYMBOLS` for the namespace they compute nothing: each operation adds a node to a graph, or
finds the node that is there already, so common subexpressions are merged as they arise. Operations on constants are
carried out.

Only what is exact in floating point is simplified (x * 1, x / 1, x - 0, -(-x)), and a sum keeps its order: a printed
graph gives the numbers of the equation itself, bit for bit. `structural` allows more where a matrix is mostly zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from ctypes import c_float
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from auv_gym.physics.namespaces import FLOATS, Constants, Namespace

Key = tuple[Any, ...]


def floor(x: float) -> float:
    """Return the largest whole number that is not above x; of an infinity that itself, as C and NumPy do."""
    return x // 1.0 if -math.inf < x < math.inf else x


EXACT: dict[str, Callable[..., Any]] = {
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
"""What each operation means, on floats; `single` rounds to single precision and back."""
TRUTHS = frozenset(("lt", "le", "and", "or", "not"))
"""Operations that give a truth value."""
COMMUTATIVE = frozenset(("add", "mul", "and", "or"))
"""Operations whose arguments may change places."""


def carried_out(operation: str, *numbers: Any) -> Any:
    """Return what an operation of `EXACT` gives for numbers; inf or nan where Python raises, as in C and NumPy."""
    try:
        return EXACT[operation](*numbers)
    except (ArithmeticError, ValueError):
        with np.errstate(all="ignore"):
            return float(getattr(np, "divide" if operation == "div" else operation)(*numbers))


@dataclass
class Graph:
    """Nodes in the order in which they were recorded, which is one in which they can be computed.

    A node is its operation and the indices of its arguments; ("input", name) and ("constant", value, text) have none.
    With `structural`, x + 0 is x and x * 0 is 0, which is wrong for infinities and the sign of zero alone.
    """

    structural: bool = False
    nodes: list[Key] = field(default_factory=list)
    _index: dict[Key, int] = field(default_factory=dict)

    def input(self, name: str) -> Symbol:
        """Return the symbol of an input; the same name is the same input."""
        return self._node(("input", name))

    def constant(self, value: float | bool) -> Symbol:
        """Return the symbol of a number or a truth value."""
        value = value if isinstance(value, bool) else float(value)
        return self._node(("constant", value, repr(value)))  # as keys True is 1.0, and -0.0 is 0.0

    def symbol(self, value: Any) -> Symbol:
        """Return a number as a symbol of this graph, a symbol as it is.

        Raises:
            ValueError: the symbol is of another graph.
        """
        if not isinstance(value, Symbol):
            return self.constant(value)
        if value.graph is not self:
            raise ValueError("symbols of two graphs cannot be mixed")
        return value

    def apply(self, operation: str, *arguments: Any) -> Symbol:
        """Return what an operation of `EXACT` gives for symbols or numbers."""
        symbols = [self.symbol(a) for a in arguments]
        known = [s.value for s in symbols]
        if None not in known:
            return self.constant(carried_out(operation, *known))
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
        """Return the nodes that the outputs depend on, themselves among them, in the order in which they compute."""
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
    """Return the symbol that an operation gives without being carried out, where that is exact; else None."""
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
    """Return the symbol that an operation with a zero gives, if that is one of its arguments or a new sign; else None.

    It is right for all finite numbers but for the sign of zero.
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
    """A node of a graph that computes like a number."""

    graph: Graph = field(repr=False)
    index: int

    @property
    def node(self) -> Key:
        """The operation and its arguments."""
        return self.graph.nodes[self.index]

    @property
    def value(self) -> Any:
        """The number of a constant, else None."""
        return self.node[1] if self.node[0] == "constant" else None

    @property
    def arguments(self) -> list[Symbol]:
        """The symbols that the operation is applied to."""
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
        if power != 2:  # the one power that Python, NumPy and C agree on to the bit
            raise ValueError(f"a symbol to the power {power!r}: only squares are taken")
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
        raise TypeError("a symbol is neither true nor false; choose between two values with `where`")


def _applied(operation: str) -> Callable[..., Any]:
    """Return the function of a namespace that records an operation; without any symbol it is carried out."""

    def function(*arguments: Any) -> Any:
        graph = next((a.graph for a in arguments if isinstance(a, Symbol)), None)
        return carried_out(operation, *arguments) if graph is None else graph.apply(operation, *arguments)

    return function


single = _applied("single")  # an operation that no namespace needs


def _scaled(rows: Any, factors: Constants) -> list[Any]:
    return [row * factor for row, factor in zip(rows, factors.numbers, strict=True)]


def _bounded(rows: Any, bounds: Constants) -> list[Any]:
    return [SYMBOLS.clip(row, -bound, bound) for row, bound in zip(rows, bounds.numbers, strict=True)]


def _hypot(x: Any, y: Any) -> Any:
    return SYMBOLS.sqrt(x * x + y * y)


def _arcsin(x: Any) -> Any:
    return SYMBOLS.arctan2(x, SYMBOLS.sqrt((1.0 - x) * (1.0 + x)))


SYMBOLS = Namespace(
    sin=_applied("sin"),
    cos=_applied("cos"),
    sqrt=_applied("sqrt"),
    exp=_applied("exp"),
    log=_applied("log"),
    hypot=_hypot,
    arctan2=_applied("arctan2"),
    arcsin=_arcsin,
    floor=_applied("floor"),
    clip=_applied("clip"),
    where=_applied("where"),
    scaled=_scaled,
    bounded=_bounded,
    stack=list,
)
"""The namespace of symbols."""
