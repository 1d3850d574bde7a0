"""What `evaluate.py --stability` finds, as tables on the terminal, as a page and as a picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from matplotlib.figure import Figure
from rich.markup import escape as plain
from rich.table import Table

from baselines.control.linearisation import LONGEST_PERIOD
from baselines.evaluation.report.page import figure, page, table
from baselines.evaluation.report.terminal import LOOK
from baselines.evaluation.stability.certificate import FINE, MISSING, Certificate
from baselines.tools.figure_style import panels

DISTANCE = 5.0
"""Largest offset [m] on each axis of a random start; any heading."""


@dataclass(frozen=True)
class Stability:
    """What is known of a policy's local stability and of its region of attraction."""

    policy: str
    speeds: tuple[float, ...]  # [m/s]
    turn_rates: tuple[float, ...]  # [rad/s]
    abscissa: list[list[float]]  # [1/s] largest real part, a row for each speed
    largest_period: list[list[float]]  # [s] the same; 0 where the continuous loop is unstable
    starts: int  # random starts behind `success`
    success: dict[str, float]  # share of the starts that converge on the paper's circle, by limits
    certificates: list[Certificate] | None  # box by box, speed by speed; None: no solver


@dataclass(frozen=True)
class Sheet:
    """A table, wherever it is shown."""

    title: str
    note: str
    names: tuple[str, ...]
    rows: list[tuple[str, ...]]


def sheets(s: Stability) -> list[Sheet]:
    """Return all tables about a policy."""
    speeds = [f"{speed:g}" for speed in s.speeds]
    names = ("speed [m/s]", *(f"{turn_rate:g} rad/s" for turn_rate in s.turn_rates))
    decay = [(speed, *map("{:+.3f}".format, row)) for speed, row in zip(speeds, s.abscissa, strict=True)]
    periods = [(speed, *map(_period, row)) for speed, row in zip(speeds, s.largest_period, strict=True)]
    return [
        Sheet(f"{s.policy}: largest real part [1/s]", "about steady motion, by turn rate", names, decay),
        Sheet("Largest control period with a hold [s]", "about steady motion, by turn rate", names, periods),
        Sheet(
            f"Converged, of {s.starts} starts at 0.1 m/s",
            f"on the paper's circle, up to {DISTANCE:g} m off",
            tuple(s.success),
            [tuple(f"{100 * share:.0f} %" for share in s.success.values())],
        ),
        *([] if s.certificates is None else [_certified(s.certificates)]),
    ]


def _certified(certificates: Sequence[Certificate]) -> Sheet:
    speeds = tuple(dict.fromkeys(c.speed for c in certificates))
    found: dict[str, list[str]] = {}
    for c in certificates:
        found.setdefault(str(c.box), []).append("none" if c.rate is None else f"{c.rate:.4f}")
    return Sheet(
        "Certified decay rate [1/s], for all references in a box of r_R [rad/s], gamma [rad], U'/U [1/s]",
        f"a quadratic Lyapunov function for all, checked at {FINE} x {FINE}; none: not found, or U' with a law that "
        "depends on the speed",
        ("references", *(f"{speed:g} m/s" for speed in speeds)),
        [(box, *rates) for box, rates in found.items()],
    )


def _period(value: float) -> str:
    return "unstable" if value == 0 else f"> {LONGEST_PERIOD:g}" if math.isinf(value) else f"{value:.2f}"


def terminal_table(sheet: Sheet) -> Table:
    """Return a table for the terminal."""
    found = Table(title=plain(sheet.title), caption=plain(sheet.note), **LOOK)
    for name in sheet.names:
        found.add_column(plain(name), justify="right")
    for row in sheet.rows:
        found.add_row(*row)
    return found


def stability_html(found: Sequence[Stability], png: bytes, command: str) -> str:
    """Return the text of the page about some policies."""
    parts = [f"<p><code>{escape(command)}</code></p>", figure("Largest real part; unstable is red.", png)]
    for s in found:
        parts.append(f"<h2>{escape(s.policy)}</h2>")
        for sheet in sheets(s):
            caption = f"{sheet.title}; {sheet.note}"
            parts.append(f"<p class='note'>{escape(caption)}</p>{table(sheet.names, [(False, r) for r in sheet.rows])}")
        if s.certificates is None:
            parts.append(f"<p class='note'>{escape(MISSING)}</p>")
    return page("Stability about steady motion", "\n".join(parts))


def stability_map(found: Sequence[Stability]) -> Figure:
    """Return the largest real part over speed and turn rate, a panel for each policy; unstable is red."""
    picture, axes = panels(1, len(found), (1.2 + 3.2 * len(found), 3.4), sharey=True)
    for ax, s in zip(axes[0], found, strict=True):
        values = np.array(s.abscissa).T
        image = ax.imshow(values, origin="lower", aspect="auto", cmap="RdBu_r", vmin=-0.4, vmax=0.4)
        for (i, j), value in np.ndenumerate(values):
            colour = "white" if abs(value) > 0.28 else "black"
            ax.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=7, color=colour)
        ax.set_xticks(range(len(s.speeds)), [f"{speed:g}" for speed in s.speeds])
        ax.set_yticks(range(len(s.turn_rates)), [f"{turn_rate:g}" for turn_rate in s.turn_rates])
        ax.grid(visible=False)
        ax.set_title(s.policy)
    axes[0][0].set_ylabel("turn rate [rad/s]")
    picture.supxlabel("path speed [m/s]", fontsize=9)
    picture.colorbar(image, ax=axes[0], label="largest real part [1/s]")
    return picture
