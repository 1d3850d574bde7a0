"""Draws the frames of a video: a title, a legend, a panel for each policy, and a chart of the errors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array
from auv_gym.rendering.camera import Camera, View
from auv_gym.rendering.canvas import ALERT, CURRENT_COLOUR, GRID, INK, MUTED, SIDE, WHITE, Canvas, Color
from auv_gym.rendering.cards import draw_depths, round_down
from auv_gym.rendering.scene import Body, draw_ghost, draw_world
from baselines.video.recording import Instant, RecordedEpisode

MOST_PANELS = 5
"""Largest number of policies in a video."""
_TITLE = 34.0  # [units] height of the title
_CHART = 0.27  # height of the chart as a fraction of the frame
_LEFT, _RIGHT, _ABOVE, _BELOW = 58.0, 14.0, 26.0, 24.0  # [units] margins of its curves
_TICKS = ((1e-4, "0.1 mm"), (1e-3, "1 mm"), (1e-2, "1 cm"), (0.1, "10 cm"), (1.0, "1 m"), (10.0, "10 m"))
"""The ticks of its logarithmic axis [m]."""
_NEAREST, _FARTHEST = 3.0, 9.0  # [m] smallest and largest range of a panel on each side of the reference
_PANEL = 285.0  # [units] smallest width of a panel without overlapping texts
_TRAIL = 25.0  # [s] duration of a trail
_ARROW_SPEED = 1.5  # speed of an arrow of full length, as a multiple of the strongest current
_WAVES: Color = (90, 90, 90)  # the arrow of the wave force; as long as that of the current at the strongest of both


class Panel(NamedTuple):
    """The panel of a policy."""

    trajectory: RecordedEpisode
    label: str  # what kind of policy it is
    colour: Color


class FrameRenderer:
    """Draws the frames of a video of several policies in the same episode.

    Its size is in pixels, `paths` has the planned positions (n, 2) [m], in space also those from the side, which is the
    lower part of a panel. A playback speed of 1 is real time.
    """

    def __init__(
        self,
        pygame: Any,
        size: tuple[int, int],
        title: str,
        panels: Sequence[Panel],
        paths: Sequence[Array],
        speed: float,
    ) -> None:
        width = size[0]  # a unit is small enough for the texts of each panel to fit, but still legible
        unit = max(min(max(width / 960.0, 0.65), width / (_PANEL * len(panels))), 0.55)  # [px]
        self._canvas = Canvas(pygame, size, unit)
        self._title, self._panels, self._paths, self._speed = title, panels, paths, speed
        self._width, self._height = self._canvas.extent.tolist()
        largest = max(float(panel.trajectory.error.max()) for panel in panels)
        self._reach = min(max(1.25 * largest, _NEAREST), _FARTHEST)  # [m]
        strongest = max(float(np.hypot(*p.trajectory.current.T).max()) for p in panels)
        self._arrow = max(_ARROW_SPEED * strongest, 0.02)  # [m/s]
        self._waves = max(float(np.hypot(*p.trajectory.waves.T).max()) for p in panels)  # [N]
        self._canvas.fill(WHITE)
        gap, top = 4.0, (1.0 - _CHART) * self._height  # of the chart
        across = (self._width - gap * (len(panels) - 1)) / len(panels)
        boxes = [(i * (across + gap), _TITLE, across, top - _TITLE - 2.0) for i in range(len(panels))]
        parts = [self._canvas.part(box) for box in boxes]
        split = [part.split(SIDE) if len(paths) > 1 else (part,) for part in parts]
        self._parts = [[(view, Camera(view.extent)) for view in views] for views in split]
        self._chart = Chart(self._canvas.part((0.0, top, self._width, self._height - top)), panels)

    def frame_at(self, time: float) -> NDArray[np.uint8]:
        """Return the frame at a time of the episode [s], shape (height, width, 3)."""
        instants = [panel.trajectory.at(time) for panel in self._panels]
        self._canvas.box((0.0, 0.0, self._width, _TITLE), WHITE)
        self._draw_title(time, instants[0].current)
        for panel, instant, ((canvas, camera), *below) in zip(self._panels, instants, self._parts, strict=True):
            self._draw_scene(panel.trajectory, self._paths[0], canvas, camera, time, panel.colour)
            self._draw_texts(panel, instant, canvas, camera, time)
            if panel.trajectory.side:
                self._draw_scene(panel.trajectory.side, self._paths[1], *below[0], time, panel.colour)
                draw_depths(*below[0])
        self._chart.draw(time)
        return self._canvas.pixels()

    def _draw_title(self, time: float, current: Array) -> None:
        """Draw the title, the time, and the legend of the symbols."""
        canvas, y = self._canvas, 0.5 * _TITLE
        x = 10.0 + canvas.text(self._title, 10.0, y, size=17.0)
        played = f"{time:.0f} s, played {self._speed:g} times as fast" if self._speed != 1.0 else f"{time:.0f} s"
        canvas.text(played, x + 12.0, y, size=15.0, color=MUTED)
        x = self._width - 10.0
        colours = {"current": CURRENT_COLOUR, **({"wave force": _WAVES} if self._waves else {})}
        for name, width in (*((name, 34.0) for name in colours), ("reference", 46.0)):
            x -= canvas.width_of(name, 15.0)
            canvas.text(name, x, y, size=15.0, color=MUTED)
            x -= width
            if name in colours:
                canvas.arrows(np.array([(x - 2.0, y)]), np.array((28.0, 0.0)), [colours[name]], 2.5)
            else:
                draw_ghost(canvas, Body(np.array((x + 18.0, y)), 0.0, 36.0))
            x -= 16.0

    def _draw_scene(
        self,
        trajectory: RecordedEpisode,
        path: Array,
        canvas: Canvas,
        camera: Camera,
        time: float,
        colour: Color,
    ) -> None:
        """Draw the vehicle and its surroundings; the reference is in the centre."""
        instant, from_side = trajectory.at(time), path is not self._paths[0]
        x, y, psi = instant.reference.tolist()
        camera.look((x, y), self._reach, self._arrow)
        recent = trajectory.state[(trajectory.time <= time) & (trajectory.time >= time - _TRAIL), :2]
        view = View(
            time=time,
            state=tuple(instant.state.tolist()),
            reference=(x, y, psi),
            path=path,
            travelled=int(np.searchsorted(trajectory.time, time, side="right")) - 1,
            trail=np.vstack((recent, instant.state[:2])),
            current=tuple(instant.current.tolist()),
            force=(0.0, 0.0),
            force_limits=(1.0, 1.0),
            position_error=instant.error,
            title="",
        )
        draw_world(canvas, camera, view, colour, velocity=False, surface=from_side)
        if self._waves:
            arrow = camera.arrow(instant.waves * (self._arrow / self._waves))
            canvas.arrows(camera.project(instant.state[None, :2]), arrow, [_WAVES], 2.5)

    def _draw_texts(self, panel: Panel, instant: Instant, canvas: Canvas, camera: Camera, time: float) -> None:
        """Draw name and errors of a policy, and the scale."""
        trajectory = panel.trajectory
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


class Chart:
    """The position errors of all policies over time, on a logarithmic axis, in the area of a canvas."""

    def __init__(self, canvas: Canvas, panels: Sequence[Panel]) -> None:
        self._canvas, self._panels = canvas, panels
        self._width, self._height = canvas.extent.tolist()
        usual = min(float(np.median(panel.trajectory.error)) for panel in panels)
        largest = max(float(panel.trajectory.error.max()) for panel in panels)
        low = float(np.clip(0.1 * usual, _TICKS[0][0], 0.1))
        high = max(1.5 * largest, 20 * low)
        self._ticks = [(e, text) for e, text in _TICKS if low <= e <= high]
        self._low, high = math.log10(low), math.log10(high)
        self._duration = max(float(panel.trajectory.time[-1]) for panel in panels)  # [s]
        across, up = self._width - _LEFT - _RIGHT, self._height - _ABOVE - _BELOW
        self._inside = canvas.part((_LEFT, _ABOVE - 4.0, across, up + 6.0))
        self._scale = np.array((across / self._duration, -up / (high - self._low)))  # [units/s, units/decade]
        self._origin = np.array((0.0, up + 4.0))  # of the curves in their area [units]

    def draw(self, time: float) -> None:
        """Draw the axes, the curves up to a time [s], and a vertical line at that time."""
        canvas, floor = self._canvas, self._height - _BELOW
        canvas.fill(WHITE)
        canvas.text("distance to the reference", 10.0, 12.0, size=14.0, color=MUTED)
        tick = round_down(0.25 * self._duration)
        for error, text in self._ticks:
            y = floor + (math.log10(error) - self._low) * float(self._scale[1])
            canvas.box((_LEFT, y, self._width - _LEFT - _RIGHT, 1.0), GRID)
            canvas.text(text, _LEFT - 6.0, y, size=13.0, color=MUTED, align=1.0)
        for k in range(math.floor(self._duration / tick) + 1):
            x = _LEFT + k * tick * float(self._scale[0])
            canvas.text(f"{k * tick:g} s", x, floor + 12.0, size=13.0, color=MUTED, align=0.5)
        now = _LEFT + min(time, self._duration) * float(self._scale[0])
        canvas.box((now, _ABOVE, 1.0, floor - _ABOVE), MUTED)
        for trajectory, _, colour in self._panels:
            upto = trajectory.time <= time
            times = np.append(trajectory.time[upto], min(time, float(trajectory.time[-1])))
            errors = np.append(trajectory.error[upto], trajectory.at(time).error)
            heights = np.log10(np.maximum(errors, 10**self._low)) - self._low
            self._inside.line(self._origin + np.stack((times, heights), axis=1) * self._scale, colour, 2.5)


def _shortened(canvas: Canvas, text: str, size: float, width: float) -> str:
    """Return a text, shortened to a width [units] if it is wider."""
    shorter = text
    while canvas.width_of(shorter, size) > width and text:
        text = text[:-1]
        shorter = f"{text}..."
    return shorter
