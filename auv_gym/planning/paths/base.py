"""What every path is and is made with: the protocol, checks, and placing a curve in the world."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import fields
from numbers import Real
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, TypeAlias, runtime_checkable

import numpy as np

if TYPE_CHECKING:
    from typing_extensions import Self

from auv_gym.physics.errors import to_world
from auv_gym.physics.intervals import is_float
from auv_gym.physics.namespaces import ARRAYS, Array, Namespace, Number

Pairs: TypeAlias = Sequence[tuple[Number, Number]]
"""x, y and their first three time derivatives."""


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


POSE = ("x0", "y0", "heading")
"""The last fields of every family: where a curve begins or is centred [m], and which way it is turned [rad]."""


class Family(ABC):
    """Curves that are given by formulas of time, for all times, and are placed in the world.

    A subclass is a frozen dataclass whose last fields are those of `POSE`. It is elementwise: its fields may be arrays
    of shape (N,), made by `auv_gym.planning.paths.stack`, or symbols.
    """

    start: ClassVar[float] = -math.inf
    end: ClassVar[float] = math.inf

    x0: float
    y0: float
    heading: float

    @property
    def numbers(self) -> Sequence[float]:
        """What its compiled formulas take of it besides its pose."""
        return list(vars(self).values())[: -len(POSE)]

    @classmethod
    def member(cls, *numbers: Number, **others: Number) -> Self:
        """Return the path of these fields without a check, which a distribution that has been checked need not have."""
        path, kinds = object.__new__(cls), fields(cls)  # type: ignore[arg-type]
        path.__dict__.update((field.name, field.default) for field in kinds)
        path.__dict__.update(zip((field.name for field in kinds), numbers, strict=False), **others)
        return path

    @abstractmethod
    def formulas(self, t: Number, ns: Namespace) -> Pairs:
        """Return the curve at a time [s], before it is turned by its heading and moved to (x0, y0)."""

    def derivatives(self, t: Array) -> Array:
        """See `Path.derivatives`."""
        return as_array(placed(self.formulas(t, ARRAYS), (self.x0, self.y0, self.heading), ARRAYS))


def placed(pairs: Pairs, pose: Sequence[Number], ns: Namespace) -> Pairs:
    """Return a curve turned by a heading and moved: the pose is x0, y0 [m] and the heading [rad]."""
    x0, y0, heading = pose
    c, s = ns.cos(heading), ns.sin(heading)
    (x, y), *rates = (to_world(x, y, c, s) for x, y in pairs)
    return ((x + x0, y + y0), *rates)


def as_array(pairs: Pairs) -> Array:
    """Return pairs of arrays, shapes that fit together, as one array (4, 2, ...)."""
    shape = np.broadcast(*(number for pair in pairs for number in pair)).shape
    array = np.empty((len(pairs), 2, *shape))
    for row, pair in zip(array, pairs, strict=True):
        row[0], row[1] = pair
    return array
