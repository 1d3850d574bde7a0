"""The chart of a video: the position errors of all policies over time."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from auv_gym.rendering.canvas import GRID, MUTED, WHITE, Canvas, Color
from auv_gym.rendering.cards import round_down
from baselines.video.recording import Trajectory

_LEFT = 58.0  # [units] left margin of the curves
RIGHT = 14.0  # [units] right margin
ABOVE = 26.0  # [units] top margin
BELOW = 24.0  # [units] bottom margin
_TICKS = ((1e-4, "0.1 mm"), (1e-3, "1 mm"), (1e-2, "1 cm"), (0.1, "10 cm"), (1.0, "1 m"), (10.0, "10 m"))
"""The ticks of the logarithmic axis [m]."""


class Chart:
    """Draws errors over time, on a logarithmic axis.

    Args:
        canvas: the area of the chart.
        trajectories: one for each curve.
        colors: one for each curve.
    """

    def __init__(self, canvas: Canvas, trajectories: Sequence[Trajectory], colors: Sequence[Color]) -> None:
        self._canvas, self._curves = canvas, list(zip(trajectories, colors, strict=True))
        self._width, self._height = canvas.extent.tolist()
        usual, largest = (
            min(float(np.median(v.error)) for v in trajectories),
            max(v.error.max() for v in trajectories),
        )
        low = float(np.clip(0.1 * usual, _TICKS[0][0], 0.1))
        self._ticks = [(e, text) for e, text in _TICKS if low <= e <= max(1.5 * float(largest), 20 * low)]
        self._low, high = math.log10(low), math.log10(max(1.5 * float(largest), 20 * low))
        self._duration = max(float(trajectory.time[-1]) for trajectory in trajectories)  # [s]
        across, up = self._width - _LEFT - RIGHT, self._height - ABOVE - BELOW
        self._inside = canvas.part((_LEFT, ABOVE - 4.0, across, up + 6.0))
        self._scale = np.array((across / self._duration, -up / (high - self._low)))  # [units/s, units/decade]
        self._origin = np.array((0.0, up + 4.0))  # of the curves in their area [units]

    def draw(self, time: float) -> None:
        """Draw the axes, the curves up to a time [s], and a vertical line at that time."""
        canvas, floor = self._canvas, self._height - BELOW
        canvas.fill(WHITE)
        canvas.text("distance to the reference", 10.0, 12.0, size=14.0, color=MUTED)
        tick = round_down(0.25 * self._duration)
        for error, text in self._ticks:
            y = floor + (math.log10(error) - self._low) * float(self._scale[1])
            canvas.box((_LEFT, y, self._width - _LEFT - RIGHT, 1.0), GRID)
            canvas.text(text, _LEFT - 6.0, y, size=13.0, color=MUTED, align=1.0)
        for k in range(math.floor(self._duration / tick) + 1):
            x = _LEFT + k * tick * float(self._scale[0])
            canvas.text(f"{k * tick:g} s", x, floor + 12.0, size=13.0, color=MUTED, align=0.5)
        canvas.box((_LEFT + min(time, self._duration) * float(self._scale[0]), ABOVE, 1.0, floor - ABOVE), MUTED)
        for trajectory, color in self._curves:
            upto = trajectory.time <= time
            times = np.append(trajectory.time[upto], min(time, float(trajectory.time[-1])))
            errors = np.append(trajectory.error[upto], trajectory.at(time).error)
            heights = np.log10(np.maximum(errors, 10**self._low)) - self._low
            self._inside.line(self._origin + np.stack((times, heights), axis=1) * self._scale, color, 2.5)
