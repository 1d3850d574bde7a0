"""Networks as programs of vector operations, recorded by running them on symbolic vectors.

A network of `baselines.agents.networks` computes with NumPy on columns. With a `_Vector` as a column, each operation
is recorded as a node. The nodes are printed as loops in C, or as the operators of an exchange format. Matrices are not
unrolled, so programs are short and the weights remain data.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from auv_gym.codegen.printing import Language
from auv_gym.physics.namespaces import AnyArray

ELEMENTWISE: Mapping[str, str] = {
    "add": "add", "subtract": "sub", "multiply": "mul", "maximum": "maximum", "clip": "clip", "tanh": "tanh"
}  # fmt: skip
"""Names of elementwise operations by those of NumPy's functions; their arguments are nodes, constants or numbers."""


class Node(NamedTuple):
    """An operation on vectors.

    It is an elementwise one, "input" (name), "slice" (node, first), "dot" (matrix, node) or "concatenate" (nodes).
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
        vectors = [_Vector(program, program.node("input", (name,), size), names) for name, size in inputs.items()]
        for name, vector in zip(results, function(*vectors), strict=True):
            program.results[name] = vector.index
        return program

    def node(self, operation: str, arguments: tuple[Any, ...], size: int) -> int:
        """Record a node and return its index."""
        self.nodes.append(Node(operation, arguments, size))
        return len(self.nodes) - 1


class _Vector(NDArrayOperatorsMixin):
    """A symbolic column; NumPy's functions of it are recorded.

    A part of a column is recorded as a separate vector, so a change of the part in place does not change the column.
    """

    def __init__(self, program: Program, index: int, names: Mapping[int, str]) -> None:
        """Represent a node; `names` has the name of each constant by the `id` of its array."""
        self.program, self.index, self.names = program, index, names

    @property
    def size(self) -> int:
        """The number of entries."""
        return self.program.nodes[self.index].size

    def _recorded(self, operation: str, arguments: Sequence[Any], size: int, *places: int) -> _Vector:
        index = self.program.node(operation, (*map(self._argument, arguments), *places), size)
        return _Vector(self.program, index, self.names)

    def _argument(self, value: Any) -> Any:
        if isinstance(value, _Vector):
            return value.index
        return self.names[id(value)] if isinstance(value, np.ndarray) else float(value)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, out: tuple[_Vector, ...] = ()) -> Any:
        if method != "__call__" or ufunc.__name__ not in ELEMENTWISE:
            raise TypeError(f"{ufunc.__name__} of a vector cannot be recorded; allowed are {', '.join(ELEMENTWISE)}")
        size = max(x.size for x in inputs if isinstance(x, _Vector))
        result = self._recorded(ELEMENTWISE[ufunc.__name__], inputs, size)
        if not out:
            return result
        out[0].index = result.index
        return out[0]

    def __array_function__(self, function: Any, types: Any, arguments: Any, options: Any) -> _Vector:
        if function is np.dot:
            return self._recorded("dot", arguments, len(arguments[0]))
        if function is np.clip:
            return self._recorded("clip", arguments, self.size)
        if function is np.concatenate:
            return self._recorded("concatenate", arguments[0], sum(part.size for part in arguments[0]))
        raise TypeError(f"{function.__name__} of a vector cannot be recorded; allowed are dot, clip and concatenate")

    def __getitem__(self, rows: slice) -> _Vector:
        first, end, _ = rows.indices(self.size)
        return self._recorded("slice", (self,), end - first, first)


def plain_program(name: str, program: Program, tangent: str, language: Language, scales: Mapping[str, str]) -> str:
    """Return the C source of a function that runs a program on arrays of the type `real`.

    Its parameters are the inputs, then the results; empty arrays are left out.

    Args:
        name: the name of the function.
        program: the program; its constants are global arrays of the same names, matrices row by row.
        tangent: the name of the hyperbolic tangent, see `plain.tangent_function`.
        language: the language of the expressions, as for `plain.plain_function`.
        scales: for each matrix that is stored as integers, the name of the array with a factor for each row.
    """
    return _Loops(program, tangent, language, scales).function(name)


class _Loops:
    """Prints a program as loops; a node that is used once is nested in the expression that uses it."""

    def __init__(self, program: Program, tangent: str, language: Language, scales: Mapping[str, str]) -> None:
        self.program, self.tangent, self.language, self.scales = program, tangent, language, scales
        nodes = program.nodes
        uses = Counter(a for node in nodes for a in node.arguments if isinstance(a, int))
        multiplied = {node.arguments[1] for node in nodes if node.operation == "dot"}
        ends = set(program.results.values())
        self.arrays = {  # names of the nodes that are stored
            i: f"w{i}"
            for i, node in enumerate(nodes)
            if node.operation not in ("input", "slice")
            and (uses[i] > 1 or i in multiplied or i in ends or node.operation == "concatenate")
        }
        self.lines: list[str] = []

    def function(self, name: str) -> str:
        """Return the source of the function."""
        nodes = self.program.nodes
        inputs = [node.arguments[0] for node in nodes if node.operation == "input" and node.size]
        results = {array: i for array, i in self.program.results.items() if nodes[i].size}
        declared = [f"const real *{array}" for array in inputs] + [f"real *{array}" for array in results]
        self.lines = [f"static void {name}({', '.join(declared)})", "{"]
        self.lines += [f"real {array}[{nodes[i].size}];" for i, array in self.arrays.items()]
        for i, array in self.arrays.items():
            first = 0
            for part in nodes[i].arguments if nodes[i].operation == "concatenate" else (i,):
                self.lines.append(f"for (int i = 0; i < {nodes[part].size}; i++) {{")
                text = self._computed(i, 0) if part == i else self._entry(part, 0)
                self.lines += [f"{array}{_at(first)} = {text};", "}"]
                first += nodes[part].size
        for array, i in results.items():
            self.lines.append(f"for (int i = 0; i < {nodes[i].size}; i++) {array}[i] = {self._entry(i, 0)};")
        return "\n".join((*self.lines, "}")) + "\n"

    def _entry(self, argument: Any, first: int) -> str:
        """Return the expression of entry first + i of a node, a constant or a number."""
        if isinstance(argument, float):
            return self.language.number(argument)
        if isinstance(argument, str):
            return argument + _at(first)
        node = self.program.nodes[argument]
        if argument in self.arrays:
            return self.arrays[argument] + _at(first)
        return str(node.arguments[0]) + _at(first) if node.operation == "input" else self._computed(argument, first)

    def _computed(self, i: int, first: int) -> str:
        """Append the statements that entry first + i of a node needs, and return its expression."""
        node, language = self.program.nodes[i], self.language
        if node.operation == "slice":
            return self._entry(node.arguments[0], first + node.arguments[1])
        if node.operation == "dot":
            matrix, vector = node.arguments
            return self._sum(i, matrix, vector, first)
        texts = [self._entry(argument, first) for argument in node.arguments]
        if node.operation == "tanh":
            return f"{self.tangent}({texts[0]})"
        if node.operation in ("maximum", "clip"):
            self.lines.append(f"const real t{i} = {texts[0]};")
            low, high = texts[1], texts[2] if node.operation == "clip" else language.number(float("inf"))
            return language.forms["clip"].format(f"t{i}", low, high)
        return language.forms[node.operation].format(*texts)

    def _sum(self, i: int, matrix: str, vector: int, first: int) -> str:
        """Append the loop of the product of row first + i of a matrix with a vector; return its expression."""
        columns, row = self.program.nodes[vector].size, f"(i + {first})" if first else "i"
        term = self._entry(vector, 0).replace("[i", "[j")
        self.lines.append(f"real s{i} = {self.language.number(0.0)};")
        self.lines.append(f"for (int j = 0; j < {columns}; j++) s{i} += {matrix}[{row} * {columns} + j] * {term};")
        return f"(s{i} * {self.scales[matrix]}[{row}])" if matrix in self.scales else f"s{i}"


def _at(first: int) -> str:
    return f"[i + {first}]" if first else "[i]"
