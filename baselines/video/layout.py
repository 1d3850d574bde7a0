"""How a moving picture looks: a title, a panel for each policy, a legend, and a chart of the errors below."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array
from auv_gym.rendering.camera import Camera, View
from auv_gym.rendering.canvas import ALERT, CURRENT_COLOUR, INK, MUTED, VEHICLE, WHITE, Canvas, Color
from auv_gym.rendering.cards import round_down
from auv_gym.rendering.scene import Body, draw_ghost, draw_world
from baselines.video.chart import Chart
from baselines.video.recording import Instant, Voyage

HULLS: tuple[Color, ...] = (VEHICLE, (0, 158, 115), (204, 121, 167), (90, 90, 90), (240, 228, 66))
"""Colours of vehicles and their errors, in the order of the policies."""
TITLE = 34.0  # [units] height of the title
CHART = 0.27  # height of the chart as a share of the picture
NEAREST = 3.0  # [m] what a panel shows on each side of the reference, at least
_FARTHEST = 9.0  # [m] what it shows at most
PANEL = 285.0  # [units] width of a panel in which everything finds its place
_TRAIL = 25.0  # [s] how far back a trail goes
ARROW_SPEED = 1.5  # an arrow of full length is that many times the strongest current


@dataclass(frozen=True)
class Panel:
    """A policy and how it is shown."""

    voyage: Voyage
    label: str  # what it is, for those who do not know its name
    hull: Color


class Picture:
    """Draws the moments of some voyages through the same sea.

    Args:
        pygame: the module.
        size: width and height [px].
        title: what sea it is.
        panels: what is shown.
        path: planned positions (n, 2) [m].
        speed: how many times faster than the vehicles it is played.
    """

    def __init__(
        self, pygame: Any, size: tuple[int, int], title: str, panels: Sequence[Panel], path: Array, speed: float
    ) -> None:
        self._canvas = Canvas(pygame, size, _unit_of(size[0], len(panels)))
        self._title, self._panels, self._path, self._speed = title, panels, path, speed
        self._width, self._height = self._canvas.extent.tolist()
        self._chart_top = (1.0 - CHART) * self._height
        errors = [p.voyage.error for p in panels]
        self._reach = min(max(1.25 * max(float(e.max()) for e in errors), NEAREST), _FARTHEST)  # [m]
        strongest = max(float(np.hypot(*p.voyage.current.T).max()) for p in panels)
        self._arrow = max(ARROW_SPEED * strongest, 0.02)  # [m/s]
        self._parts = self._laid_out()
        self._canvas.fill(WHITE)
        chart = self._canvas.part((0.0, self._chart_top, self._width, self._height - self._chart_top))
        self._chart = Chart(chart, [p.voyage for p in panels], [p.hull for p in panels])

    def _laid_out(self) -> list[tuple[Canvas, Camera]]:
        """Return the canvas and camera of each panel."""
        gap, n = 4.0, len(self._panels)
        width = (self._width - gap * (n - 1)) / n
        parts = []
        for i in range(n):
            canvas = self._canvas.part((i * (width + gap), TITLE, width, self._chart_top - TITLE - 2.0))
            parts.append((canvas, Camera(canvas.extent)))
        return parts

    def at(self, time: float) -> NDArray[np.uint8]:
        """Return the picture of a moment [s], shape (height, width, 3)."""
        instants = [panel.voyage.at(time) for panel in self._panels]
        self._canvas.box((0.0, 0.0, self._width, TITLE), WHITE)
        self._draw_title(time, instants[0].current)
        for panel, instant, (canvas, camera) in zip(self._panels, instants, self._parts, strict=True):
            self._draw_panel(panel, instant, canvas, camera, time)
        self._chart.draw(time)
        return self._canvas.pixels()

    def _draw_title(self, time: float, current: Array) -> None:
        """What sea it is and when, and what the symbols mean."""
        canvas, y = self._canvas, 0.5 * TITLE
        x = 10.0 + canvas.text(self._title, 10.0, y, size=17.0)
        played = f"{time:.0f} s, played {self._speed:g} times as fast" if self._speed != 1.0 else f"{time:.0f} s"
        canvas.text(played, x + 12.0, y, size=15.0, color=MUTED)
        x = self._width - 10.0
        for name, width in (("current", 34.0), ("where it should be", 46.0)):
            x -= canvas.width_of(name, 15.0)
            canvas.text(name, x, y, size=15.0, color=MUTED)
            x -= width
            if name == "current":
                canvas.arrows(np.array([(x - 2.0, y)]), np.array((28.0, 0.0)), [CURRENT_COLOUR], 2.5)
            else:
                draw_ghost(canvas, Body(np.array((x + 18.0, y)), 0.0, 36.0))
            x -= 16.0

    def _draw_panel(self, panel: Panel, instant: Instant, canvas: Canvas, camera: Camera, time: float) -> None:
        """The vehicle, seen from its reference, which stays in the middle."""
        voyage = panel.voyage
        x, y, psi = instant.reference.tolist()
        camera.look((x, y), self._reach, self._arrow)
        recent = voyage.state[(voyage.time <= time) & (voyage.time >= time - _TRAIL), :2]
        view = View(
            time=time,
            state=tuple(instant.state.tolist()),
            reference=(x, y, psi),
            path=self._path,
            trail=np.vstack((recent, instant.state[:2])),
            current=tuple(instant.current.tolist()),
            force=(0.0, 0.0),
            force_limits=(1.0, 1.0),
            position_error=instant.error,
            title="",
        )
        travelled = int(np.searchsorted(voyage.time, time, side="right")) - 1
        draw_world(canvas, camera, view, travelled, panel.hull, velocity=False)
        width, height = canvas.extent.tolist()
        canvas.card((8.0, 8.0, width - 16.0, 50.0))
        canvas.box((18.0, 18.0, 8.0, 30.0), panel.hull, radius=3.0)
        ended = voyage.failed and time >= voyage.time[-1]
        now = "failed" if ended else f"{instant.error:.2f} m off"
        mean = f"{float(voyage.error[voyage.time <= time].mean()):.3f} m on average"
        for name, size, value, large, y, colors in (
            (panel.label, 16.0, now, 18.0, 24.0, (INK, ALERT)),
            (voyage.policy, 13.0, mean, 13.0, 43.0, (MUTED, MUTED)),
        ):
            room = width - 64.0 - canvas.text(value, width - 18.0, y, size=large, color=colors[1], align=1.0)
            canvas.text(_fitted(canvas, name, size, room), 36.0, y, size=size, color=colors[0])
        bar = round_down(0.4 * self._reach)
        length = bar * camera.scale
        canvas.box((14.0, height - 14.0, length, 2.0), INK)
        canvas.text(f"{bar:g} m", 14.0 + 0.5 * length, height - 25.0, size=13.0, align=0.5)


def _unit_of(width: int, panels: int) -> float:
    """Return the unit [px] of a film: small enough for what is written in each panel, and legible still."""
    return max(min(max(width / 960.0, 0.65), width / (PANEL * panels)), 0.55)


def _fitted(canvas: Canvas, text: str, size: float, width: float) -> str:
    """Return a text, shortened where it would be wider than that [units]."""
    if canvas.width_of(text, size) <= width:
        return text
    while text and canvas.width_of(f"{text}...", size) > width:
        text = text[:-1]
    return f"{text}..."
