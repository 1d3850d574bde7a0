"""Pictures of a tracking vehicle: x to the right, y up, angles counter-clockwise, as in the paper's plots.

`Renderer.draw` turns one `View` (SI units) into one picture. Colours carry meaning and are safe for colour-blind
readers (Okabe-Ito): blue is the plan, orange the vehicle, sky blue the current, vermilion the error and saturation.
pygame is imported when a `Renderer` is made, never before.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from functools import lru_cache, partial
from itertools import pairwise
from types import ModuleType
from typing import Any, Final, Literal, NamedTuple, get_args

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Color = tuple[int, int, int]
RenderMode = Literal["human", "rgb_array"]

VEHICLE_LENGTH: Final = 2.0  # [m] about right for a neutrally buoyant torpedo of 200 kg
MIN_VEHICLE_LENGTH: Final = 46.0  # [units] below this the vehicle is drawn larger than to scale, and the scale says so
NEAR_EXTENT: Final = 8.0  # [m] half the height of the picture when the error is small
CAMERA_TIME: Final = 1.0  # [s] time constant of zoom and pan
ARROW_LENGTH: Final = 72.0  # [units] arrow of the fastest speed lately seen; velocity and current share this scale
ARROW_MEMORY: Final = 20.0  # [s] time constant with which that speed is forgotten
PICTURE: Final = (960.0, 720.0)  # [units] the layout's nominal size; a unit is a pixel at that size
OVERSAMPLING: Final = 2  # shapes are drawn this much larger and scaled down: smooth edges

SEA: Final[Color] = (243, 248, 251)
GRID: Final[Color] = (205, 219, 228)
INK: Final[Color] = (32, 48, 60)
MUTED: Final[Color] = (98, 116, 130)
WHITE: Final[Color] = (255, 255, 255)
PLAN: Final[Color] = (0, 114, 178)
PLAN_DONE: Final[Color] = (168, 200, 220)
VEHICLE: Final[Color] = (230, 159, 0)
VELOCITY: Final[Color] = (0, 110, 82)
CURRENT: Final[Color] = (86, 180, 233)
ALERT: Final[Color] = (213, 94, 0)

# The torpedo in units of its length: nose at x = 0.5, stern at x = -0.5, port is +y.
_BOW = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 13)
NOSE: Final[Array] = np.column_stack((0.32 + 0.18 * np.cos(_BOW), 0.1 * np.sin(_BOW)))
_STERN = [(-0.15, 0.1), (-0.32, 0.075), (-0.45, 0.035), (-0.45, -0.035), (-0.32, -0.075), (-0.15, -0.1)]
HULL: Final[Array] = np.vstack((NOSE, np.array(_STERN)))
_FIN = np.array([(-0.29, 0.07), (-0.36, 0.19), (-0.45, 0.19), (-0.43, 0.03)])
FINS: Final[tuple[Array, Array]] = (_FIN, _FIN * (1.0, -1.0))
PROPELLER: Final[Array] = np.array([(-0.47, 0.085), (-0.5, 0.085), (-0.5, -0.085), (-0.47, -0.085)])


class View(NamedTuple):
    """Everything one picture shows, in SI units; all finite, only the limits (positive) may be infinite."""

    time: float  # [s] going backwards starts a new history
    state: tuple[float, float, float, float, float, float]  # x, y [m], psi [rad], u, v [m/s] over ground, r [rad/s]
    reference: tuple[float, float, float]  # x, y [m], psi [rad]
    path: Array  # (n, 2) [m] planned path in the order it is travelled
    trail: Array  # (m, 2) [m] past positions, oldest first
    current: tuple[float, float]  # V_x, V_y [m/s]
    force: tuple[float, float]  # F_u [N], F_r [N m] as applied
    force_limits: tuple[float, float]  # F_u_max [N], F_r_max [N m]
    position_error: float  # [m]
    title: str  # the scenario's name


class Renderer:
    """Draws views to a window ("human") or to arrays ("rgb_array").

    A picture depends only on the views drawn so far. No display is needed or touched in "rgb_array".

    Args:
        render_mode: "human" or "rgb_array".
        fps: pictures per second [1/s] to which "human" is slowed down.
        size: width and height of the picture [px].

    Raises:
        ValueError: the mode is unknown, or fps or size is not positive.
        DependencyNotInstalled: pygame is missing.
    """

    def __init__(self, render_mode: RenderMode, fps: float, size: tuple[int, int] = (960, 720)) -> None:
        if render_mode not in get_args(RenderMode):
            raise ValueError(f"render_mode is {render_mode!r}; allowed: {', '.join(get_args(RenderMode))}")
        if not (fps > 0.0 and min(size) > 0):
            raise ValueError(f"fps and size must be positive; given: {fps}, {size}")
        self._pygame = _import_pygame()
        self._canvas = _Canvas(self._pygame, size)
        self._camera = _Camera(self._canvas.extent)
        self._progress = _Progress()
        self._last: View | None = None
        self._human, self._fps, self._size = render_mode == "human", fps, size
        self._window: Any = None
        self._clock: Any = None
        self._closed = False

    def draw(self, view: View) -> NDArray[np.uint8] | None:
        """Draw one picture.

        Returns:
            "rgb_array": a new uint8 array (H, W, 3). "human": None; once the window is closed nothing is drawn.
        """
        elapsed = _elapsed(self._last, view)
        self._last = view
        self._camera.update(view, elapsed)
        travelled = self._progress.update(view, elapsed)
        if self._human and not self._open_window():
            return None
        _draw_world(self._canvas, self._camera, view, travelled)
        _draw_overlay(self._canvas, self._camera, view)
        picture = self._canvas.finish()
        if not self._human:
            pixels = np.frombuffer(self._pygame.image.tobytes(picture, "RGB"), dtype=np.uint8)
            return pixels.reshape(self._size[1], self._size[0], 3).copy()
        self._window.blit(picture, (0, 0))
        self._pygame.display.flip()
        self._clock.tick(self._fps)
        return None

    def close(self) -> None:
        """Close the window, if there is one; may be called any number of times."""
        self._closed = True
        if self._window is not None:
            self._window = None
            self._pygame.display.quit()

    def _open_window(self) -> bool:
        """Open the window at first, answer its events, and say whether there still is one."""
        if self._window is None and not self._closed:
            self._pygame.display.init()
            self._window = self._pygame.display.set_mode(self._size)
            self._pygame.display.set_caption("auv_gym")
            self._clock = self._pygame.time.Clock()
        if self._window is not None and self._pygame.event.get(self._pygame.QUIT):
            self.close()
        return self._window is not None


def _import_pygame() -> ModuleType:
    """Import pygame with its fonts, or say what to install."""
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*pkg_resources", module="pygame")  # pygame <= 2.6
            import pygame
            import pygame.font
    except ImportError as error:
        raise DependencyNotInstalled('pygame is not installed, run `pip install "auv_gym[render]"`') from error
    pygame.font.init()
    return pygame


def _elapsed(last: View | None, view: View) -> float:
    """Time since the last picture [s]; inf where a new history starts: nothing before, time or vehicle set back."""
    if last is None or view.time < last.time:
        return math.inf
    moved = (*view.state, *view.reference) != (*last.state, *last.reference)
    return math.inf if moved and view.time == last.time else view.time - last.time


class _Camera:
    """World [m] to picture [units]: centred between vehicle and reference, with smooth pan and zoom."""

    def __init__(self, extent: Array) -> None:
        self.extent = extent  # (2,) width and height [units]
        self.center = np.zeros(2)  # [m]
        self.scale = 1.0  # [units/m]
        self.unit_speed = 0.0  # [m/s] the speed of an arrow of full length
        self._offset = np.zeros(2)  # [m] from the vehicle to the centre
        self._log_extent = 0.0  # log of half the picture's height [m]

    def update(self, view: View, elapsed: float) -> None:
        """Follow the view, `elapsed` after the one before; inf starts afresh."""
        gain = 1.0 - math.exp(-elapsed / CAMERA_TIME)
        vehicle, reference = np.array(view.state[:2]), np.array(view.reference[:2])
        gap = reference - vehicle
        self._offset = self._offset + gain * (0.5 * gap - self._offset)
        self.center = vehicle + self._offset
        wanted = math.log(max(NEAR_EXTENT, float(np.hypot(*gap))))
        self._log_extent += gain * (wanted - self._log_extent)
        farthest = max(np.hypot(*self._offset), np.hypot(*(gap - self._offset)))
        half_height = max(math.exp(self._log_extent), 1.3 * float(farthest))  # neither ever leaves the picture
        self.scale = 0.5 * float(self.extent.min()) / half_height
        fading = self.unit_speed * math.exp(-elapsed / ARROW_MEMORY)
        self.unit_speed = max(math.hypot(*view.state[3:5]), math.hypot(*view.current), fading, 0.02)

    def project(self, points: ArrayLike) -> Array:
        """World points (..., 2) [m] to picture points (..., 2) [units], y downwards."""
        offset: Array = (np.asarray(points, dtype=np.float64) - self.center) * self.scale
        return 0.5 * self.extent + offset * (1.0, -1.0)

    def arrow(self, velocity: ArrayLike) -> Array:
        """A velocity (2,) [m/s] as an arrow (2,) [units]."""
        return np.asarray(velocity, dtype=np.float64) * (1.0, -1.0) * ARROW_LENGTH / self.unit_speed

    def lattice(self, axis: int, spacing: float) -> NDArray[np.int64]:
        """The multiples of `spacing` [m] seen along an axis, as integers."""
        half = 0.5 * self.extent[axis] / self.scale
        low, high = (self.center[axis] - half) / spacing, (self.center[axis] + half) / spacing
        return np.arange(math.floor(low), math.ceil(high) + 1, dtype=np.int64)


class _Progress:
    """How far along the path the reference is; walks forward, so crossings and laps are told apart."""

    def __init__(self) -> None:
        self._index = 0

    def update(self, view: View, elapsed: float) -> int:
        """Index of the path's point nearest to the reference, at or after the one before; inf starts afresh."""
        if len(view.path) == 0:
            return 0
        distance = np.hypot(*(view.path - np.array(view.reference[:2])).T)
        if math.isinf(elapsed) or self._index >= len(distance):
            self._index = int(distance.argmin())
        while self._index + 1 < len(distance) and distance[self._index + 1] <= distance[self._index]:
            self._index += 1
        if distance[self._index] > distance.min() + VEHICLE_LENGTH:  # the reference has jumped
            self._index = int(distance.argmin())
        return self._index


