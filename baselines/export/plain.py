"""A graph as a plain C99 function for one vehicle, for programs that do not use this package.

A function reads and writes arrays of the type `real`. The same array may be read and written, since all values are read
first. Sine, cosine, exponential and arctangent are expanded, so the bits are those of the compiled kernels. Another
language with expressions like those of C can be printed, too; then the declarations are to be replaced.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from auv_gym.codegen.elementary import hyperbolic_tangent, lowered
from auv_gym.codegen.graph import SYMBOLS, TRUTHS, Graph, Symbol
from auv_gym.codegen.printing import Arrays, Language, written_statements
from baselines.export.sums import long_sums


def plain_function(
    name: str,
    graph: Graph,
    arguments: Arrays,
    results: Arrays,
    language: Language,
    precision: str,
    loops: bool = False,
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
        loops: whether long sums become loops over tables, for C only. The bits are the same.
    """
    flat = lowered(graph, [s for entries in results.values() for s in entries], precision)
    blocks: list[_Loop] = []
    if loops:
        graph, flat, blocks = _with_loops(graph, flat)
    factors = [factor for block in blocks for factor in block.factors]
    computed = [*flat, *factors]
    read = {graph.nodes[i][1] for i in graph.needed(s.index for s in computed) if graph.nodes[i][0] == "input"}
    entries = {s.node[1]: f"{array}[{j}]" for array, symbols in arguments.items() for j, s in enumerate(symbols)}
    statements, texts = written_statements(graph, computed, language, {entry: entry for entry in read})
    places = dict(zip((factor.index for factor in factors), texts[len(flat) :], strict=True))
    read -= {entry for block in blocks for entry in block.sums}
    taken = parameters(arguments, results)
    declared = [f"{'' if array in results else 'const '}real *{array}" for array in taken]
    ignored = [a for a in taken if a not in results and not any(s.node[1] in read for s in arguments[a])]
    lines = [f"static void {name}({', '.join(declared)})", "{", *(f"(void){array};" for array in ignored)]
    lines += [f"const real {entry} = {place};" for entry, place in entries.items() if entry in read]
    for statement in statements:
        while blocks and int(statement[0][1:]) > blocks[0].place:
            lines += blocks.pop(0).lines(language, places)
        lines.append(_declaration(statement))
    lines += [line for block in blocks for line in block.lines(language, places)]
    values = iter(zip(flat, texts, strict=False))
    for array, symbols in results.items():
        for j in range(len(symbols)):
            symbol, text = next(values)
            truth = symbol.node[0] in TRUTHS or isinstance(symbol.value, bool)
            if entries.get(text) != f"{array}[{j}]":  # an unchanged entry is not written
                lines.append(f"{array}[{j}] = {f'({text} ? 1 : 0)' if truth else text};")
    return "\n".join((*lines, "}")) + "\n"


@dataclass(frozen=True)
class _Loop:
    """Long sums as a loop over a table."""

    name: str
    place: int  # the node before which it must stand
    sums: Sequence[str]  # inputs of the graph
    factors: Sequence[Symbol]
    matrix: Sequence[Sequence[float]]

    def lines(self, language: Language, places: Mapping[int, str]) -> list[str]:
        """Return the statements; `places` has the expressions of the factors."""
        name, n, m = self.name, len(self.sums), len(self.factors)
        factors = ", ".join(places[factor.index] for factor in self.factors)
        table = ", ".join(language.number(c) for row in self.matrix for c in row)
        return [
            f"static const real {name}_table[{n * m}] = {{{table}}};",
            f"const real {name}_factors[{m}] = {{{factors}}};",
            f"real {name}[{n}];",
            f"for (int i = 0; i < {n}; i++) {{",
            f"{name}[i] = {name}_table[{m} * i] * {name}_factors[0];",
            f"for (int j = 1; j < {m}; j++) {name}[i] = {name}[i] + {name}_table[{m} * i + j] * {name}_factors[j];",
            "}",
        ]


def _with_loops(graph: Graph, wanted: Sequence[Symbol]) -> tuple[Graph, list[Symbol], list[_Loop]]:
    """Return a graph in which long sums are inputs, the wanted symbols in it, and the loops for the inputs."""
    products, needed = long_sums(graph, {s.index for s in wanted})
    entries = {i: (k, j) for k, product in enumerate(products) for j, i in enumerate(product.sums)}
    new, symbols, loops = Graph(), dict[int, Symbol](), list[_Loop]()
    for i in needed:
        operation, *arguments = graph.nodes[i]
        if i in entries:
            k, j = entries[i]
            names = [f"sums{k}[{entry}]" for entry in range(len(products[k].sums))]
            if j == 0:
                place, factors = len(new.nodes), [symbols[f] for f in products[k].factors]
                loops.append(_Loop(f"sums{k}", place, names, factors, products[k].matrix))
            symbols[i] = new.input(names[j])
        elif operation == "input":
            symbols[i] = new.input(arguments[0])
        elif operation == "constant":
            symbols[i] = new.constant(arguments[0])
        else:
            symbols[i] = new.apply(operation, *(symbols[a] for a in arguments))
    return new, [symbols[s.index] for s in wanted], loops


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
