"""What `evaluate.py --stability` finds, as tables on the terminal and as a picture."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from rich.markup import escape as plain
from rich.table import Table

from baselines.control.linearisation import LONGEST_PERIOD
from baselines.evaluation.report.terminal import LOOK
from baselines.evaluation.stability.certificate import FINE, Certificate
from baselines.tools.figure_style import panels

DISTANCE = 5.0
"""Largest offset [m] on each axis of a random start; any heading."""


@dataclass(frozen=True)
class Stability:
    """What is known of a policy's local stability and of its region of attraction."""

    policy: str
    speeds: tuple[float, ...]  # [m/s]
    turn_rates: tuple[float, ...]  # [rad/s]
    abscissa: list[list[float]]  # [1/s] growth of small errors, a row for each speed; see `sampled_loop.Steady.rate`
    swing: list[list[float]]  # [m] how far it keeps moving to and fro
    largest_period: list[list[float]] | None  # [s]; 0 where the continuous loop is unstable; None: it has a memory
    limiting_speeds: list[float]  # [m/s] at which straight lines change between stable and unstable
    starts: int  # random starts behind `success`
    success: dict[str, float]  # share of the starts that converge on the paper's circle, by limits
    certificates: list[Certificate] | None  # box by box, speed by speed; None: no solver, or it has a memory


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
    decay = [(speed, *row) for speed, row in zip(speeds, decay_texts(s), strict=True)]
    found = [Sheet(f"{s.policy}: growth of small errors [1/s]", "about steady motion, by turn rate", names, decay)]
    if s.largest_period is not None:
        periods = [(speed, *map(_period, row)) for speed, row in zip(speeds, s.largest_period, strict=True)]
        found.append(
            Sheet("Largest control period with a hold [s]", "about steady motion, by turn rate", names, periods)
        )
    share = tuple(f"{100 * share:.0f} %" for share in s.success.values())
    title = f"Converged, of {s.starts} starts at 0.1 m/s"
    found.append(Sheet(title, f"on the paper's circle, up to {DISTANCE:g} m off", tuple(s.success), [share]))
    return found if s.certificates is None else [*found, _certified(s.certificates)]


def decay_texts(s: Stability) -> list[list[str]]:
    """Return the growth of small errors as text, a row for each speed."""
    rows = zip(s.abscissa, s.swing, strict=True)
    return [[_growth(rate, swing) for rate, swing in zip(rates, swings, strict=True)] for rates, swings in rows]


def _growth(rate: float, swing: float) -> str:
    if math.isfinite(rate):
        return f"{rate:+.3f}"
    if math.isinf(rate):
        return "leaves"
    return f"swings {1e3 * swing:.1f} mm" if swing else "limits"


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


def stability_map(found: Sequence[Stability]) -> Figure:
    """Return the growth of small errors over speed and turn rate, a panel for each policy; unstable is red."""
    picture, axes = panels(1, len(found), (1.2 + 3.2 * len(found), 3.4), sharey=True)
    for ax, s in zip(axes[0], found, strict=True):
        values = np.array(s.abscissa).T
        image = ax.imshow(values, origin="lower", aspect="auto", cmap="RdBu_r", vmin=-0.4, vmax=0.4)
        texts = np.array(decay_texts(s)).T
        for (i, j), value in np.ndenumerate(values):
            colour = "white" if abs(value) > 0.28 else "black"
            text = f"{value:.2f}" if math.isfinite(value) else str(texts[i, j]).replace(" ", "\n")
            ax.text(j, i, text, ha="center", va="center", fontsize=7 if math.isfinite(value) else 5, color=colour)
        ax.set_xticks(range(len(s.speeds)), [f"{speed:g}" for speed in s.speeds])
        ax.set_yticks(range(len(s.turn_rates)), [f"{turn_rate:g}" for turn_rate in s.turn_rates])
        ax.grid(visible=False)
        ax.set_title(s.policy)
    axes[0][0].set_ylabel("turn rate [rad/s]")
    picture.supxlabel("path speed [m/s]", fontsize=9)
    picture.colorbar(image, ax=axes[0], label="growth of small errors [1/s]")
    return picture
