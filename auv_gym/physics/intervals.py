"""Numbers that are fixed or drawn uniformly from an interval, and checks of parameters."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from auv_gym.physics.namespaces import Number

Interval: TypeAlias = float | tuple[float, float]
"""A fixed value, or (low, high) for a uniform distribution."""
Uniform: TypeAlias = Callable[[], Number]
"""A function that returns the next number of a uniform stream in [0, 1), or of N streams, shape (N,)."""


def draw(interval: Interval, uniform: Uniform) -> Number:
    """Return the fixed value, or a number from the interval; both use one number of the stream."""
    u = uniform()
    if isinstance(interval, tuple):
        low, high = interval
        return low + (high - low) * u
    return interval


def draw_log(interval: Interval, uniform: Uniform) -> Number:
    """Return the fixed value, or a number from the interval whose logarithm is uniform; both use one number."""
    u = uniform()
    if isinstance(interval, tuple):
        low, high = interval
        return low * by_library(math.exp)(math.log(high / low) * u)
    return interval


def signed(value: Number, uniform: Uniform) -> Number:
    """Return a value with either sign."""
    return value * (1 - 2 * (uniform() >= 0.5))


def by_library(function: Callable[[float], float]) -> Callable[[Number], Number]:
    """Return a function of the C library that also takes rows.

    NumPy's functions may differ in the last digit, but an episode must not depend on the number of episodes that are
    drawn at once.
    """

    def apply(x: Number) -> Number:
        return np.array([*map(function, x.tolist())]) if isinstance(x, np.ndarray) else function(x)

    return apply


def times(interval: Interval, factor: float) -> Interval:
    """Return the value, or both ends of the interval, times a factor."""
    return (interval[0] * factor, interval[1] * factor) if isinstance(interval, tuple) else interval * factor


def mean_square(interval: Interval) -> float:
    """Return the mean square of the drawn number."""
    low, high = interval if isinstance(interval, tuple) else (interval, interval)
    return (low * low + low * high + high * high) / 3


def is_float(value: object) -> bool:
    """Return whether a value is a number, or a floating one of NumPy, that a float can represent; nan is none."""
    if isinstance(value, bool) or not isinstance(value, (int, float, np.floating)):
        return False
    return abs(value) <= sys.float_info.max if isinstance(value, int) else not math.isnan(value)


def check_number(name: str, value: object, low: float = -math.inf, high: float = math.inf) -> None:
    """Raise ValueError unless value is a number in [low, high]; infinity passes only where a bound is infinite."""
    if not is_float(value) or not low <= value <= high:  # type: ignore[operator]
        raise ValueError(f"{name} is {value!r}; it must be a number in [{low:g}, {high:g}]")


def check_interval(name: str, value: object, low: float = -math.inf, high: float = math.inf) -> None:
    """Raise ValueError unless value is a finite number in [low, high] or an ordered pair of them."""
    ends = value if isinstance(value, tuple) else (value,)
    are_numbers = all(is_float(end) and low <= end <= high and not math.isinf(end) for end in ends)
    if not are_numbers or len(ends) != (2 if isinstance(value, tuple) else 1):
        allowed = f"{'[' if low > -math.inf else '('}{low:g}, {high:g}{']' if high < math.inf else ')'}"
        raise ValueError(
            f"{name} is {value!r}; it must be a number in {allowed}, or a pair (low, high) of such numbers"
        )
    if ends[0] > ends[-1]:
        raise ValueError(f"{name} is {value!r}; low must not be above high")
