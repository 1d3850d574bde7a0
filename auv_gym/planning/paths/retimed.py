"""Another path at another pace."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.planning.paths.base import DOMAIN_ROUNDING, Path, by_time, is_number, lowest, times_of


@dataclass(frozen=True)
class Retimed:
    """A path with another time law: at the time t it is where the other path is at s(t), from t = 0 to t = `end`.

    The rate s'(t), 1 for the pace of the other path, is a cubic spline through `rates`, with zero slope at both ends.

    Raises:
        ValueError: a number is not positive, there are fewer than four rates, the spline is not positive everywhere, or
            the other path is too short.
    """

    path: Path
    interval: float  # [s] from one of the rates to the next
    rates: tuple[float, ...]  # s'(0), s'(interval), ...

    start: ClassVar[float] = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.path, Path):
            raise ValueError(f"Retimed: path must be a path, got {self.path!r}")
        if not is_number(self.interval, "positive"):
            raise ValueError(f"Retimed: interval must be finite and positive, got {self.interval!r}")
        if not isinstance(self.rates, Sequence) or len(self.rates) < 4:
            raise ValueError(f"Retimed: rates must be four or more numbers, got {self.rates!r}")
        if wrong := [rate for rate in self.rates if not is_number(rate, "positive")]:
            raise ValueError(f"Retimed: rates must be finite and positive, got {wrong[0]!r}")
        object.__setattr__(self, "rates", tuple(float(rate) for rate in self.rates))
        if (least := lowest(self._law.derivative())[1]) <= 0:
            raise ValueError(f"Retimed: the rate must stay positive between the given ones, got {least:.4g}")
        if not self.path.start <= 0 or not self._law(self.end) <= self.path.end + DOMAIN_ROUNDING:
            raise ValueError(
                f"Retimed: the other path must be defined from 0 to {self._law(self.end):.9g} s; it is from "
                f"{self.path.start:.9g} to {self.path.end:.9g} s"
            )

    @property
    def speed(self) -> float:
        """Nominal speed of the other path [m/s]."""
        return self.path.speed

    @property
    def end(self) -> float:
        """Duration [s]."""
        return (len(self.rates) - 1) * self.interval

    @cached_property
    def _law(self) -> Any:
        """s(t), a scipy PPoly."""
        from scipy.interpolate import CubicSpline

        times = self.interval * np.arange(len(self.rates))
        return CubicSpline(times, self.rates, bc_type="clamped").antiderivative()

    def derivatives(self, t: Array) -> Array:
        """See `Path.derivatives`.

        Raises:
            ValueError: a time is outside 0 ... `end`.
        """
        t = times_of(self, t)
        s, *rates = (self._law(t, order) for order in range(4))
        return by_time(self.path.derivatives(np.clip(s, 0.0, self.path.end)), *rates)
