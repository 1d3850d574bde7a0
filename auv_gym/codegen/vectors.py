"""Networks as programs of vector operations, recorded by running them on symbolic vectors.

A network of `baselines.agents.networks` computes with NumPy on columns. With a `_Vector` as a column, each operation
is recorded as a node. The nodes are printed as loops in C or JavaScript, or as the operators of an exchange format.
Matrices are not unrolled, so programs are short and the weights remain data.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from auv_gym.codegen.plain import Dialect
from auv_gym.physics.namespaces import AnyArray

ELEMENTWISE = ("add", "subtract", "multiply", "maximum", "clip", "tanh")
"""Elementwise operations, by the names of NumPy's functions; their arguments are nodes, constants or numbers."""


@dataclass(frozen=True)
class Node:
    """An operation on vectors.

    It is one of `ELEMENTWISE`, "input" (name), "slice" (node, first), "dot" (matrix, node) or "concatenate" (nodes).
    """

    operation: str
    arguments: tuple[Any, ...]  # nodes by their index, an int; numbers as float; inputs and constants by their name
    size: int  # number of entries of the result


@dataclass
class Program:
    """A list of nodes in the order of their recording, in which they can be computed."""

    constants: Mapping[str, AnyArray]  # matrices (rows, columns) and vectors (rows,), by name
    nodes: list[Node] = field(default_factory=list)
    results: dict[str, int] = field(default_factory=dict)  # index of the node of each result, by name

    @classmethod
    def traced(
        cls,
        function: Callable[..., Sequence[Any]],
        constants: Mapping[str, AnyArray],
        inputs: Mapping[str, int],
        results: Sequence[str],
    ) -> Program:
        """Return the program of a function of columns.

        Args:
            function: takes a vector for each input, and uses the arrays of `constants` themselves.
            constants: matrices (rows, columns) and columns (rows, 1) that it uses, by name.
            inputs: number of entries of each input.
            results: names of the vectors that the function returns.
        """
        program = cls({name: a[:, 0] if a.shape[1] == 1 else a for name, a in constants.items()})
        names = {id(array): name for name, array in constants.items()}
        given = [_Vector(program, program.node("input", (name,), size), names) for name, size in inputs.items()]
        for name, vector in zip(results, function(*given), strict=True):
            program.results[name] = vector.index
        return program

    def node(self, operation: str, arguments: tuple[Any, ...], size: int) -> int:
        """Record a node and return its index."""
        self.nodes.append(Node(operation, arguments, size))
        return len(self.nodes) - 1


class _Vector(NDArrayOperatorsMixin):
    """A symbolic column; NumPy's functions of it are recorded.

    A part of a column is recorded as a separate vector. After a part was changed in place, these entries cannot be read
    through the whole column.
    """

    def __init__(self, program: Program, index: int, names: Mapping[int, str]) -> None:
        """Represent a node; `names` has the name of each constant by the `id` of its array."""
        self.program, self.index, self.names = program, index, names
        self._whole: tuple[_Vector, int, int] | None = None  # the vector of which this is a part, first entry, end
        self._changed: list[tuple[int, int]] = []  # first entry and end of the parts that were changed in place

    def _recorded(self, operation: str, arguments: tuple[Any, ...], size: int) -> _Vector:
        return _Vector(self.program, self.program.node(operation, arguments, size), self.names)

    def _argument(self, value: Any) -> Any:
        if isinstance(value, _Vector):
            return value._read(0, math.inf)
        return self.names[id(value)] if isinstance(value, np.ndarray) else float(value)

    def _read(self, first: float, end: float) -> int:
        """Return the node for a function that reads the entries from `first` to `end`."""
        if any(first < b and a < end for a, b in self._changed):
            raise ValueError("a part of this vector was changed in place; read the part, or change the whole vector")
        return self.index

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, out: tuple[_Vector, ...] = ()) -> Any:
        if method != "__call__" or ufunc.__name__ not in ELEMENTWISE:
            raise TypeError(f"{ufunc.__name__} of a vector cannot be recorded; allowed are {', '.join(ELEMENTWISE)}")
        size = max(self.program.nodes[x.index].size for x in inputs if isinstance(x, _Vector))
        result = self._recorded(ufunc.__name__, tuple(map(self._argument, inputs)), size)
        if not out:
            return result
        target = out[0]
        target.index = result.index
        if target._whole is not None:
            whole, first, end = target._whole
            whole._changed.append((first, end))
        return target

    def __array_function__(self, function: Any, types: Any, arguments: Any, options: Any) -> _Vector:
        if function is np.dot:
            matrix, vector = arguments
            return self._recorded("dot", (self.names[id(matrix)], self._argument(vector)), len(matrix))
        if function is np.clip:
            return self._recorded("clip", tuple(map(self._argument, arguments)), self.program.nodes[self.index].size)
        if function is np.concatenate:
            parts = tuple(map(self._argument, arguments[0]))
            return self._recorded("concatenate", parts, sum(self.program.nodes[part].size for part in parts))
        raise TypeError(f"{function.__name__} of a vector cannot be recorded; allowed are dot, clip and concatenate")

    def __getitem__(self, rows: slice) -> _Vector:
        first, end, _ = rows.indices(self.program.nodes[self.index].size)
        part = self._recorded("slice", (self._read(first, end), first), end - first)
        part._whole = self, first, end
        return part


