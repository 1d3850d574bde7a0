"""A graph as a plain function for one vehicle, in C99 or JavaScript, for programs that hold nothing of this project.

A function takes arrays and writes to arrays; one may be read and written at once, since everything is read first.
Sine, cosine, exponential and arctangent are written out, so that both languages give the bits of the compiled kernels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from auv_gym.codegen.elementary import hyperbolic_tangent, lowered
from auv_gym.codegen.graph import SYMBOLS, TRUTHS, Graph
from auv_gym.codegen.printing import JAVASCRIPT, Arrays, Language, c_language, written_statements


@dataclass(frozen=True)
class Dialect:
    """How plain functions look in a language."""

    language: Language
    precision: str  # of all numbers, "float64" or "float32"
    value: str  # a constant's declaration, with its name {0} and expression {1}
    truth: str  # that of a truth value
    head: str  # a function's first line, with its name {0} and parameters {1}
    read: str  # a parameter that is an array to read, with its name {0}
    write: str  # a parameter that is an array to write
    number: str  # a parameter that is a number
    variable: str  # a number that changes, with its name {0} and first value {1}
    local: str  # an array in a function, with its name {0} and size {1}
    loop: str  # a loop's head, with its counter {0} and the number of rounds {1}
    unused: str  # a line for a parameter {0} that a function does not read; empty where nobody minds


def c_dialect(precision: str) -> Dialect:
    """Return C99, whose type `real` is of a precision, "float64" or "float32"."""
    return Dialect(
        language=c_language(precision),
        precision=precision,
        value="const real {0} = {1};",
        truth="const int {0} = {1};",
        head="static void {0}({1})",
        read="const real *{0}",
        write="real *{0}",
        number="real {0}",
        variable="real {0} = {1};",
        local="real {0}[{1}];",
        loop="for (int {0} = 0; {0} < {1}; {0}++)",
        unused="(void){0};",
    )


JAVASCRIPT_DIALECT = Dialect(
    language=JAVASCRIPT,
    precision="float64",
    value="const {0} = {1};",
    truth="const {0} = {1};",
    head="function {0}({1})",
    read="{0}",
    write="{0}",
    number="{0}",
    variable="let {0} = {1};",
    local="const {0} = new Float64Array({1});",
    loop="for (let {0} = 0; {0} < {1}; {0}++)",
    unused="",
)
"""JavaScript, on arrays of the type Float64Array."""


def plain_function(name: str, graph: Graph, arguments: Arrays, results: Arrays, dialect: Dialect) -> str:
    """Return the source of a function that reads the arguments and writes the results, arrays of numbers.

    Its parameters are the arrays by name, the arguments first and behind them results that are no arguments; arrays
    without entries are left out, see `parameters`. Truth values become 0 and 1.

    Args:
        name: of the function.
        graph: what the results are nodes of.
        arguments: the arrays that it reads.
        results: the arrays that it writes.
        dialect: what it is written in.
    """
    flat = lowered(graph, [s for entries in results.values() for s in entries], dialect.precision)
    read = {graph.nodes[i][1] for i in graph.needed(s.index for s in flat) if graph.nodes[i][0] == "input"}
    given = {s.node[1]: f"{array}[{j}]" for array, own in arguments.items() for j, s in enumerate(own)}
    statements, texts = written_statements(graph, flat, dialect.language, {entry: entry for entry in read})
    taken = parameters(arguments, results)
    declared = [(dialect.write if array in results else dialect.read).format(array) for array in taken]
    lines = [dialect.head.format(name, ", ".join(declared)), "{"]
    ignored = [a for a in taken if a not in results and not any(s.node[1] in read for s in arguments[a])]
    lines += [dialect.unused.format(array) for array in ignored if dialect.unused]
    lines += [dialect.value.format(entry, given[entry]) for entry in given if entry in read]
    lines += [(dialect.truth if truth else dialect.value).format(target, text) for target, text, truth in statements]
    values = iter(zip(flat, texts, strict=True))
    for array, entries in results.items():
        for j in range(len(entries)):
            symbol, text = next(values)
            truth = symbol.node[0] in TRUTHS or isinstance(symbol.value, bool)
            if given.get(text) != f"{array}[{j}]":  # what stays as it is need not be written
                lines.append(f"{array}[{j}] = {f'({text} ? 1 : 0)' if truth else text};")
    return "\n".join((*lines, "}")) + "\n"


def parameters(arguments: Arrays, results: Arrays) -> Sequence[str]:
    """Return the names of a plain function's parameters in their order."""
    return [array for array, entries in {**arguments, **results}.items() if len(entries)]


def tangent_function(name: str, dialect: Dialect) -> str:
    """Return the source of the hyperbolic tangent: a function that takes a number and returns one."""
    graph = Graph()
    result = hyperbolic_tangent(graph.input("x"), dialect.precision, SYMBOLS)
    statements, (text,) = written_statements(graph, [result], dialect.language, {"x": "x"})
    head = dialect.head.format(name, dialect.number.format("x")).replace("static void", "static real")
    lines = [(dialect.truth if truth else dialect.value).format(target, text) for target, text, truth in statements]
    return "\n".join((head, "{", *lines, f"return {text};", "}")) + "\n"
