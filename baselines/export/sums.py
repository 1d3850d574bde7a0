"""Long sums of constants times numbers in a graph, such as the gains of the filters, as products with a matrix.

Code with a statement for each of their terms is a megabyte, and a runtime of ONNX takes minutes to load such a model.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from auv_gym.codegen.graph import Graph, arguments_of

LONG = 16
"""Fewest terms of a long sum."""


@dataclass(frozen=True)
class Product:
    """Sums with the same factors, in the order of the graph."""

    sums: Sequence[int]  # nodes, the first one first
    factors: Sequence[int]  # nodes, in the order in which their products are added
    matrix: Sequence[Sequence[float]]  # a row of constants for each sum


def long_sums(graph: Graph, wanted: Iterable[int]) -> tuple[list[Product], list[int]]:
    """Return the long sums that some nodes of a graph need, and all nodes that are needed then, in their order."""
    found: dict[int, dict[int, float]] = {}
    needed, open_ = set[int](), list(wanted)
    while open_:
        if (i := open_.pop()) not in needed:
            needed.add(i)
            if len(terms := _terms(graph, i)) >= LONG:
                found[i] = terms
            open_ += found[i] if i in found else arguments_of(graph.nodes[i])
    groups: dict[frozenset[int], list[int]] = {}
    for i in sorted(found):
        groups.setdefault(frozenset(found[i]), []).append(i)
    products = []
    for sums in groups.values():
        factors = list(found[sums[0]])[::-1]
        products.append(Product(sums, factors, [[found[i][f] for f in factors] for i in sums]))
    return products, sorted(needed)


def _terms(graph: Graph, i: int) -> dict[int, float]:
    """Return the constants of a sum by the nodes that they are multiplied by, the last first; {} if it has others."""
    terms: dict[int, float] = {}
    while graph.nodes[i][0] == "add":
        pairs = [(a, _product(graph, a)) for a in graph.nodes[i][1:]]
        products = [(a, product) for a, product in pairs if product is not None and product[0] not in terms]
        if not products:
            return {}
        term, product = products[-1]
        terms |= [product]
        (i,) = {a for a, _ in pairs} - {term} or {term}
        if (first := _product(graph, i)) is not None and first[0] not in terms:
            return terms | dict([first])
    return {}


def _product(graph: Graph, i: int) -> tuple[int, float] | None:
    """Return the node and the constant of a product of both, otherwise None."""
    operation, *arguments = graph.nodes[i]
    if operation == "mul":
        for a, b in (arguments, arguments[::-1]):
            if graph.nodes[a][0] == "constant":
                return b, graph.nodes[a][1]
    return None
