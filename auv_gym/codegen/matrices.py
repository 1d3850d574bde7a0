"""Linear algebra on symbols, expanded to operations on entries; entries that are known to be zero cost nothing.

A matrix is a sequence of rows. A symmetric matrix has the same symbol at (i, j) and (j, i), which is computed once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from auv_gym.codegen.graph import Symbol

MatrixRow = Sequence[Any]
Matrix = Sequence[MatrixRow]


def dot(a: MatrixRow, b: MatrixRow) -> Any:
    """Return the sum of a_k b_k without the terms that are known to be zero; 0.0 if all are."""
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
    nonzeros = [sum(not is_zero(x) for x in row) for row in A]
    half = [[dot(row, column) for column in P] for row in A]
    entries = []
    for i in range(len(A)):
        for j in range(i + 1):
            dense, sparse = (j, i) if nonzeros[i] <= nonzeros[j] else (i, j)  # the fewest products
            entries.append(dot(half[dense], A[sparse]))
    return symmetric(entries)


def solution(A: Matrix, B: Matrix) -> list[list[Any]]:
    """Return X of A X = B for a positive definite A, by elimination, which needs no pivots then."""
    n = len(A)
    rows = [[*a, *b] for a, b in zip(A, B, strict=True)]
    for k in range(n):
        for i in range(k + 1, n):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [x - factor * y if j > k else 0.0 for j, (x, y) in enumerate(zip(rows[i], rows[k], strict=True))]
    X: list[list[Any]] = [[] for _ in rows]
    for k in reversed(range(n)):
        known = [dot(rows[k][k + 1 : n], column) for column in zip(*X[k + 1 :], strict=True)] or [0.0] * len(B[k])
        X[k] = [(x - y) / rows[k][k] for x, y in zip(rows[k][n:], known, strict=True)]
    return X


def symmetric(triangle: Sequence[Any]) -> list[list[Any]]:
    """Return the symmetric matrix of a lower triangle, given row by row."""
    rows: list[Sequence[Any]] = []
    while (at := len(rows) * (len(rows) + 1) // 2) < len(triangle):
        rows.append(triangle[at : at + len(rows) + 1])
    return [[rows[max(i, j)][min(i, j)] for j in range(len(rows))] for i in range(len(rows))]


def triangle(P: Matrix) -> list[Any]:
    """Return the lower triangle of a matrix, row by row."""
    return [x for i, row in enumerate(P) for x in row[: i + 1]]


def diagonal(entries: Sequence[Any]) -> list[list[Any]]:
    """Return the diagonal matrix of these entries."""
    return [[x if i == j else 0.0 for j in range(len(entries))] for i, x in enumerate(entries)]
