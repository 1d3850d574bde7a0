"""The renderer: it draws views to a window or to arrays."""

from __future__ import annotations

import operator
import warnings
from collections.abc import Sequence
from types import ModuleType
from typing import Any, Literal, get_args

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from auv_gym.installation import install
from auv_gym.rendering.camera import Camera, View, elapsed_between
from auv_gym.rendering.canvas import PICTURE, SIDE, Canvas
from auv_gym.rendering.cards import draw_cards, draw_depths
from auv_gym.rendering.scene import draw_world

RenderMode = Literal["human", "rgb_array"]
READABLE = (320, 240)
"""Width and height [px] of the smallest picture with text."""
FRAME_SIZES = (16, 4096)
"""Least and largest width or height [px] of a picture."""


class Renderer:
    """Draws views to a window ("human") or to arrays ("rgb_array").

    A picture depends only on the views drawn so far. "rgb_array" needs no display.

    Args:
        render_mode: "human" or "rgb_array".
        fps: largest frame rate of "human" [1/s].
        size: width and height of the picture [px], see `checked_size`.

    Raises:
        ValueError: the mode or size is not allowed, or fps not positive.
        DependencyNotInstalled: pygame is missing.
    """

    def __init__(self, render_mode: RenderMode, fps: float, size: Sequence[int] = PICTURE) -> None:
        if render_mode not in get_args(RenderMode):
            raise ValueError(f"render_mode is {render_mode!r}; allowed: {', '.join(get_args(RenderMode))}")
        if not fps > 0.0:
            raise ValueError(f"fps is {fps}; it must be positive")
        self._pygame = import_pygame()
        self._size = checked_size(size)
        self._canvas = Canvas(self._pygame, self._size)
        self._cards = self._size[0] >= READABLE[0] and self._size[1] >= READABLE[1]
        self._above, self._camera = self._canvas, Camera(self._canvas.extent)
        self._side: tuple[Canvas, Camera] | None = None  # in space
        self._last: View | None = None
        self._human, self._fps = render_mode == "human", fps
        self._window: Any = None
        self._clock: Any = None
        self._closed = False

    def draw(self, view: View, side: View | None = None) -> NDArray[np.uint8] | None:
        """Draw one picture.

        Args:
            view: from above.
            side: from the side, see `two_planes`, drawn below it; None in the plane.

        Returns:
            "rgb_array": a new uint8 array (H, W, 3). "human": None; after the window was closed nothing is drawn.
        """
        elapsed = elapsed_between(self._last, view)
        self._last = view
        if side is not None and self._side is None:
            self._above, lower = self._canvas.split(SIDE)
            self._camera, self._side = Camera(self._above.extent), (lower, Camera(lower.extent))
        self._camera.update(view, elapsed)
        if self._human and not self._open_window():
            return None
        draw_world(self._above, self._camera, view)
        if self._cards:
            draw_cards(self._above, self._camera, view, side)
        if side is not None and self._side is not None:
            canvas, camera = self._side
            camera.update(side, elapsed)
            camera.unit_speed = self._camera.unit_speed
            draw_world(canvas, camera, side, surface=True)
            if self._cards:
                draw_depths(canvas, camera)
        if not self._human:
            return self._canvas.pixels()
        self._window.blit(self._canvas.surface, (0, 0))
        self._pygame.display.flip()
        self._clock.tick(self._fps)
        return None

    def close(self) -> None:
        """Close the window, if there is one. Further calls have no effect."""
        self._closed = True
        if self._window is not None:
            self._window = None
            self._pygame.display.quit()

    def _open_window(self) -> bool:
        """Open the window if needed, process its events, and return whether it is open."""
        if self._window is not None and not self._pygame.display.get_init():
            self._window = None  # another environment has closed the display, of which pygame has only one
        if self._window is None and not self._closed:
            self._pygame.display.init()
            self._window = self._pygame.display.set_mode(self._size)
            self._pygame.display.set_caption("auv_gym")
            self._clock = self._pygame.time.Clock()
        if self._window is not None and self._pygame.event.get(self._pygame.QUIT):
            self.close()
        return self._window is not None


def import_pygame() -> ModuleType:
    """Return pygame with its fonts.

    Raises:
        DependencyNotInstalled: pygame is missing; the message says what to install.
    """
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*pkg_resources", module="pygame")  # pygame <= 2.6
            import pygame
            import pygame.font
    except ImportError as error:
        raise DependencyNotInstalled(f"drawing needs pygame: {install('render')}") from error
    pygame.font.init()
    return pygame


def checked_size(size: Sequence[int]) -> tuple[int, int]:
    """Return the width and height of pictures [px].

    Raises:
        ValueError: they are not two integers within `FRAME_SIZES`.
    """
    try:
        width, height = (operator.index(n) for n in size)
    except (TypeError, ValueError):
        width = height = 0
    if not all(FRAME_SIZES[0] <= n <= FRAME_SIZES[1] for n in (width, height)):
        low, high = FRAME_SIZES
        raise ValueError(f"render_size is {size!r}; it must be (width, height), two integers from {low} to {high} [px]")
    return width, height
