"""Recompute numbers and figures of the paper: `python -m research paper --help`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import RandomPath
from baselines.control.backstepping import GAINS
from baselines.tools.command_line import DONE, checked_folder, parse
from baselines.tools.files import write_atomically
from research.pages import table
from research.paper.figures import paper_figures
from research.paper.numbers import TableRow, reproduce_paper
from research.paper.stability import held_abscissa, spectral_abscissa

_VERDICTS = {True: "yes", False: "no", None: "-"}
_HELD = (("paper", "slow"), ("cruise", "cruise"), ("normalised", "slow"), ("normalised", "cruise"))
"""Gains and speed ranges of the loops with held commands."""
_LAGS = (0.0, 0.12, 0.36, 0.6, 1.0, 2.0)  # [s] of the actuators


@dataclass(frozen=True)
class Options:
    """Print the printed and the recomputed numbers of the paper and local stability, and write the figures 3 to 6.

    Exit status: 0 done, 2 wrong usage.
    """

    out: Path = Path("runs/paper")
    """Folder for the figures."""


def numbers_section() -> str:
    """Return the printed and the recomputed numbers as a table in Markdown."""
    rows = [(*_cells(r), r.unit, _VERDICTS[r.agrees], r.note) for r in reproduce_paper().rows]
    return table(("quantity", "place", "printed", "recomputed", "unit", "agrees", "note"), rows, right=False)


def starts_section() -> str:
    """Return the responses from the eight starts of section V as a table in Markdown."""
    heads = (
        "signs of x_e, y_e, psi_e", "within 5 cm [s]", "within 1 deg [s]", "peak F_u [N]", "peak F_r [N m]",
        "error at 100 s [m]",
    )  # fmt: skip
    rows = [(f"`{signs}`", *(f"{number:.3g}" for number in numbers)) for signs, *numbers in reproduce_paper().starts]
    return table(heads, rows, right=False)


def remarks_section() -> str:
    """Return the printed equations that do not hold as a table in Markdown."""
    rows = [
        (place, what, printed, holds, r.unit, r.note)
        for r in reproduce_paper().remarks
        for what, place, printed, holds in (_cells(r),)
    ]
    return table(("place", "what", "printed", "what holds", "unit", "why"), rows, right=False)


def held_growth(gains: str, speed_range: str) -> dict[float, list[float]]:
    """Return the largest real parts [1/s] in continuous time, then those with held commands and `_LAGS`, by speed.

    Each is the larger one of a straight line and of a circle with the turn rate of the presets of a speed range.
    """
    scenario, law = PRESETS[f"{speed_range}-calm"], GAINS[gains]
    path, growth = scenario.path, {}
    assert isinstance(path, RandomPath)
    for speed in np.quantile(path.speed, (0.0, 0.5, 1.0)).tolist():
        both = [(PAPER_VEHICLE, law, speed, turn_rate) for turn_rate in (0.0, path.turn_rate)]
        held = [max(held_abscissa(*motion, scenario.control_dt, lag) for motion in both) for lag in _LAGS]
        growth[speed] = [max(spectral_abscissa(*motion) for motion in both), *held]
    return growth


def held_section() -> str:
    """Return the `held_growth` of the loops in `_HELD` as a table in Markdown."""
    heads = ("gains", "control period [s]", "speed [m/s]", "continuous", *(f"lag {lag:g} s" for lag in _LAGS))
    rows = [
        (f"`{gains}`", PRESETS[f"{speed_range}-calm"].control_dt, f"{speed:.1f}", *(f"{x:+.3f}" for x in growth))
        for gains, speed_range in _HELD
        for speed, growth in held_growth(gains, speed_range).items()
    ]
    return table(heads, rows)


def _cells(row: TableRow) -> tuple[str, str, str, str]:
    """Return quantity, place, printed and recomputed value."""
    paper, measured = ("-" if value is None else f"{value:.4g}" for value in (row.paper, row.measured))
    return row.quantity.replace("|", "\\|"), row.place, paper, measured


def main(arguments: Sequence[str]) -> int:
    """Recompute the paper and return the exit status."""
    folder = checked_folder(parse(Options, arguments, "python -m research paper").out)
    for section in (numbers_section, starts_section, remarks_section, held_section):
        print(f"{section()}\n")
    for name, png in paper_figures(reproduce_paper()).items():
        write_atomically(folder / f"{name}.png", png)
    print(f"figures: {folder}")
    return DONE