class _Canvas:
    """Drawing in units of the nominal layout; shapes first, oversampled, then the texts on top."""

    def __init__(self, pygame: ModuleType, size: tuple[int, int]) -> None:
        self._pygame, self._size = pygame, size
        self._unit = min(size[0] / PICTURE[0], size[1] / PICTURE[1])  # [px]
        self._factor = OVERSAMPLING * self._unit
        self.extent: Array = np.array(size) / self._unit  # (2,) [units]
        self._surface = pygame.Surface((OVERSAMPLING * size[0], OVERSAMPLING * size[1]), depth=32)
        self._texts: list[tuple[Any, tuple[float, float]]] = []
        self._font: Callable[[int], Any] = lru_cache(maxsize=None)(partial(pygame.font.Font, None))

    def _pixels(self, points: ArrayLike) -> NDArray[np.int64]:
        scaled = np.asarray(points, dtype=np.float64) * self._factor
        return np.rint(np.minimum(np.maximum(scaled, -1e6), 1e6)).astype(np.int64)

    def fill(self, color: Color) -> None:
        self._surface.fill(color)

    def line(self, points: ArrayLike, color: Color, width: float) -> None:
        """A polyline (k, 2); fewer than two points draw nothing."""
        pixels = self._pixels(points)
        if len(pixels) > 1:
            thickness = max(1, round(width * self._factor))
            self._pygame.draw.lines(self._surface, color, False, pixels.tolist(), thickness)

    def polygon(self, points: ArrayLike, color: Color, alpha: int = 255) -> None:
        """A filled polygon (k, 2), translucent below alpha = 255."""
        pixels = self._pixels(points)
        if alpha == 255:
            self._pygame.draw.polygon(self._surface, color, pixels.tolist())
            return
        corner = pixels.min(axis=0)
        layer = self._pygame.Surface((pixels.max(axis=0) - corner + 1).tolist(), self._pygame.SRCALPHA, 32)
        self._pygame.draw.polygon(layer, (*color, alpha), (pixels - corner).tolist())
        self._surface.blit(layer, corner.tolist())

    def box(self, x: float, y: float, width: float, height: float, color: Color, radius: float = 0.0) -> None:
        """A filled rectangle with rounded corners."""
        corners = self._pixels([(x, y), (x + width, y + height)])
        rectangle = (*corners[0].tolist(), *(corners[1] - corners[0]).tolist())
        self._pygame.draw.rect(self._surface, color, rectangle, border_radius=round(radius * self._factor))

    def text(self, text: str, x: float, y: float, size: float = 17.0, color: Color = INK, align: float = 0.0) -> float:
        """One line with its middle at height y, from x (align 0), around x (0.5) or up to x (1); returns its width."""
        image = self._font(max(8, round(1.25 * size * self._unit))).render(text, True, color)
        width, height = image.get_size()
        self._texts.append((image, (x * self._unit - align * width, y * self._unit - 0.5 * height)))
        return float(width) / self._unit

    def finish(self) -> Any:
        """The picture as a pygame surface of the asked size."""
        picture = self._pygame.transform.smoothscale(self._surface, self._size)
        for image, corner in self._texts:
            picture.blit(image, corner)
        self._texts.clear()
        return picture


