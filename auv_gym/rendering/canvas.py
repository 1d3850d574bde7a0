"""What a picture is drawn on and with: colours that are safe for colour-blind readers (Okabe-Ito), shapes, text."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache, partial
from types import ModuleType
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Color = tuple[int, int, int]

VEHICLE_LENGTH: Final = 2.0  # [m] about right for a neutrally buoyant torpedo of 200 kg
MIN_VEHICLE_LENGTH: Final = 46.0  # [units] below this the vehicle is drawn larger than to scale, and the scale says so
NEAR_EXTENT: Final = 8.0  # [m] half the height of the picture when the error is small
CAMERA_TIME: Final = 1.0  # [s] time constant of zoom and pan
ARROW_LENGTH: Final = 72.0  # [units] arrow of the fastest speed lately seen; velocity and current share this scale
ARROW_MEMORY: Final = 20.0  # [s] time constant with which that speed is forgotten
PICTURE: Final = (960.0, 720.0)  # [units] the layout's nominal size; a unit is a pixel at that size
OVERSAMPLING: Final = 2  # shapes are drawn this much larger and scaled down: smooth edges

SEA: Final[Color] = (243, 248, 251)  # the water
GRID: Final[Color] = (205, 219, 228)  # lines of constant x and y, and frames
INK: Final[Color] = (32, 48, 60)  # text and outlines
MUTED: Final[Color] = (98, 116, 130)  # text of less weight
WHITE: Final[Color] = (255, 255, 255)  # panels, and the halo of an arrow
PLAN: Final[Color] = (0, 114, 178)  # the path that lies ahead
PLAN_DONE: Final[Color] = (168, 200, 220)  # the path that is behind
VEHICLE: Final[Color] = (230, 159, 0)  # the hull and its trail
VELOCITY: Final[Color] = (0, 110, 82)  # the arrow of the velocity over ground
CURRENT: Final[Color] = (86, 180, 233)  # the arrows of the current
ALERT: Final[Color] = (213, 94, 0)  # the position error, and forces at their limit


class Canvas:
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
        """Begin a new picture on this ground."""
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
