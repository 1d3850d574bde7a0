"""Views in, pictures out: to a window or to arrays."""

from __future__ import annotations

import warnings
from types import ModuleType
from typing import Any, Literal, get_args

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from auv_gym.rendering.camera import Camera, Progress, View, elapsed_between
from auv_gym.rendering.canvas import PICTURE, Canvas
from auv_gym.rendering.cards import draw_cards
from auv_gym.rendering.scene import draw_world

RenderMode = Literal["human", "rgb_array"]


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

    def __init__(self, render_mode: RenderMode, fps: float, size: tuple[int, int] = PICTURE) -> None:
        if render_mode not in get_args(RenderMode):
            raise ValueError(f"render_mode is {render_mode!r}; allowed: {', '.join(get_args(RenderMode))}")
        if not (fps > 0.0 and min(size) > 0):
            raise ValueError(f"fps and size must be positive; given: {fps}, {size}")
        self._pygame = import_pygame()
        self._canvas = Canvas(self._pygame, size)
        self._camera = Camera(self._canvas.extent)
        self._progress = Progress()
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
        elapsed = elapsed_between(self._last, view)
        self._last = view
        self._camera.update(view, elapsed)
        travelled = self._progress.update(view, elapsed)
        if self._human and not self._open_window():
            return None
        draw_world(self._canvas, self._camera, view, travelled)
        draw_cards(self._canvas, self._camera, view)
        if not self._human:
            return self._canvas.pixels()
        self._window.blit(self._canvas.surface, (0, 0))
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


def import_pygame() -> ModuleType:
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