def _draw_world(canvas: _Canvas, camera: _Camera, view: View, travelled: int) -> None:
    """The scene from the bottom up."""
    canvas.fill(SEA)
    _draw_grid(canvas, camera)
    _draw_current(canvas, camera, view.current)
    path = camera.project(view.path)
    canvas.line(path[: travelled + 1], PLAN_DONE, 2.5)
    _draw_trail(canvas, camera.project(view.trail))
    canvas.line(path[travelled:], PLAN, 2.5)
    _draw_ghost(canvas, _body(camera, view.reference))
    _draw_vehicle(canvas, _body(camera, view.state[:3]))
    _draw_velocity(canvas, camera, view)
    _draw_error(canvas, camera, view)


def _draw_grid(canvas: _Canvas, camera: _Camera) -> None:
    """Lines every 1, 5, 10, 50 ... m; fine ones fade in as the camera comes closer."""
    for spacing in (m * 10.0**k for k in range(-2, 7) for m in (1, 5)):
        weight = min((spacing * camera.scale - 14.0) / 100.0, 1.0)
        if weight <= 0.0 or spacing * camera.scale > 4.0 * canvas.extent.max():
            continue
        color = _mix(SEA, GRID, weight)
        for axis in (0, 1):
            values = camera.lattice(axis, spacing) * spacing
            for position in camera.project(np.column_stack((values, values)))[:, axis].tolist():
                line = np.array([(position, 0.0), (position, canvas.extent[1 - axis])])
                canvas.line(line if axis == 0 else line[:, ::-1], color, 1.0)


