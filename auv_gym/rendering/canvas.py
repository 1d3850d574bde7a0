"""The canvas of a picture: colours that colour-blind readers can distinguish (Okabe-Ito), shapes, text.

Long lines consist of parallel antialiased lines. Small shapes are drawn larger and scaled down. Parts that are the same
in all pictures are kept as images.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache, partial
from types import ModuleType
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from auv_gym.physics.namespaces import Array

Color = tuple[int, int, int]
ScreenBox = tuple[float, float, float, float]
"""Left, top, width and height [units] of a rectangle."""

VEHICLE_LENGTH: Final = 2.0  # [m] of a neutrally buoyant torpedo of about 200 kg
MIN_VEHICLE_LENGTH: Final = 46.0  # [units] smallest length at which the vehicle is drawn
NEAR_EXTENT: Final = 8.0  # [m] half the height of the picture at a small error
CAMERA_TIME: Final = 1.0  # [s] time constant of zoom and pan
ARROW_LENGTH: Final = 72.0  # [units] arrow of the largest recent speed, of the vehicle or the current
ARROW_MEMORY: Final = 20.0  # [s] time constant of the decay of that speed
PICTURE: Final = (960, 720)  # [units] nominal size, at which a unit is a pixel
SIDE: Final = 1.0 / 3.0  # share of a picture's height for the view from the side
SMALLEST_UNIT: Final = 0.25  # [px] smallest size of a unit
LEGIBLE: Final = 18  # [px] smaller texts are drawn larger and scaled down
TEXTS: Final = 1024  # number of images of texts that are kept
DASH: Final = 7.0  # [px] shortest dash with its gap
SHADES: Final = 32  # number of steps of a colour gradient

SEA_COLOUR: Final[Color] = (243, 248, 251)  # the water
GRID: Final[Color] = (205, 219, 228)  # lines of constant x and y, and frames
INK: Final[Color] = (32, 48, 60)  # text and outlines
MUTED: Final[Color] = (98, 116, 130)  # text of secondary importance
WHITE: Final[Color] = (255, 255, 255)  # cards, and the outline of an arrow
PLAN: Final[Color] = (0, 114, 178)  # the future path of the reference
PLAN_DONE: Final[Color] = (168, 200, 220)  # the past path of the reference
VEHICLE: Final[Color] = (230, 159, 0)  # the vehicle and its trail
VELOCITY: Final[Color] = (0, 110, 82)  # the arrow of the velocity over ground
CURRENT_COLOUR: Final[Color] = (86, 180, 233)  # the arrows of the current
ALERT: Final[Color] = (213, 94, 0)  # the position error, and forces at their limit


def mix(background: Color, color: Color, weight: float) -> Color:
    """Return the mixture of a background and a colour with a weight of 0 ... 1, in `SHADES` steps."""
    return _shade(background, color, round(SHADES * weight))


@lru_cache(maxsize=4096)
def _shade(background: Color, color: Color, step: int) -> Color:
    (r, g, b), (R, G, B), weight = background, color, step / SHADES
    return round(r + weight * (R - r)), round(g + weight * (G - g)), round(b + weight * (B - b))


class Canvas:
    """A picture that is drawn in units of the nominal size; later shapes cover earlier ones.

    Args:
        pygame: the module.
        size: width and height [px].
        unit: size of a unit [px]; None for the largest one at which `PICTURE` fits in.
        surface: the surface to draw on, of this size; None for a new one.
    """

    def __init__(
        self, pygame: ModuleType, size: tuple[int, int], unit: float | None = None, surface: Any = None
    ) -> None:
        self._pygame, self._size = pygame, size
        self.unit = unit or max(min(size[0] / PICTURE[0], size[1] / PICTURE[1]), SMALLEST_UNIT)  # [px]
        self.extent: Array = np.array(size) / self.unit  # (2,) [units]
        # Three bytes a pixel in the order of an array.
        self._surface = surface or pygame.Surface(size, depth=24, masks=(0xFF, 0xFF00, 0xFF0000, 0))
        self._corner, self._factor, self._near = np.zeros(2), self.unit, False  # of the present surface
        self._oversampling = 2 if self.unit >= 1.0 else 4  # enlargement of small shapes; powers of two are exact
        self._font: Callable[[int], Any] = lru_cache(maxsize=None)(partial(pygame.font.Font, None))
        self._image: Callable[..., Any] = lru_cache(maxsize=TEXTS)(self._rendered)
        self._cards: dict[Hashable, Any] = {}

    def pixels(self) -> NDArray[np.uint8]:
        """Return the picture as a new array (height, width, 3)."""
        width, height = self._size
        pitch = self._surface.get_pitch()
        rows = np.frombuffer(self._surface.get_buffer().raw, dtype=np.uint8).reshape(height, pitch)
        return rows[:, : 3 * width].reshape(height, width, 3).copy()

    def part(self, box: ScreenBox) -> Canvas:
        """Return the canvas of a rectangle of this one, with the origin at its corner."""
        x, y, width, height = (round(n * self.unit) for n in box)
        return Canvas(self._pygame, (width, height), self.unit, self._surface.subsurface((x, y, width, height)))

    def split(self, share: float) -> tuple[Canvas, Canvas]:
        """Return the canvases of an upper part and of a lower part, which has a share of the height."""
        (width, height), part = self._size, round(share * self._size[1])
        areas = (0, 0, width, height - part), (0, height - part, width, part)
        upper, lower = (Canvas(self._pygame, area[2:], self.unit, self._surface.subsurface(area)) for area in areas)
        return upper, lower

    @property
    def surface(self) -> Any:
        """The picture as a pygame surface."""
        return self._surface

    def fill(self, color: Color) -> None:
        """Fill the picture with a colour."""
        self._surface.fill(color)

    def _placed(self, points: ArrayLike) -> Array:
        """Return points (k, 2) [units] as pixels (k, 2) of the present surface."""
        scaled = (np.asarray(points, dtype=np.float64) - self._corner) * self._factor
        return np.minimum(np.maximum(scaled, -1e5), 1e5, out=scaled)

    def rule(self, axis: int, positions: Sequence[float], color: Color, width: float) -> None:
        """Draw lines across the picture at positions [units] along an axis, on the background `SEA_COLOUR`."""
        half, fill, (w, h) = 0.5 * max(width * self.unit, 0.5), self._surface.fill, self._size
        for position in positions:
            low, high = position * self.unit - half, position * self.unit + half
            for k in range(math.floor(low), math.ceil(high)):
                shade = _shade(SEA_COLOUR, color, round(SHADES * (min(high, k + 1) - max(low, k))))
                fill(shade, (k, 0, 1, h) if axis == 0 else (0, k, w, 1))

    def line(self, points: ArrayLike, color: Color, width: float, cuts: Sequence[tuple[int, int, Color]] = ()) -> None:
        """Draw a polyline (k, 2) of at least two points; `cuts` are (first, end, colour) of its parts."""
        pixels = self._placed(points)
        if len(pixels) < 2:
            return
        thickness = width * self._factor
        if self._near:
            self._pygame.draw.lines(self._surface, color, False, pixels.tolist(), max(1, round(thickness)))
            return
        for strand in _strands(pixels, thickness):
            for start, stop, shade in cuts or ((0, len(pixels), color),):
                self._pygame.draw.aalines(self._surface, shade, False, strand[start:stop])

    def dashes(self, start: Array, stop: Array, color: Color, width: float, period: float) -> None:
        """Draw a dashed line between two points (2,); `period` is the length of a dash with its gap [units]."""
        period = max(period, DASH / self.unit)
        count = max(1, round(float(np.hypot(*(stop - start))) / period))
        ends = (np.arange(count)[:, None] + (0.0, 0.6)) / count
        for (a, b), (c, d) in _strands(self._placed([start, stop]), width * self._factor):
            for begin, end in ends.tolist():
                first = a + begin * (c - a), b + begin * (d - b)
                self._pygame.draw.aaline(self._surface, color, first, (a + end * (c - a), b + end * (d - b)))

    def polygon(self, points: ArrayLike, color: Color, edge: Color, width: float) -> None:
        """Draw a filled polygon (k, 2) with an outline of a width [units], in a close-up."""
        corners = self._placed(points).tolist()
        self._pygame.draw.polygon(self._surface, color, corners)
        self._pygame.draw.lines(self._surface, edge, True, corners, max(1, round(width * self._factor)))

    def arrows(self, starts: Array, arrow: Array, colors: Sequence[Color], width: float) -> None:
        """Draw an arrow (2,) [units] from each of `starts` (k, 2); arrows shorter than 2 units are left out."""
        length = float(np.hypot(*arrow))
        if length < 2.0 or len(starts) == 0:
            return
        along = arrow / length
        across = np.array((-along[1], along[0]))
        head = min(4.0 * width, 0.6 * length)
        neck = arrow - head * along
        shape = np.array((arrow, neck + 0.5 * head * across, neck - 0.5 * head * across)) * self._factor
        draw, surface, tip = self._pygame.draw, self._surface, (shape + 0.5).tolist()
        shafts = _strands(np.array((np.zeros(2), neck + 0.5 * along)) * self._factor, width * self._factor)
        outline = shape.tolist()
        for (x, y), color in zip(self._placed(starts).tolist(), colors, strict=True):
            if self._near:
                (a, b), (c, d) = shafts[len(shafts) // 2]
                draw.line(surface, color, (x + a, y + b), (x + c, y + d), max(1, round(width * self._factor)))
            else:
                for (a, b), (c, d) in shafts:
                    draw.aaline(surface, color, (x + a, y + b), (x + c, y + d))
                draw.aalines(surface, color, True, [(x + a, y + b) for a, b in outline])
            draw.polygon(surface, color, [(x + a, y + b) for a, b in tip])

    @contextmanager
    def closeup(self, points: ArrayLike, margin: float) -> Iterator[None]:
        """Return a context in which shapes within a margin [units] of points (k, 2) are drawn with smooth edges."""
        places = self._placed(points)
        low = np.maximum(np.floor(places.min(axis=0) - margin * self.unit), 0.0)
        high = np.minimum(np.ceil(places.max(axis=0) + margin * self.unit), self._size)
        width, height = (high - low).astype(int).tolist()
        if width <= 0 or height <= 0:  # outside of the picture
            low, width, height = np.zeros(2), 1, 1
        picture, corner = self._surface, low.astype(int).tolist()
        part = picture.subsurface((*corner, width, height))
        self._surface = self._pygame.transform.scale(part, (self._oversampling * width, self._oversampling * height))
        self._corner, self._factor, self._near = low / self.unit, self._oversampling * self.unit, True
        try:
            yield
        finally:
            drawn, self._surface = self._surface, picture
            self._corner, self._factor, self._near = np.zeros(2), self.unit, False
            picture.blit(self._pygame.transform.smoothscale(drawn, (width, height)), corner)

    def tint(self, points: ArrayLike, color: Color, weight: float, width: float) -> None:
        """Draw a translucent polygon (k, 2) with an outline of a width [units], in a close-up."""
        places = self._placed(points)
        corner = np.floor(places.min(axis=0))
        corners = (places - corner).tolist()
        layer = self._pygame.Surface((places.max(axis=0) - corner + 2).tolist(), self._pygame.SRCALPHA, 32)
        self._pygame.draw.polygon(layer, (*color, round(255 * weight)), corners)
        self._surface.blit(layer, corner.tolist())
        thickness = max(1, round(width * self._factor))
        self._pygame.draw.lines(self._surface, color, True, places.tolist(), thickness)

    def box(self, box: ScreenBox, color: Color, radius: float = 0.0) -> None:
        """Draw a filled rectangle with rounded corners, at least one pixel wide and high."""
        x, y, width, height = (n * self.unit for n in box)
        rectangle = round(x), round(y), max(1, round(x + width) - round(x)), max(1, round(y + height) - round(y))
        self._pygame.draw.rect(self._surface, color, rectangle, border_radius=round(radius * self.unit))

    def card(self, box: ScreenBox, key: Hashable = None, content: Callable[[Canvas], None] = lambda _: None) -> None:
        """Draw a white card with a thin border and a fixed content, which is kept as an image.

        Args:
            box: its rectangle.
            key: identifies the content.
            content: draws the content on the canvas of the card.
        """
        x, y, width, height = box
        if (width, height, key) not in self._cards:
            self._cards[width, height, key] = self._drawn_card(width, height, content)
        corner = round((x - 1.0) * self.unit), round((y - 1.0) * self.unit)
        self._surface.blit(self._cards[width, height, key], corner)

    def _drawn_card(self, width: float, height: float, content: Callable[[Canvas], None]) -> Any:
        """Return the image of a card, with translucent corners."""
        size = math.ceil((width + 2.0) * self.unit), math.ceil((height + 2.0) * self.unit)
        draw, large = self._pygame.draw, (4 * size[0], 4 * size[1])
        shape = self._pygame.Surface(large, self._pygame.SRCALPHA, 32)
        shape.fill((*GRID, 0))
        border, radius = max(1, round(4 * self.unit)), round(36 * self.unit)
        draw.rect(shape, GRID, (0, 0, *large), border_radius=radius)
        inner = (border, border, large[0] - 2 * border, large[1] - 2 * border)
        draw.rect(shape, WHITE, inner, border_radius=max(0, radius - border))
        card = self._pygame.transform.smoothscale(shape, size)
        content(Canvas(self._pygame, size, self.unit, card))
        return card

    def text(self, text: str, x: float, y: float, size: float = 17.0, color: Color = INK, align: float = 0.0) -> float:
        """Draw a line of text and return its width [units].

        Its middle is at height y. It begins at x (align 0), is centred at x (0.5) or ends at x (1).
        """
        image = self._image(text, max(6, round(1.25 * size * self.unit)), color)
        width, height = image.get_size()
        self._surface.blit(image, (round(x * self.unit - align * width), round(y * self.unit - 0.5 * height)))
        return float(width) / self.unit

    def width_of(self, text: str, size: float = 17.0) -> float:
        """Return the width [units] of a text."""
        return float(self._image(text, max(6, round(1.25 * size * self.unit)), INK).get_width()) / self.unit

    def _rendered(self, text: str, height: int, color: Color) -> Any:
        if height >= LEGIBLE:
            return self._font(height).render(text, True, color)
        large = self._font(4 * height).render(text, True, color)  # small letters are spaced unevenly
        width, height = (max(1, round(n / 4)) for n in large.get_size())
        return self._pygame.transform.smoothscale(large, (width, height))


def _strands(pixels: Array, thickness: float) -> list[list[tuple[float, float]]]:
    """Return parallel lines of one pixel that form a polyline (k, 2) of a thickness [px]."""
    if thickness <= 1.5:
        return [pixels.tolist()]
    along = np.empty_like(pixels)
    along[1:-1] = pixels[2:] - pixels[:-2]
    along[0], along[-1] = pixels[1] - pixels[0], pixels[-1] - pixels[-2]
    length = np.maximum(np.sqrt(along[:, 0] ** 2 + along[:, 1] ** 2), 1e-9)
    normal = np.stack((-along[:, 1] / length, along[:, 0] / length), axis=1)
    half = 0.5 * (thickness - 1.0)
    return [(pixels + side * normal).tolist() for side in np.linspace(-half, half, math.ceil(thickness)).tolist()]
