"""Draws the frames of a video: a title, a legend, a panel for each policy, and a chart of the errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array
from auv_gym.rendering.camera import Camera, View
from auv_gym.rendering.canvas import ALERT, CURRENT_COLOUR, INK, MUTED, WHITE, Canvas, Color
from auv_gym.rendering.cards import round_down
from auv_gym.rendering.scene import Body, draw_ghost, draw_world
from baselines.video.chart import Chart
from baselines.video.recording import Instant, Trajectory

MOST_PANELS = 5
"""Largest number of policies in a video."""
TITLE = 34.0  # [units] height of the title
CHART = 0.27  # height of the chart as a fraction of the frame
NEAREST = 3.0  # [m] smallest range of a panel on each side of the reference
_FARTHEST = 9.0  # [m] largest range
PANEL = 285.0  # [units] smallest width of a panel without overlapping texts
_TRAIL = 25.0  # [s] duration of a trail
ARROW_SPEED = 1.5  # speed of an arrow of full length, as a multiple of the strongest current
WAVES: Color = (90, 90, 90)  # the arrow of the wave force; as long as that of the current at the strongest of both


@dataclass(frozen=True)
class Panel:
    """The panel of a policy."""

    trajectory: Trajectory
    label: str  # what kind of policy it is
    colour: Color


class FrameRenderer:
    """Draws the frames of a video of several policies in the same episode.

    Args:
        pygame: the module.
        size: width and height [px].
        title: text of the title.
        panels: one for each policy.
        path: planned positions (n, 2) [m].
        speed: playback speed, 1 for real time.
    """

    def __init__(
        self, pygame: Any, size: tuple[int, int], title: str, panels: Sequence[Panel], path: Array, speed: float
    ) -> None:
        self._canvas = Canvas(pygame, size, _unit_of(size[0], len(panels)))
        self._title, self._panels, self._path, self._speed = title, panels, path, speed
        self._width, self._height = self._canvas.extent.tolist()
        self._chart_top = (1.0 - CHART) * self._height
        errors = [p.trajectory.error for p in panels]
        self._reach = min(max(1.25 * max(float(e.max()) for e in errors), NEAREST), _FARTHEST)  # [m]
        strongest = max(float(np.hypot(*p.trajectory.current.T).max()) for p in panels)
        self._arrow = max(ARROW_SPEED * strongest, 0.02)  # [m/s]
        self._waves = max(float(np.hypot(*p.trajectory.waves.T).max()) for p in panels)  # [N]
        self._parts = self._panel_canvases()
        self._canvas.fill(WHITE)
        chart = self._canvas.part((0.0, self._chart_top, self._width, self._height - self._chart_top))
        self._chart = Chart(chart, [p.trajectory for p in panels], [p.colour for p in panels])

    def _panel_canvases(self) -> list[tuple[Canvas, Camera]]:
        """Return the canvas and camera of each panel."""
        gap, n = 4.0, len(self._panels)
        width = (self._width - gap * (n - 1)) / n
        parts = []
        for i in range(n):
            canvas = self._canvas.part((i * (width + gap), TITLE, width, self._chart_top - TITLE - 2.0))
            parts.append((canvas, Camera(canvas.extent)))
        return parts

    def frame_at(self, time: float) -> NDArray[np.uint8]:
        """Return the frame at a time of the episode [s], shape (height, width, 3)."""
        instants = [panel.trajectory.at(time) for panel in self._panels]
        self._canvas.box((0.0, 0.0, self._width, TITLE), WHITE)
        self._draw_title(time, instants[0].current)
        for panel, instant, (canvas, camera) in zip(self._panels, instants, self._parts, strict=True):
            self._draw_panel(panel, instant, canvas, camera, time)
        self._chart.draw(time)
        return self._canvas.pixels()

    def _draw_title(self, time: float, current: Array) -> None:
        """Draw the title, the time, and the legend of the symbols."""
        canvas, y = self._canvas, 0.5 * TITLE
        x = 10.0 + canvas.text(self._title, 10.0, y, size=17.0)
        played = f"{time:.0f} s, played {self._speed:g} times as fast" if self._speed != 1.0 else f"{time:.0f} s"
        canvas.text(played, x + 12.0, y, size=15.0, color=MUTED)
        x = self._width - 10.0
        colours = {"current": CURRENT_COLOUR, **({"wave force": WAVES} if self._waves else {})}
        for name, width in (*((name, 34.0) for name in colours), ("reference", 46.0)):
            x -= canvas.width_of(name, 15.0)
            canvas.text(name, x, y, size=15.0, color=MUTED)
            x -= width
            if name in colours:
                canvas.arrows(np.array([(x - 2.0, y)]), np.array((28.0, 0.0)), [colours[name]], 2.5)
            else:
                draw_ghost(canvas, Body(np.array((x + 18.0, y)), 0.0, 36.0))
            x -= 16.0

    def _draw_panel(self, panel: Panel, instant: Instant, canvas: Canvas, camera: Camera, time: float) -> None:
        """Draw the vehicle and its surroundings; the reference is in the centre of the panel."""
        trajectory = panel.trajectory
        x, y, psi = instant.reference.tolist()
        camera.look((x, y), self._reach, self._arrow)
        recent = trajectory.state[(trajectory.time <= time) & (trajectory.time >= time - _TRAIL), :2]
        view = View(
            time=time,
            state=tuple(instant.state.tolist()),
            reference=(x, y, psi),
            path=self._path,
            travelled=int(np.searchsorted(trajectory.time, time, side="right")) - 1,
            trail=np.vstack((recent, instant.state[:2])),
            current=tuple(instant.current.tolist()),
            force=(0.0, 0.0),
            force_limits=(1.0, 1.0),
            position_error=instant.error,
            title="",
        )
        draw_world(canvas, camera, view, panel.colour, velocity=False)
        if self._waves:
            arrow = camera.arrow(instant.waves * (self._arrow / self._waves))
            canvas.arrows(camera.project(instant.state[None, :2]), arrow, [WAVES], 2.5)
        width, height = canvas.extent.tolist()
        canvas.card((8.0, 8.0, width - 16.0, 50.0))
        canvas.box((18.0, 18.0, 8.0, 30.0), panel.colour, radius=3.0)
        ended = trajectory.failed and time >= trajectory.time[-1]
        now = "failed" if ended else f"{100 * instant.error:.1f} cm off"
        mean = f"{100 * float(trajectory.error[trajectory.time <= time].mean()):.1f} cm on average"
        for name, size, value, large, y, colors in (
            (panel.label, 16.0, now, 18.0, 24.0, (INK, ALERT)),
            (trajectory.policy, 13.0, mean, 13.0, 43.0, (MUTED, MUTED)),
        ):
            left = width - 64.0 - canvas.text(value, width - 18.0, y, size=large, color=colors[1], align=1.0)
            canvas.text(_shortened(canvas, name, size, left), 36.0, y, size=size, color=colors[0])
        bar = round_down(0.4 * self._reach)
        length = bar * camera.scale
        canvas.box((14.0, height - 14.0, length, 2.0), INK)
        canvas.text(f"{bar:g} m", 14.0 + 0.5 * length, height - 25.0, size=13.0, align=0.5)


def _unit_of(width: int, panels: int) -> float:
    """Return the size of a unit [px]: small enough for the texts of each panel to fit, but still legible."""
    return max(min(max(width / 960.0, 0.65), width / (PANEL * panels)), 0.55)


def _shortened(canvas: Canvas, text: str, size: float, width: float) -> str:
    """Return a text, shortened to a width [units] if it is wider."""
    if canvas.width_of(text, size) <= width:
        return text
    while text and canvas.width_of(f"{text}...", size) > width:
        text = text[:-1]
    return f"{text}..."