def _draw_current(canvas: _Canvas, camera: _Camera, current: tuple[float, float]) -> None:
    """A sparse field of arrows, fixed in the world, none without current."""
    if math.hypot(*current) == 0.0:
        return
    arrow = camera.arrow(current)
    spacing = 2.0 ** math.ceil(math.log2(105.0 / camera.scale))  # [m] 105 ... 210 units
    odd = min((spacing * camera.scale - 105.0) / 40.0, 1.0)  # every other arrow fades in as the camera comes closer
    for i in camera.lattice(0, spacing).tolist():
        for j in camera.lattice(1, spacing).tolist():
            middle = camera.project((i * spacing, j * spacing))
            color = _mix(SEA, CURRENT, 0.75 * (odd if i % 2 or j % 2 else 1.0))
            _draw_arrow(canvas, middle - 0.5 * arrow, arrow, color, 2.0)


def _draw_trail(canvas: _Canvas, points: Array) -> None:
    """Past positions, paler with age."""
    cuts = np.unique(np.linspace(0, max(len(points) - 1, 0), 33).astype(int))
    for k, (start, stop) in enumerate(pairwise(cuts), start=1):
        canvas.line(points[start : stop + 1], _mix(SEA, VEHICLE, 0.15 + 0.85 * k / len(cuts)), 3.5)


