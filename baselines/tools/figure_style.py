"""The common style of all figures, with a palette for readers with colour vision deficiency."""

from __future__ import annotations

import io
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # imported where figures are drawn, since most commands draw none
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""The palette of M. Okabe and K. Ito (2008), in the order of use."""
MARKERS = ("o", "s", "^", "D", "v", "P", "X")  # markers of points in the order of use
OUTLINES = (
    "M -1 0 A 1 1 0 1 1 1 0 A 1 1 0 1 1 -1 0 Z",
    "M -0.9 -0.9 H 0.9 V 0.9 H -0.9 Z",
    "M 0 -1.1 L 1.1 0.85 H -1.1 Z",
    "M 0 -1.2 L 1.2 0 L 0 1.2 L -1.2 0 Z",
    "M 0 1.1 L 1.1 -0.85 H -1.1 Z",
    "M -0.4 -1.1 H 0.4 V -0.4 H 1.1 V 0.4 H 0.4 V 1.1 H -0.4 V 0.4 H -1.1 V -0.4 H -0.4 Z",
    "M -0.5 0 L -1 -0.5 L -0.5 -1 L 0 -0.5 L 0.5 -1 L 1 -0.5 L 0.5 0 L 1 0.5 L 0.5 1 L 0 0.5 L -0.5 1 L -1 0.5 Z",
)
"""The markers as SVG paths, about the size of a circle of radius 1."""
DASHES: tuple[tuple[Any, tuple[float, ...]], ...] = (
    ("-", ()),
    ("--", (7, 3)),
    (":", (2, 2)),
    ("-.", (8, 3, 2, 3)),
    ((0, (6, 1.5, 1, 1.5, 1, 1.5)), (10, 2, 2, 2, 2, 2)),
)
"""The dash patterns of lines in the order of use: for Matplotlib, and in pixels for web pages."""
REFERENCE_STYLE: dict[str, Any] = {"color": "0.45", "linestyle": (0, (4, 2)), "linewidth": 1.2}
"""Line style of the reference."""


@dataclass(frozen=True)
class Look:
    """Colour, dash pattern and marker of a policy."""

    colour: str
    dash: int  # index in `DASHES`
    marker: int  # index in `MARKERS`


LOOKS = tuple(
    Look(COLOURS[i % len(COLOURS)], i // len(COLOURS), (i + i // len(COLOURS)) % len(MARKERS))
    for i in range(len(COLOURS) * len(DASHES))
)
"""All looks in the order of use; no two have the same line, and no two have the same point."""


def look(name: str, names: Sequence[str]) -> Look:
    """Return the look of a policy, by its position among the names of a figure or page."""
    return LOOKS[names.index(name) % len(LOOKS)]


_STYLE: Any = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.titleweight": "bold",
    "axes.labelsize": 9,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "grid.color": "0.9",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "lines.linewidth": 1.3,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "savefig.dpi": 130,
}


def styled() -> AbstractContextManager[None]:
    """Return the context manager in which figures are made and saved."""
    import matplotlib as mpl

    return mpl.rc_context(_STYLE)


def to_png(figure: Figure) -> bytes:
    """Return a figure as the bytes of a PNG file; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    with styled():
        figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def panels(rows: int, columns: int, size: tuple[float, float], **options: Any) -> tuple[Figure, list[list[Axes]]]:
    """Return a figure of this size [inch] with rows x columns axes; the options are those of `Figure.subplots`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    with styled():
        axes = figure.subplots(rows, columns, squeeze=False, **options)
    return figure, [list(row) for row in axes]
