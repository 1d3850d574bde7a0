"""The scene of a picture, back to front: sea, current, path, trail, reference, vehicle, error."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.rendering.camera import Camera, View
from auv_gym.rendering.canvas import (
    ALERT,
    CURRENT_COLOUR,
    GRID,
    INK,
    MIN_VEHICLE_LENGTH,
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
_HULL: Final[Array] = np.vstack((_NOSE, np.array(_STERN)))  # [lengths] the outline
_FIN = np.array([(-0.29, 0.07), (-0.36, 0.19), (-0.45, 0.19), (-0.43, 0.03)])
FINS: Final[tuple[Array, Array]] = (_FIN, _FIN * (1.0, -1.0))  # [lengths] port, starboard
_PROPELLER: Final[Array] = np.array([(-0.47, 0.085), (-0.5, 0.085), (-0.5, -0.085), (-0.47, -0.085)])  # [lengths]


class Body(NamedTuple):
    """Where and how large a torpedo is drawn: middle [units], psi [rad], length [units]."""

    middle: Array
    psi: float
    length: float

    def place(self, shape: Array) -> Array:
        """A shape (k, 2) in units of the length to picture points (k, 2)."""
        cos, sin = self.length * math.cos(self.psi), self.length * math.sin(self.psi)
        points: Array = self.middle + shape @ np.array(((cos, -sin), (-sin, -cos)))  # the picture's y points down
        return points


def draw_world(
    canvas: Canvas, camera: Camera, view: View, travelled: int, body_color: Color = VEHICLE, *, velocity: bool = True
) -> None:
    """Draw the scene from the bottom up.

    Args:
        canvas: what to draw on.
        camera: from where.
        view: what.
        travelled: index of the path's point that the reference has come to.
        body_color: colour of vehicle and trail.
        velocity: whether the vehicle has an arrow of its velocity.
    """
    canvas.fill(SEA_COLOUR)
    _draw_grid(canvas, camera)
    _draw_current(canvas, camera, view.current)
    path = camera.project(view.path)
    canvas.line(path[: travelled + 1], PLAN_DONE, 2.5)
    draw_trail(canvas, camera.project(view.trail), body_color)
    canvas.line(path[travelled:], PLAN, 2.5)
    draw_ghost(canvas, _body(camera, view.reference))
    arrow = camera.arrow(_ground_velocity(view.state)) if velocity else None
    draw_vehicle(canvas, _body(camera, view.state[:3]), body_color, arrow)
    canvas.dashes(camera.project(view.state[:2]), camera.project(view.reference[:2]), ALERT, 2.5, 9.0)


def _draw_grid(canvas: Canvas, camera: Camera) -> None:
    """Lines every 1, 5, 10, 50 ... m; fine ones fade in as the camera comes closer."""
    for spacing in (m * 10.0**k for k in range(-2, 7) for m in (1, 5)):
        weight = min((spacing * camera.scale - 14.0) / 100.0, 1.0)
        if weight <= 0.0 or spacing * camera.scale > 4.0 * canvas.extent.max():
            continue
        for axis in (0, 1):
            values = camera.lattice(axis, spacing) * spacing
            places = camera.project(np.stack((values, values), axis=1))[:, axis]
            canvas.rule(axis, places.tolist(), mix(SEA_COLOUR, GRID, weight), 1.0)


def _draw_current(canvas: Canvas, camera: Camera, current: tuple[float, float]) -> None:
    """A sparse field of arrows, fixed in the world, none without current."""
    if math.hypot(*current) == 0.0:
        return
    arrow, apart = camera.arrow(current), min(105.0, 0.25 * float(canvas.extent.min()))
    spacing = 2.0 ** math.ceil(math.log2(apart / camera.scale))  # [m] 105 ... 210 units, less in a small picture
    fading = min((spacing * camera.scale / apart - 1.0) / 0.4, 1.0)  # every other arrow, as the camera comes closer
    i, j = (n.ravel() for n in np.meshgrid(*(camera.lattice(axis, spacing) for axis in (0, 1)), indexing="ij"))
    middles = camera.project(np.stack((i, j), axis=1) * spacing)
    full, faint = mix(SEA_COLOUR, CURRENT_COLOUR, 0.75), mix(SEA_COLOUR, CURRENT_COLOUR, 0.75 * fading)
    canvas.arrows(middles - 0.5 * arrow, arrow, [faint if odd else full for odd in ((i | j) & 1).tolist()], 2.0)


def draw_trail(canvas: Canvas, points: Array, color: Color = VEHICLE) -> None:
    """Draw past positions (k, 2) [units], paler with age."""
    cuts = np.unique(np.linspace(0, max(len(points) - 1, 0), 25).astype(int)).tolist()
    parts = [
        (start, stop + 1, mix(SEA_COLOUR, color, 0.15 + 0.85 * k / len(cuts)))
        for k, (start, stop) in enumerate(pairwise(cuts), start=1)
    ]
    canvas.line(points, color, 3.5, parts)


def draw_ghost(canvas: Canvas, body: Body) -> None:
    """Draw the reference pose: a translucent torpedo with an outline."""
    with canvas.closeup(body.place(_HULL), 0.15 * body.length):
        for shape in (*FINS, _HULL):
            canvas.tint(body.place(shape), PLAN, 0.18, 1.5)


def draw_vehicle(canvas: Canvas, body: Body, body_color: Color = VEHICLE, arrow: Array | None = None) -> None:
    """Draw the vehicle: propeller, fins, hull and nose, and from its middle an arrow (2,) [units] of its velocity."""
    outline = body.place(_HULL)
    seen = outline if arrow is None else np.vstack((outline, body.middle + arrow))
    with canvas.closeup(seen, 0.15 * body.length):
        for shape, color in ((_PROPELLER, INK), *((fin, INK) for fin in FINS)):
            canvas.polygon(body.place(shape), color, INK, 1.2)
        canvas.polygon(outline, body_color, INK, 1.2)
        canvas.polygon(body.place(_NOSE), INK, INK, 1.2)
        if arrow is not None:
            canvas.line([body.middle, body.middle + 0.75 * arrow], WHITE, 5.0)  # a halo against the hull
            canvas.arrows(body.middle[None], arrow, [VELOCITY], 3.0)


def _body(camera: Camera, pose: tuple[float, float, float]) -> Body:
    """A torpedo at a pose x, y [m], psi [rad], never smaller than legible."""
    return Body(camera.project(pose[:2]), pose[2], max(VEHICLE_LENGTH * camera.scale, MIN_VEHICLE_LENGTH))


def _ground_velocity(state: tuple[float, float, float, float, float, float]) -> Array:
    """The velocity in the world frame (2,) [m/s], equation (1)."""
    _, _, psi, u, v, _ = state
    return np.array((u * math.cos(psi) - v * math.sin(psi), u * math.sin(psi) + v * math.cos(psi)))
