"""A graph as a plain C99 function for one vehicle, for programs that do not use this package.

A function reads and writes arrays of the type `real`. The same array may be read and written, since all values are read
first. Sine, cosine, exponential and arctangent are expanded, so the bits are those of the compiled kernels. Another
language with expressions like those of C can be printed, too; then the declarations are to be replaced.
"""

from __future__ import annotations

from collections.abc import Sequence

from auv_gym.codegen.elementary import hyperbolic_tangent, lowered
from auv_gym.codegen.graph import SYMBOLS, TRUTHS, Graph
from auv_gym.codegen.printing import Arrays, Language, written_statements


def plain_function(
    name: str, graph: Graph, arguments: Arrays, results: Arrays, language: Language, precision: str
) -> str:
    """Return the source of a function that reads the arguments and writes the results, arrays of numbers.

    See `parameters` for its parameters. Truth values become 0 and 1.

    Args:
        name: the name of the function.
        graph: the graph of the results.
        arguments: the arrays that the function reads.
        results: the arrays that the function writes.
        language: the language of the expressions, as a rule `c_language`.
        precision: type of all numbers, "float64" or "float32".
    """
    flat = lowered(graph, [s for entries in results.values() for s in entries], precision)
    read = {graph.nodes[i][1] for i in graph.needed(s.index for s in flat) if graph.nodes[i][0] == "input"}
    entries = {s.node[1]: f"{array}[{j}]" for array, symbols in arguments.items() for j, s in enumerate(symbols)}
    statements, texts = written_statements(graph, flat, language, {entry: entry for entry in read})
    taken = parameters(arguments, results)
    declared = [f"{'' if array in results else 'const '}real *{array}" for array in taken]
    ignored = [a for a in taken if a not in results and not any(s.node[1] in read for s in arguments[a])]
    lines = [f"static void {name}({', '.join(declared)})", "{", *(f"(void){array};" for array in ignored)]
    lines += [f"const real {entry} = {place};" for entry, place in entries.items() if entry in read]
    lines += map(_declaration, statements)
    values = iter(zip(flat, texts, strict=True))
    for array, symbols in results.items():
        for j in range(len(symbols)):
            symbol, text = next(values)
            truth = symbol.node[0] in TRUTHS or isinstance(symbol.value, bool)
            if entries.get(text) != f"{array}[{j}]":  # an unchanged entry is not written
                lines.append(f"{array}[{j}] = {f'({text} ? 1 : 0)' if truth else text};")
    return "\n".join((*lines, "}")) + "\n"


def _declaration(statement: tuple[str, str, bool]) -> str:
    name, text, truth = statement
    return f"const {'int' if truth else 'real'} {name} = {text};"


def parameters(arguments: Arrays, results: Arrays) -> Sequence[str]:
    """Return the parameters of a plain function: the arguments, then the other results; without empty arrays."""
    return [array for array, entries in {**arguments, **results}.items() if len(entries)]


def tangent_function(name: str, language: Language, precision: str) -> str:
    """Return the source of a function that returns the hyperbolic tangent of a number."""
    graph = Graph()
    result = hyperbolic_tangent(graph.input("x"), precision, SYMBOLS)
    statements, (text,) = written_statements(graph, [result], language, {"x": "x"})
    return (
        "\n".join((f"static real {name}(real x)", "{", *map(_declaration, statements), f"return {text};", "}")) + "\n"
    )
