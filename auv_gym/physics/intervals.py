"""A number that is either known or drawn uniformly from an interval, and the checks that all parameters share."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import TypeAlias

Interval: TypeAlias = float | tuple[float, float]
"""A fixed value, or (low, high) for a uniform distribution."""
Uniform: TypeAlias = Callable[[], float]
"""Returns the next number of an independent uniform stream in [0, 1)."""


def draw(interval: Interval, uniform: Uniform) -> float:
    """Return the fixed value, or a number from the interval; one number of the stream is used either way."""
    u = uniform()
    if isinstance(interval, tuple):
        low, high = interval
        return low + (high - low) * u
    return interval


def mean_square(interval: Interval) -> float:
    """Return the mean of the square of what is drawn."""
    low, high = interval if isinstance(interval, tuple) else (interval, interval)
    return (low * low + low * high + high * high) / 3


def is_float(value: object) -> bool:
    """Whether a value is a number, and no integer that is too large to compute with; nan is none, infinity is one."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return not math.isnan(value) if isinstance(value, float) else abs(value) <= sys.float_info.max


def check_number(name: str, value: object, low: float = -math.inf, high: float = math.inf) -> None:
    """Raise ValueError unless value is a number in [low, high]; infinity passes only where a bound is infinite."""
    if not is_float(value) or not low <= value <= high:  # type: ignore[operator]
        raise ValueError(f"{name} is {value!r}; it must be a number in [{low:g}, {high:g}]")


def check_interval(name: str, value: object, low: float = -math.inf, high: float = math.inf) -> None:
    """Raise ValueError unless value is a finite number in [low, high] or an ordered pair of them."""
    ends = value if isinstance(value, tuple) else (value,)
    if isinstance(value, tuple) and len(ends) != 2:
        raise ValueError(f"{name} is {value!r}; it must be a number or a pair (low, high)")
    for end in ends:
        check_number(name, end, low, high)
        if math.isinf(end):
            raise ValueError(f"{name} is {value!r}; it must be finite")
    if ends[0] > ends[-1]:
        raise ValueError(f"{name} is {value!r}; low must not be above high")
