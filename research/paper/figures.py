"""Figures 3 to 6 of the paper, recomputed with the panels of the paper."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.planning.paths import PAPER_CIRCLE
from auv_gym.planning.planner import plan
from baselines.tools.figure_style import COLOURS, REFERENCE_STYLE, panels, styled, to_png
from research.paper.closed_loop import TIMES, ClosedLoopResponse
from research.paper.numbers import CHOSEN, SIGNS, Reproduction

_EARLY = 40.0  # [s] end of the panels with the transient
_VELOCITY_ERRORS = (("u_e", "m/s", 1.0), ("v_e", "m/s", 1.0), ("r_e", "rad/s", 1.0))
_POSE_ERRORS = (("x_e", "m", 1.0), ("y_e", "m", 1.0), ("psi_e", "deg", 180 / np.pi))


def paper_figures(reproduction: Reproduction) -> dict[str, bytes]:
    """Return the figures as PNG, by name."""
    response = reproduction.response
    with styled():
        return {
            "fig3_trajectory": to_png(_trajectory(response)),
            "fig4_forces": to_png(_forces(response)),
            "fig5_velocity_errors": to_png(_errors(response, 3, _VELOCITY_ERRORS, "Fig. 5")),
            "fig6_tracking_errors": to_png(_errors(response, 0, _POSE_ERRORS, "Fig. 6")),
        }


def _start_text() -> str:
    x_e, y_e, psi_e = SIGNS[CHOSEN]
    return f"start x_e = {0.5 * x_e:+g} m, y_e = {y_e:+g} m, psi_e = {20 * psi_e:+d} deg, at rest"


def _letter(axes: Sequence[Sequence[Axes]], titles: Sequence[str]) -> None:
    for ax, letter, title in zip((ax for row in axes for ax in row), "abcdef", titles, strict=False):
        ax.set_title(f"({letter}) {title}", loc="left")


def _trajectory(response: ClosedLoopResponse) -> Figure:
    """Return figure 3: the circle and the trajectory of the centre of mass, whole and near the start."""
    figure, [[wide, near]] = panels(1, 2, (9.0, 5.1))
    circle = PAPER_CIRCLE.derivatives(np.linspace(0.0, 200 * np.pi, 721))[0]
    for ax in (wide, near):
        for i, (x, y) in enumerate(zip(response.state[0], response.state[1], strict=True)):
            if i != CHOSEN:
                ax.plot(x, y, color=COLOURS[5], linewidth=0.8, label="the other seven signs" if i == 0 else None)
        x, y = response.state[:2, CHOSEN]
        ax.plot(x, y, color=COLOURS[0], linewidth=2.0, label="vehicle")
        ax.plot(x[0], y[0], "o", color=COLOURS[0], markersize=5)
        ax.plot(*circle, **REFERENCE_STYLE, label="reference", zorder=3)
        ax.set(xlabel="X [m]", ylabel="Y [m]")
        ax.set_aspect("equal", adjustable="box")
    wide.set(xlim=(-12.0, 12.0), ylim=(-12.0, 12.0))
    near.set(xlim=(-1.0, 3.4), ylim=(7.8, 12.2))
    wide.legend(loc="center")
    _letter([[wide, near]], ["trajectory, 100 s", "the start"])
    near.text(
        0.04, 0.03, "The paper prints moduli of the errors only;\nthis start needs the least surge force of the eight.",
        transform=near.transAxes, fontsize=8,
    )  # fmt: skip
    figure.suptitle(f"Fig. 3: {_start_text()}", fontsize=10)
    return figure


def _forces(response: ClosedLoopResponse) -> Figure:
    """Return figure 4: control force and torque near time zero, and their convergence to those of the plan."""
    figure, axes = panels(2, 2, (9.0, 5.4))
    planned = plan(PAPER_CIRCLE, PAPER_VEHICLE, np.array([0.0, 1.0])).table[0, 6:].tolist()
    names = (("F_u", "N", "force"), ("F_r", "N m", "torque"))
    for row, force, level, (name, unit, _) in zip(axes, response.force[:, CHOSEN], planned, names, strict=True):
        for ax in row:
            ax.axhline(level, **REFERENCE_STYLE, label=f"open loop: {level:.4g} {unit}")
            ax.plot(TIMES, force, color=COLOURS[0])
            ax.set(xlabel="time [s]", ylabel=f"{name} [{unit}]")
        row[0].set_xlim(0, 15)
        row[1].set_xlim(15, 60)
        late = force[(TIMES >= 15) & (TIMES <= 60)]
        margin = 0.08 * float(np.ptp(late))
        row[1].set_ylim(late.min() - margin, late.max() + margin)
        row[0].legend(loc="best")
    titles = [f"control {kind}, {part}" for *_, kind in names for part in ("near time zero", "convergence")]
    _letter(axes, titles)
    figure.suptitle(f"Fig. 4: {_start_text()}", fontsize=10)
    return figure


def _errors(response: ClosedLoopResponse, first: int, names: Sequence[tuple[str, str, float]], title: str) -> Figure:
    """Return six panels: three errors from row `first` on, in the transient and as magnitudes to the end.

    `names` has the name, the unit and the factor to that unit of each error.
    """
    figure, axes = panels(3, 2, (9.0, 7.0))
    for k, ((early, late), (name, unit, factor)) in enumerate(zip(axes, names, strict=True)):
        error = factor * response.errors[first + k, CHOSEN]
        early.axhline(0.0, **REFERENCE_STYLE)
        early.plot(TIMES, error, color=COLOURS[0])
        early.set(xlim=(0, _EARLY), ylabel=f"{name} [{unit}]")
        late.semilogy(TIMES, np.abs(error), color=COLOURS[0], linewidth=1.0)
        late.axhline(1e-5, color=COLOURS[1], linewidth=1.0, label="the paper's floor, 1e-5")
        late.set(xlim=(0, TIMES[-1]), ylabel=f"|{name}| [{unit}]")
    for ax in axes[-1]:
        ax.set_xlabel("time [s]")
    axes[0][1].legend(loc="upper right")
    _letter(axes, [text for name, *_ in names for text in (name, f"{name}, magnitude")])
    figure.suptitle(f"{title}: {_start_text()}", fontsize=10)
    return figure
