"""`evaluate.py --stability`: where a policy is stable, how slow its computer may be, from where it converges."""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from auv_gym.actuators import Actuators
from auv_gym.presets import PAPER_SCENARIO
from auv_gym.residual import Policy
from auv_gym.scenario import Start
from auv_gym.vehicle import PAPER_VEHICLE
from baselines import make_policy
from baselines.command_line import DONE, FAILED
from baselines.evaluation.files import json_text, write_atomically
from baselines.evaluation.rollout import PolicyError, rollout
from baselines.evaluation.runner import drawn
from baselines.evaluation.stability import LONGEST_PERIOD, linearise_policy
from baselines.evaluation.style import panels, styled, to_png
from baselines.evaluation.tables import LOOK, console

SPEEDS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.75, 1.0, 1.5, 2.0)
"""Path speeds [m/s] of the map ..."""
TURN_RATES = (0.0, 0.1, 0.2, 0.3)
"""... and turn rates [rad/s]."""
LIMITS: dict[str, tuple[float, float]] = {"without limits": (8192.0, 4096.0), "250 N, 120 N m": (250.0, 120.0)}
"""Limits of the actuators [N], [N m] that success is sampled with; none means the largest that can be set."""
STARTS, DISTANCE = 200, 5.0
"""Number of random starts, and their largest offset on each axis [m]; any heading."""
SETTLED = 0.05
"""Position error [m] below which a start has converged after `STEPS`."""
STEPS = 2000


@dataclass(frozen=True)
class Stability:
    """What is known of a policy's local stability and of its region of attraction."""

    policy: str
    speeds: tuple[float, ...]  # [m/s]
    turn_rates: tuple[float, ...]  # [rad/s]
    abscissa: list[list[float]]  # [1/s] largest real part, a row for each speed
    largest_period: list[list[float]]  # [s] the same; 0 where the continuous loop is unstable
    success: dict[str, float]  # share of the starts that converge on the paper's circle, by limits


def examine(name: str) -> Stability:
    """Return what is known of a policy.

    Raises:
        ValueError: the policy has a memory.
        PolicyError: it gives no usable actions.
    """
    policy = make_policy(name)
    loops = [
        [
            linearise_policy(PAPER_VEHICLE, policy, speed, turn_rate, PAPER_SCENARIO.control_dt)
            for turn_rate in TURN_RATES
        ]
        for speed in SPEEDS
    ]
    return Stability(
        name,
        SPEEDS,
        TURN_RATES,
        [[float(loop.eigenvalues[0].real) for loop in row] for row in loops],
        [[loop.largest_period() for loop in row] for row in loops],
        {label: success(policy, limits, STARTS) for label, limits in LIMITS.items()},
    )


def success(policy: Policy, limits: tuple[float, float], starts: int) -> float:
    """Return the share of random starts from which a policy converges to the paper's circle within 200 s.

    Evidence, no proof: starts lie up to `DISTANCE` off on each axis, with any heading, at the reference's speed.
    """
    offset = (-DISTANCE, DISTANCE)
    scenario = replace(
        PAPER_SCENARIO,
        name="random-starts",
        actuators=Actuators(*limits),
        start=Start(x_e=offset, y_e=offset, psi_e=(-math.pi, math.pi)),
        steps=STEPS,
        lost_distance=64.0,
    )
    result = rollout(policy, scenario, drawn(scenario, starts, 0).episodes, math.inf)
    return float(np.mean(result.errors[-1] < SETTLED))


def report(names: Sequence[str], out: Path) -> int:
    """Examine policies, print what is found, write stability.json and stability.png, and return the exit status."""
    found, screen = [], console()
    for name in names:
        try:
            found.append(examine(name))
        except (ValueError, RuntimeError, PolicyError) as error:
            print(f"{name}: {error}", file=sys.stderr)
            continue
        for table in _tables(found[-1]):
            screen.print(table)
    if not found:
        return FAILED
    write_atomically(out / "stability.json", json_text([asdict(s) for s in found]))
    with styled():
        write_atomically(out / "stability.png", to_png(stability_map(found)))
    screen.print(f"Wrote stability.json and stability.png to {out}", soft_wrap=True)
    return DONE if len(found) == len(names) else FAILED


def _tables(s: Stability) -> list[Table]:
    maps = (
        (f"{s.policy}: largest real part \\[1/s]", s.abscissa, "{:+.3f}".format),
        ("Largest control period with a hold \\[s]", s.largest_period, _period),
    )
    tables = []
    for title, rows, text in maps:
        table = Table(title=title, **LOOK)
        for heading in ("speed \\[m/s]", *(f"{turn_rate:g} rad/s" for turn_rate in s.turn_rates)):
            table.add_column(heading, justify="right")
        for speed, row in zip(s.speeds, rows, strict=True):
            table.add_row(f"{speed:g}", *(text(value) for value in row))
        tables.append(table)
    starts = Table(title=f"Converged, of {STARTS} starts at 0.1 m/s", caption=f"up to {DISTANCE:g} m off", **LOOK)
    for label in s.success:
        starts.add_column(label, justify="right")
    starts.add_row(*(f"{100 * share:.0f} %" for share in s.success.values()))
    return [*tables, starts]


def _period(value: float) -> str:
    return "unstable" if value == 0 else f"> {LONGEST_PERIOD:g}" if math.isinf(value) else f"{value:.2f}"


def stability_map(found: Sequence[Stability]) -> Figure:
    """Return the largest real part over speed and turn rate, a panel for each policy; unstable is red."""
    figure, axes = panels(1, len(found), (1.2 + 3.2 * len(found), 3.4), sharey=True)
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
    figure.supxlabel("path speed [m/s]", fontsize=9)
    figure.colorbar(image, ax=axes[0], label="largest real part [1/s]")
    return figure
