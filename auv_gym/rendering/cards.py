"""Cards with text: the error beside the vehicle, and in the corners numbers, legend, scale and forces."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from auv_gym.rendering.camera import Camera, View
from auv_gym.rendering.canvas import (
    ALERT,
    ARROW_LENGTH,
    CURRENT_COLOUR,
    GRID,
    INK,
    MIN_VEHICLE_LENGTH,
    MUTED,
    PLAN,
    PLAN_DONE,
    VEHICLE_LENGTH,
    VELOCITY,
    Canvas,
)
from auv_gym.rendering.scene import Body, draw_ghost, draw_trail, draw_vehicle

_NAMES = ("vehicle", "reference", "path done, ahead", "trail", "velocity", "current")
"""Entries of the legend from top to bottom."""


def draw_cards(canvas: Canvas, camera: Camera, view: View, side: View | None = None) -> None:
    """Draw the error beside the vehicle, then the four corners: numbers, legend, scale with axes, forces.

    The numbers have depth and pitch if there is a view from the side.
    """
    _draw_error(canvas, camera, view)
    _draw_numbers(canvas, view, side)
    _draw_legend(canvas, camera, view)
    _draw_scale(canvas, camera)
    _draw_forces(canvas, view)


def _draw_error(canvas: Canvas, camera: Camera, view: View) -> None:
    """Draw the position error to starboard of the line between vehicle and reference."""
    start, stop = camera.project(view.state[:2]), camera.project(view.reference[:2])
    clear = np.array((100.0, 62.0)) + min(0.5 * math.hypot(*(stop - start)), 40.0)  # distance from both shapes
    x, y = (0.5 * (start + stop) + clear * (math.sin(view.state[2]), math.cos(view.state[2]))).tolist()
    canvas.card((x - 62.0, y - 13.0, 124.0, 26.0))
    canvas.text(f"error {metres(view.position_error)}", x, y, color=ALERT, align=0.5)


def _draw_numbers(canvas: Canvas, view: View, side: View | None) -> None:
    """Draw title, time, error, speed, and in space depth and pitch, in the top left corner."""
    width = max(240.0, canvas.width_of(view.title, 19.0) + 32.0)
    rows = [
        ("time", f"{view.time:.1f} s", INK),
        ("position error", metres(view.position_error), ALERT),
        ("speed over ground", f"{math.hypot(*view.state[3:5]):.2f} m/s", INK),
    ]
    if side is not None:
        pitch = math.degrees(side.state[2])
        rows += [("depth", f"{-side.state[1]:.2f} m", INK), ("pitch, nose up", f"{pitch:.1f} deg", INK)]
    names = tuple(name for name, _, _ in rows)
    content = partial(_number_names, title=view.title, names=names)
    canvas.card((12.0, 12.0, width, 50.0 + 24.0 * len(rows)), ("numbers", view.title), content)
    for row, (_, value, color) in enumerate(rows):
        canvas.text(value, width - 4.0, 64.0 + 24.0 * row, color=color, align=1.0)


def _number_names(card: Canvas, title: str, names: tuple[str, ...]) -> None:
    card.text(title, 17.0, 24.0, size=19.0)
    for row, name in enumerate(names):
        card.text(name, 17.0, 53.0 + 24.0 * row, color=MUTED)


def draw_depths(canvas: Canvas, camera: Camera) -> None:
    """Draw depths below the surface at the left edge of a view from the side, and a line above the view."""
    (width, height), spacing = canvas.extent.tolist(), round_down(80.0 / camera.scale)
    canvas.box((0.0, 0.0, width, 2.0), GRID)
    for z in camera.lattice(1, spacing) * spacing:
        y = float(camera.project((0.0, z))[1])
        if z <= 0.0 and 12.0 < y < height - 12.0:
            canvas.box((0.0, y - 0.5, 8.0, 1.0), INK)
            canvas.text(f"{-z + 0.0:g} m deep" if z else "surface", 14.0, y, size=15.0)


def _draw_legend(canvas: Canvas, camera: Camera, view: View) -> None:
    """Draw the legend in the top right corner; its arrows are as long as those in the scene."""
    speeds = math.hypot(*view.state[3:5]), math.hypot(*view.current)
    count = len(_NAMES) if speeds[1] > 0.0 else len(_NAMES) - 1
    left = float(canvas.extent[0]) - 268.0
    canvas.card((left, 12.0, 256.0, 26.0 + 24.0 * count), "legend", partial(_legend_names, count=count))
    colors = (VELOCITY, CURRENT_COLOUR)
    for row, (speed, color) in enumerate(zip(speeds[: count - 4], colors, strict=False), start=4):
        length, y = ARROW_LENGTH * speed / camera.unit_speed, 37.0 + 24.0 * row
        canvas.arrows(np.array([(left + 54.0 - 0.5 * length, y)]), np.array((length, 0.0)), [color], 2.5)
        canvas.text(f"{speed:.2f} m/s", left + 242.0, y, align=1.0)


def _legend_names(card: Canvas, count: int) -> None:
    middle = np.array([(55.0, 26.0 + 24.0 * row) for row in range(len(_NAMES))])
    half = np.array((ARROW_LENGTH / 2.0, 0.0))
    draw_vehicle(card, Body(middle[0], 0.0, 44.0))
    draw_ghost(card, Body(middle[1], 0.0, 44.0))
    card.line([middle[2] - half, middle[2]], PLAN_DONE, 2.0)
    card.line([middle[2], middle[2] + half], PLAN, 2.0)
    draw_trail(card, np.linspace(middle[3] - half, middle[3] + half, 19))
    for name, (_, y) in zip(_NAMES[:count], middle.tolist(), strict=False):
        card.text(name, 105.0, y, color=MUTED)


def _draw_scale(canvas: Canvas, camera: Camera) -> None:
    """Draw the axes, a scale bar and the enlargement of the vehicle in the bottom left corner."""
    top = float(canvas.extent[1]) - 104.0
    canvas.card((12.0, top, 276.0, 92.0), "scale", _axes)
    length = round_down(150.0 / camera.scale)
    bar, y = length * camera.scale, top + 48.0
    canvas.box((104.0, y - 1.0, bar, 2.0), INK)
    for end in (104.0, 104.0 + bar):
        canvas.box((end - 1.0, y - 6.0, 2.0, 12.0), INK)
    canvas.text(f"{length:g} m", 104.0 + 0.5 * bar, top + 28.0, align=0.5)
    enlarged = MIN_VEHICLE_LENGTH / (VEHICLE_LENGTH * camera.scale)
    note = f"enlarged {enlarged:.1f} times" if enlarged > 1.05 else "drawn to scale"
    canvas.text(f"vehicle {note}", 104.0, top + 72.0, size=14.0, color=MUTED)


def _axes(card: Canvas) -> None:
    for arrow in ((40.0, 0.0), (0.0, -40.0)):
        with card.closeup([(21.0, 73.0)], 50.0):
            card.arrows(np.array([(21.0, 73.0)]), np.array(arrow), [INK], 2.0)
    card.text("x", 71.0, 73.0, align=0.5)
    card.text("y", 21.0, 19.0, align=0.5)


def _draw_forces(canvas: Canvas, view: View) -> None:
    """Draw the forces as bars between their limits in the bottom right corner."""
    pitch = (("pitch moment", "N m"),) if len(view.force) == 3 else ()
    names = ("surge force", "N"), *pitch, ("yaw torque", "N m")
    height = 10.0 + 53.0 * len(names)
    left, top = float(canvas.extent[0]) - 308.0, float(canvas.extent[1]) - 12.0 - height
    canvas.card((left, top, 296.0, height), "forces")
    for row, ((name, unit), force, limit) in enumerate(zip(names, view.force, view.force_limits, strict=True)):
        y = top + 22.0 + 53.0 * row
        share = max(-1.0, min(1.0, force / limit))  # an infinite limit leaves the bar empty
        saturated = abs(share) > 0.999
        bound = f"of {limit:g} {unit}" if math.isfinite(limit) else f"{unit}, no limit"
        color = ALERT if saturated else INK
        canvas.text(f"{name}, at limit" if saturated else name, left + 14.0, y, size=15.0, color=MUTED)
        canvas.text(f"{round(force, 1) + 0.0:.1f} {bound}", left + 282.0, y, size=15.0, color=color, align=1.0)
        canvas.box((left + 14.0, y + 12.0, 268.0, 12.0), GRID, radius=3.0)
        start, width = left + 148.0, 134.0 * share
        canvas.box((min(start, start + width), y + 12.0, abs(width), 12.0), ALERT if saturated else PLAN)
        canvas.box((start - 1.0, y + 10.0, 2.0, 16.0), INK)


def round_down(length: float) -> float:
    """Return the largest number 1, 2 or 5 times a power of ten that is not above a positive length."""
    decade = 10.0 ** math.floor(math.log10(length))
    return decade * max(factor for factor in (1.0, 2.0, 5.0) if factor * decade <= length or factor == 1.0)


def metres(length: float) -> str:
    """Return a length as text, in cm below 10 cm."""
    return f"{100.0 * length:.1f} cm" if length < 0.1 else f"{length:.2f} m"