def _draw_ghost(canvas: _Canvas, body: _Body) -> None:
    """The reference pose: a translucent torpedo with an outline."""
    for shape in (*FINS, HULL):
        points = body.place(shape)
        canvas.polygon(points, PLAN, alpha=45)
        canvas.line(np.vstack((points, points[:1])), PLAN, 1.5)


def _draw_vehicle(canvas: _Canvas, body: _Body) -> None:
    """The vehicle: propeller, fins, hull and nose."""
    for shape, color in ((PROPELLER, INK), *((fin, INK) for fin in FINS), (HULL, VEHICLE), (NOSE, INK)):
        points = body.place(shape)
        canvas.polygon(points, color)
        canvas.line(np.vstack((points, points[:1])), INK, 1.2)


def _draw_velocity(canvas: _Canvas, camera: _Camera, view: View) -> None:
    """The velocity over ground, from the centre of mass."""
    start, arrow = camera.project(view.state[:2]), camera.arrow(_ground_velocity(view.state))
    canvas.line([start, start + 0.75 * arrow], WHITE, 5.0)  # a halo against the hull
    _draw_arrow(canvas, start, arrow, VELOCITY, 3.0)


def _draw_error(canvas: _Canvas, camera: _Camera, view: View) -> None:
    """A dashed line from vehicle to reference, and its length in words to starboard."""
    start, stop = camera.project(view.state[:2]), camera.project(view.reference[:2])
    dashes = max(1, round(float(np.hypot(*(stop - start))) / 9.0))
    for k in range(dashes):
        canvas.line([start + (stop - start) * (k + part) / dashes for part in (0.0, 0.6)], ALERT, 2.5)
    clear = np.array((100.0, 62.0)) + min(0.5 * float(np.hypot(*(stop - start))), 40.0)  # of hull and ghost
    label = 0.5 * (start + stop) + clear * (math.sin(view.state[2]), math.cos(view.state[2]))
    _draw_panel(canvas, label[0] - 62.0, label[1] - 13.0, 124.0, 26.0)
    canvas.text(f"error {_metres(view.position_error)}", float(label[0]), float(label[1]), color=ALERT, align=0.5)


def _draw_overlay(canvas: _Canvas, camera: _Camera, view: View) -> None:
    """The four corners: numbers, legend, scale with axes, forces."""
    _draw_numbers(canvas, view)
    _draw_legend(canvas, camera, view)
    _draw_scale(canvas, camera)
    _draw_forces(canvas, view)


def _draw_numbers(canvas: _Canvas, view: View) -> None:
    """Top left: title, time, error, speed."""
    width = max(240.0, canvas.text(view.title, 28.0, 35.0, size=19.0) + 32.0)
    _draw_panel(canvas, 12.0, 12.0, width, 122.0)
    rows = (
        ("time", f"{view.time:.1f} s", INK),
        ("position error", _metres(view.position_error), ALERT),
        ("speed over ground", f"{math.hypot(*view.state[3:5]):.2f} m/s", INK),
    )
    for row, (name, value, color) in enumerate(rows):
        canvas.text(name, 28.0, 64.0 + 24.0 * row, color=MUTED)
        canvas.text(value, width - 4.0, 64.0 + 24.0 * row, color=color, align=1.0)


