"""The chart of a film: the position errors of all policies so far, on one axis."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from auv_gym.rendering.canvas import GRID, MUTED, WHITE, Canvas, Color
from auv_gym.rendering.cards import round_down
from baselines.video.recording import Recording

_LEFT = 46.0  # [units] left of the curves
RIGHT = 14.0  # [units] right of them
ABOVE = 26.0  # [units] above them
BELOW = 24.0  # [units] below them
HIGHEST = 5.0
"""The axis ends at the largest error of all, or at so many times the largest one of the best policy."""


class Chart:
    """Draws errors over time.

    Args:
        canvas: what to draw on, all of it.
        recordings: whose errors.
        colors: of their curves.
    """

    def __init__(self, canvas: Canvas, recordings: Sequence[Recording], colors: Sequence[Color]) -> None:
        self._canvas, self._curves = canvas, list(zip(recordings, colors, strict=True))
        self._width, self._height = canvas.extent.tolist()
        largest = [max(float(recording.error.max()), 1e-3) for recording in recordings]
        self._top = min(max(largest), HIGHEST * min(largest))  # [m]
        self._duration = max(float(recording.time[-1]) for recording in recordings)  # [s]
        across, up = self._width - _LEFT - RIGHT, self._height - ABOVE - BELOW
        self._inside = canvas.part((_LEFT, ABOVE - 4.0, across, up + 6.0))
        self._scale = np.array((across / self._duration, -up / self._top))  # [units/s, units/m]
        self._origin = np.array((0.0, up + 4.0))  # of the curves in their part [units]

    def draw(self, time: float) -> None:
        """Draw the axes, the curves up to a time [s], and a line where that is."""
        canvas, floor = self._canvas, self._height - BELOW
        canvas.fill(WHITE)
        canvas.text("distance to the reference [m]", 10.0, 12.0, size=14.0, color=MUTED)
        step, tick = round_down(0.5 * self._top), round_down(0.25 * self._duration)
        for k in range(math.floor(self._top / step) + 1):
            y = floor + k * step * float(self._scale[1])
            canvas.box((_LEFT, y, self._width - _LEFT - RIGHT, 1.0), GRID)
            canvas.text(f"{k * step:g}", _LEFT - 6.0, y, size=13.0, color=MUTED, align=1.0)
        for k in range(math.floor(self._duration / tick) + 1):
            x = _LEFT + k * tick * float(self._scale[0])
            canvas.text(f"{k * tick:g} s", x, floor + 12.0, size=13.0, color=MUTED, align=0.5)
        canvas.box((_LEFT + min(time, self._duration) * float(self._scale[0]), ABOVE, 1.0, floor - ABOVE), MUTED)
        for recording, color in self._curves:
            upto = recording.time <= time
            times = np.append(recording.time[upto], min(time, float(recording.time[-1])))
            errors = np.append(recording.error[upto], recording.at(time).error)
            self._inside.line(self._origin + np.stack((times, errors), axis=1) * self._scale, color, 2.5)
