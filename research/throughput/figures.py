"""What a benchmark gives: one number, what it should be, and what it was measured from."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

SCENARIO = "cruise-storm"  # every disturbance at once
_LARGE = 1000.0  # from here on no digits behind the point are written
_UNITS = (("s", 1.0), ("ms", 1e3), ("us", 1e6), ("ns", 1e9))  # of times, and how many of each make a second


@dataclass(frozen=True)
class Figure:
    """One measured number."""

    case: str
    value: float
    unit: str  # "x": how many times faster than a peer; "s": seconds; "share"; "MiB"
    goal: float | None = None  # at least that many times, else at most that
    ours: float | None = None  # [s] what a ratio was made of
    peer: float | None = None  # [s]

    @property
    def met(self) -> bool | None:
        """Whether the goal is met; None where there is none."""
        if self.goal is None:
            return None
        return self.value >= self.goal if self.unit == "x" else self.value <= self.goal

    @property
    def text(self) -> str:
        """The number with its unit."""
        return written(self.value, self.unit)

    @property
    def goal_text(self) -> str:
        """The goal with its unit."""
        return "" if self.goal is None else written(self.goal, self.unit)


Case: TypeAlias = Callable[[bool], Iterator[Figure]]
"""Yields figures; True asks for a quick form, which says whether all of it still runs, not how fast."""


def written(value: float, unit: str) -> str:
    """Return a number with its unit, seconds in a handy multiple."""
    if unit != "s":
        return f"{value:,.0f} {unit}" if value >= _LARGE else f"{value:.3g} {unit}"
    name, factor = next(((n, f) for n, f in _UNITS if abs(value) * f >= 1), _UNITS[-1])
    return f"{value * factor:.3g} {name}"


def faster(case: str, ours: float, peer: float, goal: float | None = None) -> Figure:
    """Return how many times faster ours [s] is than a peer [s]."""
    return Figure(case, peer / ours, "x", goal, ours, peer)


def takes(case: str, seconds: float, goal: float | None = None) -> Figure:
    """Return how long something takes [s]."""
    return Figure(case, seconds, "s", goal)
