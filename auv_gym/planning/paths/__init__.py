"""Planar paths x(t), y(t), three times continuously differentiable in time, with exact derivatives.

All families except `Spline` and `Legs` are subclasses of `Family`. Their fields may be arrays of shape (N,), see
`stack`; with times of shape (T, 1) such a path represents N paths. Angles are counter-clockwise from the x axis.
Positive turn rates are counter-clockwise.

A new family is a frozen dataclass with the members of `Path`, preferably a `Family`, an entry in `PATHS` and a test.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.planning.paths.base import Family, Path
from auv_gym.planning.paths.closed import PAPER_CIRCLE, Circle, Ellipse, FigureEight, Line, Sine
from auv_gym.planning.paths.legs import Legs
from auv_gym.planning.paths.spline import Spline
from auv_gym.planning.paths.turning import Lawnmower, RandomSmooth
from auv_gym.planning.paths.waypoints import WaypointWarning, from_geographic

__all__ = [
    "PAPER_CIRCLE",
    "PATHS",
    "Circle",
    "Ellipse",
    "Family",
    "FigureEight",
    "Lawnmower",
    "Legs",
    "Line",
    "Path",
    "RandomSmooth",
    "Sine",
    "Spline",
    "WaypointWarning",
    "evaluate_paths",
    "from_geographic",
    "stack",
    "unstack",
]

PATHS: dict[str, type] = {
    "line": Line,
    "circle": Circle,
    "sine": Sine,
    "ellipse": Ellipse,
    "figure_eight": FigureEight,
    "lawnmower": Lawnmower,
    "random_smooth": RandomSmooth,
    "spline": Spline,
    "legs": Legs,
}
"""The families by their names in scenarios."""


def stack(paths: Sequence[Path]) -> Path:
    """Return N paths of one family as one path, with fields of shape (N,), for times of shape (T, 1).

    Raises:
        ValueError: there is no path, more than one family, or a family that is no `Family`.
    """
    families = {type(path) for path in paths}
    if len(families) != 1 or not all(issubclass(family, Family) for family in families):
        allowed = ", ".join(sorted(family.__name__ for family in PATHS.values() if issubclass(family, Family)))
        got = ", ".join(sorted(family.__name__ for family in families)) or "none"
        raise ValueError(f"stack takes paths of one family out of {allowed}, got {got}")
    family: Any = families.pop()
    stacked: Path = object.__new__(family)  # without a check, since the paths were checked
    for field in fields(family):
        object.__setattr__(stacked, field.name, np.array([getattr(path, field.name) for path in paths]).T)
    return stacked


def unstack(paths: Path, n: int) -> list[Path]:
    """Return the n paths that `stack` has combined."""
    single: list[Path] = [object.__new__(type(paths)) for _ in range(n)]
    for name, value in vars(paths).items():
        triple = isinstance(value, tuple) or np.ndim(value) == 2
        rows = [np.broadcast_to(row, n).tolist() for row in (value if triple else (value,))]
        for path, numbers in zip(single, zip(*rows, strict=True), strict=True):
            object.__setattr__(path, name, numbers if triple else numbers[0])
    return single


def evaluate_paths(paths: Sequence[Path], t: Array) -> Array:
    """Return position and three time derivatives of N paths at times t [s] of shape (T,), an array (4, 2, T, N)."""
    t = np.asarray(t, dtype=np.float64)
    members: dict[type, list[int]] = {}
    for column, path in enumerate(paths):
        members.setdefault(type(path), []).append(column)
    out = np.empty((4, 2, len(t), len(paths)))
    for family, columns in members.items():
        where = slice(columns[0], columns[-1] + 1) if columns[-1] - columns[0] < len(columns) else columns
        if issubclass(family, Family):
            out[..., where] = stack([paths[k] for k in columns]).derivatives(t[:, None])
        else:
            for k in columns:
                out[..., k] = paths[k].derivatives(t)
    return out
