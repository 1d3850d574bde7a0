"""Networks as programs of vectors, recorded by running them on vectors that compute nothing, as equations on symbols.

A network of `baselines.agents.networks` computes with NumPy on columns. Given a `_Vector` in place of a column, each
operation becomes a node, and from the nodes come loops in C and JavaScript, or the operators of an exchange format.
Matrices are not unrolled: the program stays short, and the weights stay data.
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
"""Operations on each entry, named as NumPy's functions; their arguments are nodes, named constants or numbers."""


@dataclass(frozen=True)
class Node:
    """An operation on vectors.

    One of `ELEMENTWISE`, "input" (name), "slice" (node, first), "dot" (matrix, node) or "concatenate" (nodes).
    """

    operation: str
    arguments: tuple[Any, ...]  # indices of nodes as int, numbers as float, names of inputs and constants as str
    size: int  # entries of the result


@dataclass
class Program:
    """Nodes in the order in which they were recorded, which is one in which they can be computed."""

    constants: Mapping[str, AnyArray]  # matrices (rows, columns) and vectors (rows,), by name
    nodes: list[Node] = field(default_factory=list)
    results: dict[str, int] = field(default_factory=dict)  # nodes by the names of what they are for

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
            function: takes a vector for each input, and uses the constants' own arrays.
            constants: matrices (rows, columns) and columns (rows, 1) that it uses, by name.
            inputs: how many entries each input has.
            results: names of what it returns.
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
    """A column of numbers that NumPy's functions take and that records what they do with it.

    What is changed in place through a part of a column may not be read through the whole of it any more, since a part
    is recorded as a vector of its own.
    """

    def __init__(self, program: Program, index: int, names: Mapping[int, str]) -> None:
        """Stand for a node; `names` are the constants' by the identity of their arrays."""
        self.program, self.index, self.names = program, index, names
        self._whole: tuple[_Vector, int, int] | None = None  # what it is a part of, from where to where
        self._changed: list[tuple[int, int]] = []  # parts that were changed in place

    def _recorded(self, operation: str, arguments: tuple[Any, ...], size: int) -> _Vector:
        return _Vector(self.program, self.program.node(operation, arguments, size), self.names)

    def _argument(self, value: Any) -> Any:
        if isinstance(value, _Vector):
            return value._read(0, math.inf)
        return self.names[id(value)] if isinstance(value, np.ndarray) else float(value)

    def _read(self, first: float, end: float) -> int:
        """Return the node for somebody who reads entries from `first` to `end`."""
        if any(first < b and a < end for a, b in self._changed):
            raise ValueError("a vector is read whose part was changed in place: read the part, or change the whole")
        return self.index

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, out: tuple[_Vector, ...] = ()) -> Any:
        if method != "__call__" or ufunc.__name__ not in ELEMENTWISE:
            raise TypeError(f"{ufunc.__name__} of a vector is not recorded, only {', '.join(ELEMENTWISE)}")
        size = max(self.program.nodes[x.index].size for x in inputs if isinstance(x, _Vector))
        result = self._recorded(ufunc.__name__, tuple(map(self._argument, inputs)), size)
        if not out:
            return result
        target = out[0]
        target.index = result.index  # what was there before is not read again
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
        raise TypeError(f"{function.__name__} of a vector is not recorded, only dot, clip and concatenate")

    def __getitem__(self, rows: slice) -> _Vector:
        first, end, _ = rows.indices(self.program.nodes[self.index].size)
        part = self._recorded("slice", (self._read(first, end), first), end - first)
        part._whole = self, first, end
        return part


def plain_program(name: str, program: Program, tangent: str, dialect: Dialect, scales: Mapping[str, str]) -> str:
    """Return the source of a function that runs a program on arrays: its inputs, then its results, as far as not empty.

    Args:
        name: of the function.
        program: what it does; its constants are arrays of their names, matrices row by row.
        tangent: name of the function `plain.tangent_function`.
        dialect: what it is written in.
        scales: names of arrays with a factor for each row of a matrix, where its entries are stored as integers.
    """
    return _Loops(program, tangent, dialect, scales).function(name)


class _Loops:
    """Writes a program as loops; what is used once is computed where it is used."""

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
        """Return the whole function."""
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
        """Write the parts of an array, one behind the other."""
        first = 0
        for part in parts:
            size = self.program.nodes[part].size
            self.lines.append(f"{self.dialect.loop.format('i', size)} {{")
            text = self._entry(part, 0)
            self.lines += [f"{array}[i + {first}] = {text};", "}"]
            first += size

    def _entry(self, argument: Any, first: int) -> str:
        """Return entry first + i of a node, a constant or a number."""
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
        """Return the expression of entry first + i of a node, behind the statements that it needs."""
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
        """Return the name of the product of a matrix's row with a vector, behind the loop that computes it."""
        columns, total, d = self.program.nodes[vector].size, f"s{i}", self.dialect
        row = f"(i + {first})" if first else "i"
        term = self._entry(vector, 0).replace("[i", "[j")
        self.lines.append(d.variable.format(total, d.language.number(0.0)))
        self.lines.append(f"{d.loop.format('j', columns)} {total} += {matrix}[{row} * {columns} + j] * {term};")
        return f"({total} * {self.scales[matrix]}[{row}])" if matrix in self.scales else total
