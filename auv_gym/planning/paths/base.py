"""What every path is and is made with: the protocol, checks, and placing a curve in the world."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import fields
from numbers import Real
from typing import Any, Protocol, runtime_checkable

import numpy as np

from auv_gym.physics.intervals import is_float
from auv_gym.physics.namespaces import Array

UniformRange = Callable[[], float]
"""Returns the next random number in [0, 1)."""


@runtime_checkable
class Path(Protocol):
    """Anything with a position and three continuous time derivatives on a domain of times."""

    @property
    def speed(self) -> float:
        """Nominal speed [m/s], the scale of the path's velocities."""

    @property
    def start(self) -> float:
        """First time of the domain [s], -inf if there is none."""

    @property
    def end(self) -> float:
        """Last time of the domain [s], inf if there is none."""

    def derivatives(self, t: Array) -> Array:
        """Return position [m] and its first three time derivatives.

        Args:
            t: times [s], ascending along axis 0: any shape, or (T, 1) for a path of N stacked ones.

        Returns:
            Index 0 counts the derivatives, index 1 is x, y; shape (4, 2, *t.shape), or (4, 2, T, N) if stacked.
        """


def is_number(value: Any, kind: str) -> bool:
    """Whether every entry is a finite number, also "positive" or "not zero" if `kind` says so."""
    if type(value) is float:  # by far the most frequent, in a hundredth of the time
        return math.isfinite(value) and (not kind or value > 0 or (kind == "not zero" and value != 0))
    if isinstance(value, int | bool) and not is_float(value):
        return False
    if not isinstance(value, Real | np.ndarray):
        return False
    numbers = np.asarray(value, dtype=np.float64)
    right = numbers > 0 if kind == "positive" else numbers != 0 if kind == "not zero" else True
    return bool(np.all(np.isfinite(numbers) & right))


def validate(path: Any, positive: Sequence[str] = (), nonzero: Sequence[str] = (), triples: Sequence[str] = ()) -> None:
    """Raise ValueError for the first field that is not finite, positive, not zero or three numbers, as it must be."""
    for name in (field.name for field in fields(path)):
        value = getattr(path, name)
        kind = "positive" if name in positive else "not zero" if name in nonzero else ""
        if name in triples:
            valid = isinstance(value, Sequence | np.ndarray) and len(value) == 3
            valid = valid and all(is_number(entry, kind) for entry in value)
        else:
            valid = is_number(value, kind)
        if not valid:
            rule = ("three numbers, each " if name in triples else "") + "finite" + (f" and {kind}" if kind else "")
            raise ValueError(f"{type(path).__name__}: {name} must be {rule}, got {value!r}")


def place(pose: Any, *local: tuple[Any, Any]) -> Array:
    """Rotate position and derivatives (x, y) by the path's heading and move them to (x0, y0): shape (4, 2, ...)."""
    c, s = np.cos(pose.heading), np.sin(pose.heading)
    shape = np.broadcast(pose.x0, pose.y0, c, *(row for pair in local for row in pair)).shape
    placed = np.empty((4, 2, *shape))
    for (x, y), row in zip(local, placed, strict=True):
        row[0], row[1] = c * x - s * y, s * x + c * y
    placed[0, 0] += pose.x0
    placed[0, 1] += pose.y0
    return placed
