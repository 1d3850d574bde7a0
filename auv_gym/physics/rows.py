"""Converts nested NamedTuples of numbers to plain rows and back; it defines the position of each name in a row.

class Point(NamedTuple):
    x: Number
    y: Number

class Arrow(NamedTuple):
    foot: Point
    length: Number

places = numbered(Arrow)  # Arrow(foot=Point(x=0, y=1), length=2)
arrow = unflatten(places, (0.5, 2.0, 3.0))  # Arrow(foot=Point(x=0.5, y=2.0), length=3.0)
flatten(arrow)  # (0.5, 2.0, 3.0)
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count
from typing import Any, TypeVar, get_type_hints

import numpy as np

from auv_gym.physics.namespaces import Array

T = TypeVar("T", bound=tuple[Any, ...])


def numbered(cls: type[T]) -> T:
    """Return a nested NamedTuple with the index of each number in the row of all numbers.

    Fields with a default are last. They are not part of the row, here and in the other functions, and keep the default.
    """
    places = count()

    def instance(kind: Any) -> Any:
        types = get_type_hints(kind)
        hints = (types.get(name) for name in kind._fields if name not in kind._field_defaults)
        return kind(*(instance(hint) if hasattr(hint, "_fields") else next(places) for hint in hints))

    made: T = instance(cls)
    return made


def flatten(tree: Any) -> tuple[Any, ...]:
    """Return the numbers of a nested NamedTuple as a row."""
    numbers: tuple[Any, ...] = ()
    first = 0
    end = len(tree) - len(tree._field_defaults)
    for k in range(end):
        if isinstance(tree[k], tuple):
            numbers += (*tree[first:k], *flatten(tree[k]))
            first = k + 1
    rest: tuple[Any, ...] = tree[first:end]
    return numbers + rest


def unflatten(places: T, rows: Sequence[Any]) -> T:
    """Return the nested NamedTuple of a row of numbers, arrays or tensors; `places` is from `numbered`."""
    tree: Any = places
    fields = tree[: len(tree) - len(tree._field_defaults)]
    made: T = type(tree)(*(unflatten(place, rows) if isinstance(place, tuple) else rows[place] for place in fields))
    return made


def spread(numbers: Sequence[Any], n: int) -> Array:
    """Return floats, or rows of shape (n,), as one array of shape (len(numbers), n)."""
    if n == 1:  # they are floats
        return np.array(numbers, dtype=np.float64)[:, None]
    rows = np.empty((len(numbers), n))
    for row, number in zip(rows, numbers, strict=True):
        row[:] = number
    return rows
