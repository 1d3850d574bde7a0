"""The protocol of a path, the base class of families, checks of their fields, and the placement of a curve."""

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
    """A position with three continuous time derivatives on a domain of times."""

    @property
    def speed(self) -> float:
        """Nominal speed [m/s], the scale of the path's velocities."""

    @property
    def start(self) -> float:
        """First time of the domain [s]; -inf if it is unbounded."""

    @property
    def end(self) -> float:
        """Last time of the domain [s]; inf if it is unbounded."""

    def derivatives(self, t: Array) -> Array:
        """Return position [m] and its first three time derivatives.

        Args:
            t: times [s], ascending along axis 0: of any shape, or (T, 1) for N paths that are stacked.

        Returns:
            An array (4, 2, *t.shape), or (4, 2, T, N) if stacked; axis 0 is the order of the derivative, axis 1 x, y.
        """


class OfPath:
    """A path with the nominal speed and the domain of a planar one, its field `path`."""

    path: Path

    @property
    def speed(self) -> float:
        """Nominal speed of the planar path [m/s]."""
        return self.path.speed

    @property
    def start(self) -> float:
        """First time of the domain [s]."""
        return self.path.start

    @property
    def end(self) -> float:
        """Last time of the domain [s]."""
        return self.path.end


_ROUNDING = 1e-9  # tolerance at the ends of the domain [s]


def checked_times(path: Path, t: Array) -> Array:
    """Return times [s] as an array; raise ValueError if one is outside the domain of a path from 0 to `end`."""
    t = np.asarray(t, dtype=np.float64)
    if not np.all((t >= -_ROUNDING) & (t <= path.end + _ROUNDING)):
        name = type(path).__name__
        raise ValueError(f"{name}: times must be in 0 ... {path.end:.9g} s, got {t.min():.9g} ... {t.max():.9g} s")
    return t


def is_number(value: Any, kind: str) -> bool:
    """Return whether all entries are finite numbers, and also "positive" or "not zero" if `kind` is one of these."""
    if type(value) is float:  # the most frequent case, in a hundredth of the time
        return math.isfinite(value) and (not kind or value > 0 or (kind == "not zero" and value != 0))
    if isinstance(value, int | bool) and not is_float(value):
        return False
    if not isinstance(value, Real | np.ndarray):
        return False
    numbers = np.asarray(value, dtype=np.float64)
    right = numbers > 0 if kind == "positive" else numbers != 0 if kind == "not zero" else True
    return bool(np.all(np.isfinite(numbers) & right))


def validate(path: Any, positive: Sequence[str] = (), nonzero: Sequence[str] = (), triples: Sequence[str] = ()) -> None:
    """Raise ValueError for the first invalid field of a path; fields must be finite numbers.

    Args:
        path: a dataclass.
        positive: names of the fields that must be positive.
        nonzero: names of the fields that must not be zero.
        triples: names of the fields that must be three numbers.
    """
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
"""The last fields of every family: start or centre of the curve [m], and its rotation [rad]."""


class Family(ABC):
    """A curve that is a formula of time, for all times, with a pose.

    A subclass is a frozen dataclass whose last fields are those of `POSE`. Its formulas are elementwise: the fields may
    be arrays of shape (N,), see `auv_gym.planning.paths.stack`, or symbols.
    """

    start: ClassVar[float] = -math.inf
    end: ClassVar[float] = math.inf

    x0: float
    y0: float
    heading: float

    @property
    def numbers(self) -> Sequence[float]:
        """The arguments of the compiled formulas, without the pose."""
        return list(vars(self).values())[: -len(POSE)]

    @classmethod
    def member(cls, *numbers: Number, **others: Number) -> Self:
        """Return the path with these fields, without a check: the distribution that it is drawn from was checked."""
        path, defaults = object.__new__(cls), {field.name: field.default for field in fields(cls)}  # type: ignore[arg-type]
        path.__dict__.update(defaults)
        path.__dict__.update(zip(defaults, numbers, strict=False), **others)
        return path

    @abstractmethod
    def formulas(self, t: Number, ns: Namespace) -> Pairs:
        """Return the curve at a time [s] in its own frame, without the pose."""

    def derivatives(self, t: Array) -> Array:
        """See `Path.derivatives`."""
        return as_array(placed(self.formulas(t, ARRAYS), (self.x0, self.y0, self.heading), ARRAYS))


def placed(pairs: Pairs, pose: Sequence[Number], ns: Namespace) -> Pairs:
    """Return a curve after rotation by a heading and translation; the pose is x0, y0 [m] and the heading [rad]."""
    x0, y0, heading = pose
    c, s = ns.cos(heading), ns.sin(heading)
    (x, y), *rates = (to_world(x, y, c, s) for x, y in pairs)
    return ((x + x0, y + y0), *rates)


def as_array(pairs: Pairs) -> Array:
    """Return pairs of arrays, whose shapes can be broadcast, as one array (4, 2, ...)."""
    shape = np.broadcast(*(number for pair in pairs for number in pair)).shape
    array = np.empty((len(pairs), 2, *shape))
    for row, pair in zip(array, pairs, strict=True):
        row[0], row[1] = pair
    return array
