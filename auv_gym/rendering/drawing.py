"""The elements of a picture, back to front: sea, path, reference, vehicle; then numbers, legend, scale and forces."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from auv_gym.rendering.camera import Camera, View
from auv_gym.rendering.canvas import (
    ALERT,
    ARROW_LENGTH,
    CURRENT,
    GRID,
    INK,
    MIN_VEHICLE_LENGTH,
    MUTED,
    PLAN,
    PLAN_DONE,
    SEA,
    VEHICLE,
    VEHICLE_LENGTH,
    VELOCITY,
    WHITE,
    Array,
    Canvas,
    Color,
)

# The torpedo in units of its length: nose at x = 0.5, stern at x = -0.5, port is +y.
_BOW = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 13)
NOSE: Final[Array] = np.column_stack((0.32 + 0.18 * np.cos(_BOW), 0.1 * np.sin(_BOW)))  # [lengths]
_STERN = [(-0.15, 0.1), (-0.32, 0.075), (-0.45, 0.035), (-0.45, -0.035), (-0.32, -0.075), (-0.15, -0.1)]
HULL: Final[Array] = np.vstack((NOSE, np.array(_STERN)))  # [lengths] the outline
_FIN = np.array([(-0.29, 0.07), (-0.36, 0.19), (-0.45, 0.19), (-0.43, 0.03)])
FINS: Final[tuple[Array, Array]] = (_FIN, _FIN * (1.0, -1.0))  # [lengths] port, starboard
PROPELLER: Final[Array] = np.array([(-0.47, 0.085), (-0.5, 0.085), (-0.5, -0.085), (-0.47, -0.085)])  # [lengths]


def draw_world(canvas: Canvas, camera: Camera, view: View, travelled: int) -> None:
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


def _draw_grid(canvas: Canvas, camera: Camera) -> None:
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


def _draw_current(canvas: Canvas, camera: Camera, current: tuple[float, float]) -> None:
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


def _draw_trail(canvas: Canvas, points: Array) -> None:
    """Past positions, paler with age."""
    cuts = np.unique(np.linspace(0, max(len(points) - 1, 0), 33).astype(int))
    for k, (start, stop) in enumerate(pairwise(cuts), start=1):
        canvas.line(points[start : stop + 1], _mix(SEA, VEHICLE, 0.15 + 0.85 * k / len(cuts)), 3.5)


def _draw_ghost(canvas: Canvas, body: _Body) -> None:
    """The reference pose: a translucent torpedo with an outline."""
    for shape in (*FINS, HULL):
        points = body.place(shape)
        canvas.polygon(points, PLAN, alpha=45)
        canvas.line(np.vstack((points, points[:1])), PLAN, 1.5)


def _draw_vehicle(canvas: Canvas, body: _Body) -> None:
    """The vehicle: propeller, fins, hull and nose."""
    for shape, color in ((PROPELLER, INK), *((fin, INK) for fin in FINS), (HULL, VEHICLE), (NOSE, INK)):
        points = body.place(shape)
        canvas.polygon(points, color)
        canvas.line(np.vstack((points, points[:1])), INK, 1.2)


def _draw_velocity(canvas: Canvas, camera: Camera, view: View) -> None:
    """The velocity over ground, from the centre of mass."""
    start, arrow = camera.project(view.state[:2]), camera.arrow(_ground_velocity(view.state))
    canvas.line([start, start + 0.75 * arrow], WHITE, 5.0)  # a halo against the hull
    _draw_arrow(canvas, start, arrow, VELOCITY, 3.0)


def _draw_error(canvas: Canvas, camera: Camera, view: View) -> None:
    """A dashed line from vehicle to reference, and its length in words to starboard."""
    start, stop = camera.project(view.state[:2]), camera.project(view.reference[:2])
    dashes = max(1, round(float(np.hypot(*(stop - start))) / 9.0))
    for k in range(dashes):
        canvas.line([start + (stop - start) * (k + part) / dashes for part in (0.0, 0.6)], ALERT, 2.5)
    clear = np.array((100.0, 62.0)) + min(0.5 * float(np.hypot(*(stop - start))), 40.0)  # of hull and ghost
    label = 0.5 * (start + stop) + clear * (math.sin(view.state[2]), math.cos(view.state[2]))
    _draw_panel(canvas, label[0] - 62.0, label[1] - 13.0, 124.0, 26.0)
    canvas.text(f"error {_metres(view.position_error)}", float(label[0]), float(label[1]), color=ALERT, align=0.5)


def draw_overlay(canvas: Canvas, camera: Camera, view: View) -> None:
    """The four corners: numbers, legend, scale with axes, forces."""
    _draw_numbers(canvas, view)
    _draw_legend(canvas, camera, view)
    _draw_scale(canvas, camera)
    _draw_forces(canvas, view)


def _draw_numbers(canvas: Canvas, view: View) -> None:
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


def _draw_legend(canvas: Canvas, camera: Camera, view: View) -> None:
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


def _draw_scale(canvas: Canvas, camera: Camera) -> None:
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


def _draw_forces(canvas: Canvas, view: View) -> None:
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


def _body(camera: Camera, pose: tuple[float, float, float]) -> _Body:
    """A torpedo at a pose x, y [m], psi [rad], never smaller than legible."""
    return _Body(camera.project(pose[:2]), pose[2], max(VEHICLE_LENGTH * camera.scale, MIN_VEHICLE_LENGTH))


def _draw_panel(canvas: Canvas, x: float, y: float, width: float, height: float) -> None:
    """A white card with a thin border."""
    canvas.box(x - 1.0, y - 1.0, width + 2.0, height + 2.0, GRID, radius=9.0)
    canvas.box(x, y, width, height, WHITE, radius=8.0)


def _draw_arrow(canvas: Canvas, start: Array, arrow: Array, color: Color, width: float) -> None:
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