def plain_program(name: str, program: Program, tangent: str, dialect: Dialect, scales: Mapping[str, str]) -> str:
    """Return the source of a function that runs a program on arrays.

    Its parameters are the inputs, then the results; empty arrays are left out.

    Args:
        name: the name of the function.
        program: the program; its constants are global arrays of the same names, matrices row by row.
        tangent: the name of the hyperbolic tangent, see `plain.tangent_function`.
        dialect: the language.
        scales: for each matrix that is stored as integers, the name of the array with a factor for each row.
    """
    return _Loops(program, tangent, dialect, scales).function(name)


class _Loops:
    """Prints a program as loops; a node that is used once is nested in the expression that uses it."""

    def __init__(self, program: Program, tangent: str, dialect: Dialect, scales: Mapping[str, str]) -> None:
        self.program, self.tangent, self.dialect, self.scales = program, tangent, dialect, scales
        nodes = program.nodes
        uses = Counter(a for node in nodes for a in node.arguments if isinstance(a, int))
        multiplied = {node.arguments[1] for node in nodes if node.operation == "dot"}
        ends = set(program.results.values())
        self.kept = {
            i: f"w{i}"
            for i, node in enumerate(nodes)
            if node.operation not in ("input", "slice")
            and (uses[i] > 1 or i in multiplied or i in ends or node.operation == "concatenate")
        }
        self.lines: list[str] = []

    def function(self, name: str) -> str:
        """Return the source of the function."""
        nodes, d = self.program.nodes, self.dialect
        inputs = [node.arguments[0] for node in nodes if node.operation == "input" and node.size]
        results = {array: i for array, i in self.program.results.items() if nodes[i].size}
        taken = [d.read.format(array) for array in inputs] + [d.write.format(array) for array in results]
        self.lines = [d.head.format(name, ", ".join(taken)), "{"]
        self.lines += [d.local.format(array, nodes[i].size) for i, array in self.kept.items()]
        for i, array in self.kept.items():
            if nodes[i].operation == "concatenate":
                self._filled(array, nodes[i].arguments)
                continue
            self.lines.append(f"{d.loop.format('i', nodes[i].size)} {{")
            text = self._computed(i, 0)
            self.lines += [f"{array}[i] = {text};", "}"]
        for array, i in results.items():
            self.lines += [f"{d.loop.format('i', nodes[i].size)} {array}[i] = {self._entry(i, 0)};"]
        return "\n".join((*self.lines, "}")) + "\n"

    def _filled(self, array: str, parts: Sequence[int]) -> None:
        """Append the loops that concatenate nodes to an array."""
        first = 0
        for part in parts:
            size = self.program.nodes[part].size
            self.lines.append(f"{self.dialect.loop.format('i', size)} {{")
            text = self._entry(part, 0)
            self.lines += [f"{array}[i + {first}] = {text};", "}"]
            first += size

    def _entry(self, argument: Any, first: int) -> str:
        """Return the expression of entry first + i of a node, a constant or a number."""
        at = f"[i + {first}]" if first else "[i]"
        if isinstance(argument, float):
            return self.dialect.language.number(argument)
        if isinstance(argument, str):
            return argument + at
        node = self.program.nodes[argument]
        if argument in self.kept:
            return self.kept[argument] + at
        if node.operation == "input":
            return str(node.arguments[0]) + at
        return self._computed(argument, first)

    def _computed(self, i: int, first: int) -> str:
        """Append the statements that entry first + i of a node needs, and return its expression."""
        node = self.program.nodes[i]
        if node.operation == "slice":
            return self._entry(node.arguments[0], first + node.arguments[1])
        if node.operation == "dot":
            matrix, vector = node.arguments
            return self._sum(i, matrix, vector, first)
        texts = [self._entry(argument, first) for argument in node.arguments]
        if node.operation == "tanh":
            return f"{self.tangent}({texts[0]})"
        if node.operation in ("maximum", "clip"):
            name, number = f"t{i}", self.dialect.language.number
            self.lines.append(self.dialect.value.format(name, texts[0]))
            low, high = texts[1], texts[2] if node.operation == "clip" else number(float("inf"))
            return self.dialect.language.forms["clip"].format(name, low, high)
        form = {"add": "add", "subtract": "sub", "multiply": "mul"}[node.operation]
        return self.dialect.language.forms[form].format(*texts)

    def _sum(self, i: int, matrix: str, vector: int, first: int) -> str:
        """Append the loop of the product of row first + i of a matrix with a vector; return its expression."""
        columns, total, d = self.program.nodes[vector].size, f"s{i}", self.dialect
        row = f"(i + {first})" if first else "i"
        term = self._entry(vector, 0).replace("[i", "[j")
        self.lines.append(d.variable.format(total, d.language.number(0.0)))
        self.lines.append(f"{d.loop.format('j', columns)} {total} += {matrix}[{row} * {columns} + j] * {term};")
        return f"({total} * {self.scales[matrix]}[{row}])" if matrix in self.scales else total
