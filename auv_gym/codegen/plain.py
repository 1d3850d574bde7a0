"""A graph as a plain function for one vehicle, in C99 or JavaScript, for programs that do not use this package.

A function reads arrays and writes arrays. The same array may be read and written, since all values are read first.
Sine, cosine, exponential and arctangent are expanded, so both languages give the same bits as the compiled kernels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from auv_gym.codegen.elementary import hyperbolic_tangent, lowered
from auv_gym.codegen.graph import SYMBOLS, TRUTHS, Graph
from auv_gym.codegen.printing import JAVASCRIPT, Arrays, Language, c_language, written_statements


@dataclass(frozen=True)
class Dialect:
    """The syntax of plain functions in a language."""

    language: Language
    precision: str  # type of all numbers, "float64" or "float32"
    value: str  # declaration of a constant with name {0} and expression {1}
    truth: str  # declaration of a truth value with name {0} and expression {1}
    head: str  # first line of a function with name {0} and parameters {1}
    read: str  # parameter {0}, an array to read
    write: str  # parameter {0}, an array to write
    number: str  # parameter {0}, a number
    variable: str  # declaration of a variable with name {0} and initial value {1}
    local: str  # declaration of a local array with name {0} and size {1}
    loop: str  # head of a loop with counter {0} and number of iterations {1}
    unused: str  # statement for a parameter {0} that is not read; empty if none is needed


def c_dialect(precision: str) -> Dialect:
    """Return the dialect of C99 with the type `real` of a precision, "float64" or "float32"."""
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
"""The dialect of JavaScript, for arrays of the type Float64Array."""


def plain_function(name: str, graph: Graph, arguments: Arrays, results: Arrays, dialect: Dialect) -> str:
    """Return the source of a function that reads the arguments and writes the results, arrays of numbers.

    See `parameters` for its parameters. Truth values become 0 and 1.

    Args:
        name: the name of the function.
        graph: the graph of the results.
        arguments: the arrays that the function reads.
        results: the arrays that the function writes.
        dialect: the language.
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
            if given.get(text) != f"{array}[{j}]":  # an unchanged entry is not written
                lines.append(f"{array}[{j}] = {f'({text} ? 1 : 0)' if truth else text};")
    return "\n".join((*lines, "}")) + "\n"


def parameters(arguments: Arrays, results: Arrays) -> Sequence[str]:
    """Return the parameters of a plain function: the arguments, then the other results; without empty arrays."""
    return [array for array, entries in {**arguments, **results}.items() if len(entries)]


def tangent_function(name: str, dialect: Dialect) -> str:
    """Return the source of a function that returns the hyperbolic tangent of a number."""
    graph = Graph()
    result = hyperbolic_tangent(graph.input("x"), dialect.precision, SYMBOLS)
    statements, (text,) = written_statements(graph, [result], dialect.language, {"x": "x"})
    head = dialect.head.format(name, dialect.number.format("x")).replace("static void", "static real")
    lines = [(dialect.truth if truth else dialect.value).format(target, text) for target, text, truth in statements]
    return "\n".join((head, "{", *lines, f"return {text};", "}")) + "\n"