def _draw_legend(canvas: _Canvas, camera: _Camera, view: View) -> None:
    """Top right: what the symbols mean; its arrows are as long as those in the scene."""
    names = ["vehicle", "reference", "path done, ahead", "trail", "velocity", "current"]
    speeds = math.hypot(*view.state[3:5]), math.hypot(*view.current)
    names = names if speeds[1] > 0.0 else names[:-1]
    left = float(canvas.extent[0]) - 268.0
    _draw_panel(canvas, left, 12.0, 256.0, 26.0 + 24.0 * len(names))
    middle = np.array([(left + 54.0, 37.0 + 24.0 * row) for row in range(6)])
    start, half = middle - (ARROW_LENGTH / 2.0, 0.0), np.array((ARROW_LENGTH / 2.0, 0.0))
    _draw_vehicle(canvas, _Body(middle[0], 0.0, 44.0))
    _draw_ghost(canvas, _Body(middle[1], 0.0, 44.0))
    canvas.line([start[2], middle[2]], PLAN_DONE, 2.0)
    canvas.line([middle[2], middle[2] + half], PLAN, 2.0)
    _draw_trail(canvas, np.linspace(start[3], middle[3] + half, 37))
    for row, speed, color in ((4, speeds[0], VELOCITY), (5, speeds[1], CURRENT)):
        length = ARROW_LENGTH * speed / camera.unit_speed
        _draw_arrow(canvas, middle[row] - (0.5 * length, 0.0), np.array((length, 0.0)), color, 2.5)
    for row, name in enumerate(names):
        canvas.text(name, left + 104.0, float(middle[row][1]), color=MUTED)
    for row, speed in enumerate(speeds[: len(names) - 4], start=4):
        canvas.text(f"{speed:.2f} m/s", left + 242.0, float(middle[row][1]), align=1.0)


def _draw_scale(canvas: _Canvas, camera: _Camera) -> None:
    """Bottom left: the axes, a bar of a round length, and how large the vehicle is drawn."""
    bottom = float(canvas.extent[1]) - 12.0
    _draw_panel(canvas, 12.0, bottom - 92.0, 276.0, 92.0)
    corner = np.array((32.0, bottom - 20.0))
    for arrow in ((40.0, 0.0), (0.0, -40.0)):
        _draw_arrow(canvas, corner, np.array(arrow), INK, 2.0)
    canvas.text("x", 82.0, bottom - 20.0, align=0.5)
    canvas.text("y", 32.0, bottom - 74.0, align=0.5)
    length = _round_down(150.0 / camera.scale)
    bar = np.array([(104.0, bottom - 44.0), (104.0 + length * camera.scale, bottom - 44.0)])
    canvas.line(bar, INK, 2.5)
    for end in bar:
        canvas.line(end + np.array([(0.0, -5.0), (0.0, 5.0)]), INK, 2.5)
    canvas.text(f"{length:g} m", float(bar[:, 0].mean()), bottom - 64.0, align=0.5)
    enlarged = MIN_VEHICLE_LENGTH / (VEHICLE_LENGTH * camera.scale)
    note = f"enlarged {enlarged:.1f} times" if enlarged > 1.05 else "drawn to scale"
    canvas.text(f"vehicle {note}", 104.0, bottom - 20.0, size=14.0, color=MUTED)


