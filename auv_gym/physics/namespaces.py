"""Elementary functions for each kind of number, so that each equation has one copy.

An equation takes a `Namespace` and runs unchanged on Python floats (`FLOATS`), NumPy arrays (`ARRAYS`) and torch
tensors (`tensors()`). Functions that need no more than `sin` and `cos` also accept `sympy` in its place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

Number: TypeAlias = Any
"""A float, an array, a tensor or a symbol, as the namespace computes with."""
Array: TypeAlias = NDArray[np.float64]
"""An array of double precision."""
AnyArray: TypeAlias = NDArray[Any]
"""An array of any kind of numbers."""
Indices: TypeAlias = NDArray[np.int64]
"""An array of integers, for instance the indices of vehicles."""


class Constants(NamedTuple):
    """A constant for each of n rows."""

    numbers: tuple[float, ...]  # for torch, whose graphs may hold no NumPy
    array: NDArray[np.float64]  # shape (n,)
    column: NDArray[np.float64]  # shape (n, 1)

    @classmethod
    def of(cls, numbers: Any) -> Constants:
        """Return the constants of n numbers."""
        array = np.array(tuple(numbers))
        return cls(tuple(array.tolist()), array, array[:, None])


@dataclass(frozen=True, slots=True)
class Namespace:
    """The elementary functions of one kind of number, named as in NumPy, and operations of rows with constants."""

    sin: Callable[[Number], Number]
    cos: Callable[[Number], Number]
    sqrt: Callable[[Number], Number]
    exp: Callable[[Number], Number]
    log: Callable[[Number], Number]
    hypot: Callable[[Number, Number], Number]
    arctan2: Callable[[Number, Number], Number]
    arcsin: Callable[[Number], Number]
    floor: Callable[[Number], Number]
    clip: Callable[[Number, Number, Number], Number]
    where: Callable[[Number, Number, Number], Number]
    scaled: Callable[[Any, Constants], Any]  # rows, or a sequence of components, each times its constant; returns rows
    bounded: Callable[[Any, Constants], Any]  # rows, each clipped to +- its constant
    stack: Callable[..., Any]  # a sequence of rows as one array along an axis, the first one by default


def _clip(value: float, low: float, high: float) -> float:
    return low if value < low else high if value > high else value


def _clip_array(value: Number, low: Number, high: Number) -> Number:
    return np.minimum(np.maximum(value, low), high)  # a third of np.clip's cost on small arrays


def _scaled_floats(rows: Any, factors: Constants) -> Any:
    if isinstance(rows, np.ndarray):
        return rows * factors.array
    scaled = np.array(rows)
    scaled *= factors.array  # a third of the cost of a product with a tuple
    return scaled


def _scaled_arrays(rows: Any, factors: Constants) -> Any:
    scaled = np.array(rows, dtype=np.float64)  # rows stay contiguous: transposing takes a tenth of the time of a step
    scaled *= factors.column
    return scaled


def scaled_components(rows: Any, factors: Constants) -> list[Any]:
    """Return each component times its constant."""
    return [row * factor for row, factor in zip(rows, factors.numbers, strict=True)]


_IN_MATH = ("sin", "cos", "sqrt", "exp", "log", "hypot")
_IN_NUMPY = (*_IN_MATH, "arctan2", "arcsin", "floor", "where", "stack")  # torch has the same names
FLOATS = Namespace(
    **{name: getattr(math, name) for name in _IN_MATH},
    arctan2=math.atan2,
    arcsin=math.asin,
    floor=(1.0).__rfloordiv__,  # as math.floor, but also for nan and infinity
    clip=_clip,
    where=lambda condition, yes, no: yes if condition else no,
    scaled=_scaled_floats,
    bounded=lambda rows, bounds: _clip_array(rows, -bounds.array, bounds.array),
    stack=np.array,
)
"""The namespace of Python floats."""
ARRAYS = Namespace(
    **{name: getattr(np, name) for name in _IN_NUMPY},
    clip=_clip_array,
    scaled=_scaled_arrays,
    bounded=lambda rows, bounds: _clip_array(rows, -bounds.column, bounds.column),
)
"""The namespace of NumPy arrays, one row for each component."""


@cache
def tensors() -> Namespace:
    """Return the namespace of torch tensors; torch is imported by the first call."""
    import torch

    def clip(x: Any, low: Any, high: Any) -> Any:
        if isinstance(low, torch.Tensor) == isinstance(high, torch.Tensor):
            return torch.clamp(x, low, high)
        return torch.clamp(torch.clamp(x, min=low), max=high)  # torch.clamp takes two numbers or two tensors

    def bounded(rows: Any, bounds: Constants) -> Any:
        return [torch.clamp(x, -b, b) for x, b in zip(rows, bounds.numbers, strict=True)]

    functions = {name: getattr(torch, name) for name in _IN_NUMPY}
    return Namespace(**functions, clip=clip, scaled=scaled_components, bounded=bounded)


def wrap_angle(angle: Number, ns: Namespace = FLOATS) -> Number:
    """Return the angle [rad] plus the multiple of 2 pi that brings it into [-pi, pi)."""
    return angle - 2 * math.pi * ns.floor((angle + math.pi) / (2 * math.pi))


def sum_of(numbers: Iterable[Number]) -> Number:
    """Return the sum, in the order of the numbers."""
    first, *others = numbers
    for x in others:
        first = first + x
    return first


def sum_of_squares(numbers: Iterable[Number]) -> Number:
    """Return the sum of the squares, in their order."""
    first, *others = numbers
    total = first * first
    for x in others:
        total = total + x * x
    return total
