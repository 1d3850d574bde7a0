"""The scene of a picture, from back to front: water, current, path, trail, reference, vehicle, error."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from auv_gym.physics.errors import to_world
from auv_gym.physics.namespaces import Array
from auv_gym.rendering.camera import Camera, View
from auv_gym.rendering.canvas import (
    ALERT,
    CURRENT_COLOUR,
    GRID,
    INK,
    MIN_VEHICLE_LENGTH,
    MUTED,
    PLAN,
    PLAN_DONE,
    SEA_COLOUR,
    VEHICLE,
    VEHICLE_LENGTH,
    VELOCITY,
    WHITE,
    Canvas,
    Color,
    mix,
)

# The torpedo in units of its length: nose at x = 0.5, stern at x = -0.5, port is +y.
_BOW = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 13)
_NOSE: Final[Array] = np.column_stack((0.32 + 0.18 * np.cos(_BOW), 0.1 * np.sin(_BOW)))  # [lengths]
_STERN = [(-0.15, 0.1), (-0.32, 0.075), (-0.45, 0.035), (-0.45, -0.035), (-0.32, -0.075), (-0.15, -0.1)]
_OUTLINE: Final[Array] = np.vstack((_NOSE, np.array(_STERN)))  # [lengths]
_FIN = np.array([(-0.29, 0.07), (-0.36, 0.19), (-0.45, 0.19), (-0.43, 0.03)])
FINS: Final[tuple[Array, Array]] = (_FIN, _FIN * (1.0, -1.0))  # [lengths] port, starboard
_PROPELLER: Final[Array] = np.array([(-0.47, 0.085), (-0.5, 0.085), (-0.5, -0.085), (-0.47, -0.085)])  # [lengths]


class Body(NamedTuple):
    """Pose and size of a drawn vehicle: middle [units], psi [rad], length [units]."""

    middle: Array
    psi: float
    length: float

    def place(self, shape: Array) -> Array:
        """Return a shape (k, 2) [lengths] as points in the picture (k, 2) [units]."""
        cos, sin = self.length * math.cos(self.psi), self.length * math.sin(self.psi)
        points: Array = self.middle + shape @ np.array(((cos, -sin), (-sin, -cos)))  # y points down in the picture
        return points


def draw_world(
    canvas: Canvas,
    camera: Camera,
    view: View,
    color: Color = VEHICLE,
    *,
    velocity: bool = True,
    surface: bool = False,
) -> None:
    """Draw the scene.

    Args:
        canvas: the canvas.
        camera: the camera.
        view: the contents.
        color: colour of vehicle and trail.
        velocity: whether to draw an arrow of the velocity.
        surface: whether y = 0 is the surface of the water, in a view from the side.
    """
    canvas.fill(SEA_COLOUR)
    _draw_grid(canvas, camera)
    _draw_current(canvas, camera, view.current)
    if surface:
        _draw_air(canvas, camera)
    path = camera.project(view.path)
    canvas.line(path[: view.travelled + 1], PLAN_DONE, 2.5)
    draw_trail(canvas, camera.project(view.trail), color)
    canvas.line(path[view.travelled :], PLAN, 2.5)
    draw_ghost(canvas, _body(camera, view.reference))
    _, _, psi, u, v, _ = view.state
    arrow = camera.arrow(np.array(to_world(u, v, math.cos(psi), math.sin(psi)))) if velocity else None
    draw_vehicle(canvas, _body(camera, view.state[:3]), color, arrow)
    canvas.dashes(camera.project(view.state[:2]), camera.project(view.reference[:2]), ALERT, 2.5, 9.0)


def _draw_grid(canvas: Canvas, camera: Camera) -> None:
    """Draw lines every 1, 5, 10, 50 ... m; the contrast of fine lines grows as the camera comes closer."""
    for spacing in (m * 10.0**k for k in range(-2, 7) for m in (1, 5)):
        weight = min((spacing * camera.scale - 14.0) / 100.0, 1.0)
        if weight <= 0.0 or spacing * camera.scale > 4.0 * canvas.extent.max():
            continue
        for axis in (0, 1):
            values = camera.lattice(axis, spacing) * spacing
            places = camera.project(np.stack((values, values), axis=1))[:, axis]
            canvas.rule(axis, places.tolist(), mix(SEA_COLOUR, GRID, weight), 1.0)


def _draw_air(canvas: Canvas, camera: Camera) -> None:
    """Draw the air above the surface and the surface, if they are in the picture."""
    (width, height), y = canvas.extent.tolist(), float(camera.project((0.0, 0.0))[1])
    if y > 0.0:
        canvas.box((0.0, 0.0, width, min(y, height)), WHITE)
        canvas.box((0.0, y - 1.0, width, 2.0), MUTED)


def _draw_current(canvas: Canvas, camera: Camera, current: tuple[float, float]) -> None:
    """Draw arrows of the current at places that are fixed in the world; none without current."""
    if math.hypot(*current) == 0.0:
        return
    arrow, apart = camera.arrow(current), min(105.0, 0.25 * float(canvas.extent.min()))
    spacing = 2.0 ** math.ceil(math.log2(apart / camera.scale))  # [m] 105 ... 210 units, less in a small picture
    contrast = min((spacing * camera.scale / apart - 1.0) / 0.4, 1.0)  # of every other arrow
    i, j = (n.ravel() for n in np.meshgrid(*(camera.lattice(axis, spacing) for axis in (0, 1)), indexing="ij"))
    middles = camera.project(np.stack((i, j), axis=1) * spacing)
    full, faint = mix(SEA_COLOUR, CURRENT_COLOUR, 0.75), mix(SEA_COLOUR, CURRENT_COLOUR, 0.75 * contrast)
    canvas.arrows(middles - 0.5 * arrow, arrow, [faint if odd else full for odd in ((i | j) & 1).tolist()], 2.0)


def draw_trail(canvas: Canvas, points: Array, color: Color = VEHICLE) -> None:
    """Draw past positions (k, 2) [units]; older ones are paler."""
    cuts = np.unique(np.linspace(0, max(len(points) - 1, 0), 25).astype(int)).tolist()
    parts = [
        (start, stop + 1, mix(SEA_COLOUR, color, 0.15 + 0.85 * k / len(cuts)))
        for k, (start, stop) in enumerate(pairwise(cuts), start=1)
    ]
    canvas.line(points, color, 3.5, parts)


def draw_ghost(canvas: Canvas, body: Body) -> None:
    """Draw the reference pose as a translucent vehicle with an outline."""
    with canvas.closeup(body.place(_OUTLINE), 0.15 * body.length):
        for shape in (*FINS, _OUTLINE):
            canvas.tint(body.place(shape), PLAN, 0.18, 1.5)


def draw_vehicle(canvas: Canvas, body: Body, color: Color = VEHICLE, arrow: Array | None = None) -> None:
    """Draw the vehicle, and from its middle an arrow (2,) [units] of its velocity."""
    outline = body.place(_OUTLINE)
    seen = outline if arrow is None else np.vstack((outline, body.middle + arrow))
    with canvas.closeup(seen, 0.15 * body.length):
        for shape in (_PROPELLER, *FINS):
            canvas.polygon(body.place(shape), INK, INK, 1.2)
        canvas.polygon(outline, color, INK, 1.2)
        canvas.polygon(body.place(_NOSE), INK, INK, 1.2)
        if arrow is not None:
            canvas.line([body.middle, body.middle + 0.75 * arrow], WHITE, 5.0)  # a light outline
            canvas.arrows(body.middle[None], arrow, [VELOCITY], 3.0)


def _body(camera: Camera, pose: tuple[float, float, float]) -> Body:
    """Return the drawn vehicle at a pose x, y [m], psi [rad]; its length is at least `MIN_VEHICLE_LENGTH`."""
    return Body(camera.project(pose[:2]), pose[2], max(VEHICLE_LENGTH * camera.scale, MIN_VEHICLE_LENGTH))
