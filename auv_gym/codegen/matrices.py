"""Linear algebra on symbols, written out entry by entry; what is zero beforehand costs nothing.

A matrix is a sequence of rows. A symmetric one has the same symbol at (i, j) and (j, i), so that it is computed once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from auv_gym.codegen.graph import Symbol

MatrixRow = Sequence[Any]
Matrix = Sequence[MatrixRow]


def dot(a: MatrixRow, b: MatrixRow) -> Any:
    """Return the sum of a_k b_k, 0.0 if nothing is left of it."""
    terms = [x * y for x, y in zip(a, b, strict=True) if not (is_zero(x) or is_zero(y))]
    return sum(terms[1:], start=terms[0]) if terms else 0.0


def is_zero(x: Any) -> bool:
    """Return whether an entry is known to be zero."""
    return bool((x.value if isinstance(x, Symbol) else x) == 0.0)


def product(A: Matrix, B: Matrix) -> list[list[Any]]:
    """Return A B."""
    columns = list(zip(*B, strict=True))
    return [[dot(row, column) for column in columns] for row in A]


def congruence(A: Matrix, P: Matrix) -> list[list[Any]]:
    """Return A P A^T for a symmetric P."""
    filled = [sum(not is_zero(x) for x in row) for row in A]
    half = [[dot(row, column) for column in P] for row in A]
    entries = []
    for i in range(len(A)):
        for j in range(i + 1):
            full, empty = (j, i) if filled[i] <= filled[j] else (i, j)  # the fewest products
            entries.append(dot(half[full], A[empty]))
    return symmetric(entries)


def symmetric(triangle: Sequence[Any]) -> list[list[Any]]:
    """Return the matrix of a lower triangle, given row by row."""
    rows: list[Sequence[Any]] = []
    while (at := len(rows) * (len(rows) + 1) // 2) < len(triangle):
        rows.append(triangle[at : at + len(rows) + 1])
    return [[rows[max(i, j)][min(i, j)] for j in range(len(rows))] for i in range(len(rows))]


def triangle(P: Matrix) -> list[Any]:
    """Return the lower triangle of a matrix, row by row."""
    return [x for i, row in enumerate(P) for x in row[: i + 1]]


def diagonal(entries: Sequence[Any]) -> list[list[Any]]:
    """Return the matrix with these entries on its diagonal."""
    return [[x if i == j else 0.0 for j in range(len(entries))] for i, x in enumerate(entries)]