def _draw_forces(canvas: _Canvas, view: View) -> None:
    """Bottom right: surge force and yaw torque as bars about zero, up to their limits."""
    left, top = float(canvas.extent[0]) - 308.0, float(canvas.extent[1]) - 128.0
    _draw_panel(canvas, left, top, 296.0, 116.0)
    names = ("surge force", "N"), ("yaw torque", "N m")
    for row, ((name, unit), force, limit) in enumerate(zip(names, view.force, view.force_limits, strict=True)):
        y = top + 22.0 + 53.0 * row
        share = max(-1.0, min(1.0, force / limit))  # an infinite limit leaves the bar empty
        saturated = abs(share) > 0.999
        bound = f"of {limit:g} {unit}" if math.isfinite(limit) else f"{unit}, no limit"
        color = ALERT if saturated else INK
        canvas.text(f"{name}, at limit" if saturated else name, left + 14.0, y, size=15.0, color=MUTED)
        canvas.text(f"{round(force, 1) + 0.0:.1f} {bound}", left + 282.0, y, size=15.0, color=color, align=1.0)
        canvas.box(left + 14.0, y + 12.0, 268.0, 12.0, GRID, radius=3.0)
        start, width = left + 148.0, 134.0 * share
        canvas.box(min(start, start + width), y + 12.0, abs(width), 12.0, ALERT if saturated else PLAN)
        canvas.line([(start, y + 10.0), (start, y + 26.0)], INK, 1.5)


class _Body(NamedTuple):
    """Where and how large a torpedo is drawn: middle [units], psi [rad], length [units]."""

    middle: Array
    psi: float
    length: float

    def place(self, shape: Array) -> Array:
        """A shape (k, 2) in units of the length to picture points (k, 2)."""
        cos, sin = math.cos(self.psi), math.sin(self.psi)
        turn = np.array([(cos, -sin), (-sin, -cos)])  # the picture's y points down
        points: Array = self.middle + self.length * shape @ turn
        return points


def _body(camera: _Camera, pose: tuple[float, float, float]) -> _Body:
    """A torpedo at a pose x, y [m], psi [rad], never smaller than legible."""
    return _Body(camera.project(pose[:2]), pose[2], max(VEHICLE_LENGTH * camera.scale, MIN_VEHICLE_LENGTH))


def _draw_panel(canvas: _Canvas, x: float, y: float, width: float, height: float) -> None:
    """A white card with a thin border."""
    canvas.box(x - 1.0, y - 1.0, width + 2.0, height + 2.0, GRID, radius=9.0)
    canvas.box(x, y, width, height, WHITE, radius=8.0)


def _draw_arrow(canvas: _Canvas, start: Array, arrow: Array, color: Color, width: float) -> None:
    """An arrow (2,) [units] from `start`; too short for a head, it is not drawn."""
    length = float(np.hypot(*arrow))
    if length < 2.0:
        return
    along = arrow / length
    across = np.array((-along[1], along[0]))
    head = min(4.0 * width, 0.6 * length)
    neck, stop = start + arrow - head * along, start + arrow
    canvas.line([start, neck + 0.5 * along], color, width)
    canvas.polygon([stop, neck + 0.5 * head * across, neck - 0.5 * head * across], color)


def _ground_velocity(state: tuple[float, float, float, float, float, float]) -> Array:
    """The velocity in the world frame (2,) [m/s], equation (1)."""
    _, _, psi, u, v, _ = state
    return np.array((u * math.cos(psi) - v * math.sin(psi), u * math.sin(psi) + v * math.cos(psi)))


def _mix(background: Color, color: Color, weight: float) -> Color:
    """`color` over `background`, weight 0 ... 1."""
    red, green, blue = (round(b + weight * (c - b)) for b, c in zip(background, color, strict=True))
    return red, green, blue


def _round_down(length: float) -> float:
    """The largest of 1, 2, 5, 10, 20 ... (and their decimals) that is not above a positive length."""
    decade = 10.0 ** math.floor(math.log10(length))
    return decade * max(factor for factor in (1.0, 2.0, 5.0) if factor * decade <= length or factor == 1.0)


def _metres(length: float) -> str:
    """A length in words, in cm below 10 cm."""
    return f"{100.0 * length:.1f} cm" if length < 0.1 else f"{length:.2f} m"
