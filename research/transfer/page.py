"""What docs/elsewhere.md shows of two simulators: tables in Markdown."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from auv_gym.scenarios.vehicles import craft
from research.pages import table
from research.transfer.comparison import GROWTH, TAU
from research.transfer.trials import Commanded, in_the_plane, limits, steady
from research.transfer.worlds import Own

BEGIN = "<!-- elsewhere: written by REFRESH_DOCS=1 python -m pytest tests/research/test_elsewhere.py -->"
END = "<!-- end of elsewhere -->"
"""What stands before the tables, and behind them."""
FORCES = (0.1, 0.25, 0.5, 1.0)
"""Shares of the limits at which straight runs and turns are compared."""


def turned(name: str) -> dict[str, list[dict[str, float]]]:
    """Return how fast a vehicle gets and how tightly it turns under the same forces in the plane and in space.

    Turns are at the plane's surge force of the design speed.

    Args:
        name: of the vehicle.
    """
    own = craft(name)
    speed, most = own.vehicle.speed, limits(own)
    cruise = own.drag(speed)[0] * speed
    makers = (lambda: in_the_plane(name)), (lambda: Commanded(Own(name, 1), speed=speed))
    straight, turns = [], []
    for share in FORCES:
        u = [steady(make, share * most.F_u_max, 0.0, speed)[0] for make in makers]
        straight.append({"F_u": share * most.F_u_max, "plane": u[0], "space": u[1]})
        found = [steady(make, cruise, share * most.F_r_max, speed) for make in makers]
        D = [2 * math.hypot(u, v) / r for u, v, r in found]
        turns.append({"F_r": share * most.F_r_max, "plane": D[0], "space": D[1]})
    return {"straight": straight, "turns": turns}


def section(name: str, record: Mapping[str, Any]) -> str:
    """Return what the page says about a vehicle.

    Args:
        name: of the vehicle.
        record: what `comparison.summarised` says, its `causes` and `trials`.
    """
    tau, cases = record["tau"], record["cases"]
    rows = []
    for policy, own in sorted(record["policies"].items(), key=lambda item: item[1]["plane_m"]):
        low, high = own["ci95"]
        growth = f"{own['growth']:.2f} ({low:.2f} ... {high:.2f})"
        rows.append((
            f"`{policy}`", f"{own['plane_m']:.3g}", f"{own['space_m']:.3g}", growth,
            str(own["lost_plane"]), str(own["lost_space"]), *(f"{own['growth_by_case'][case]:.2f}" for case in cases),
        ))  # fmt: skip
    head = ("policy", "plane [m]", "space [m]", "growth", "lost, plane", "lost, space", *cases)
    ranks = [(case, f"{tau['by_case'][case]:.2f}") for case in cases]
    ranks.append(("all", f"**{tau['all']:.2f}** ({tau['ci95'][0]:.2f} ... {tau['ci95'][1]:.2f})"))
    ranks.append(("all, by medians", f"{tau['medians']:.2f}"))
    causes, trials = record["causes"], record["trials"]
    lacking = [(what, *(f"{growth[p]:.2f}" for p in causes["policies"])) for what, growth in causes["growth"].items()]
    runs = [(f"{r['F_u']:.3g} N ahead", f"{r['plane']:.3g} m/s", f"{r['space']:.3g} m/s") for r in trials["straight"]]
    runs += [(f"{r['F_r']:.3g} N m in yaw", f"{r['plane']:.3g} m", f"{r['space']:.3g} m") for r in trials["turns"]]
    return "\n\n".join((
        f"### `{name}`",
        verdict(record),
        table(head, rows),
        "Rank correlation, by case and over all:",
        table(("case", "Kendall's tau"), ranks),
        f"What makes the difference: growth in `{causes['case']}` where the vehicle in space lacks something:",
        table(("vehicle", *(f"`{p}`" for p in causes["policies"])), lacking),
        "Straight runs and turns under the same force, steady speed and diameter:",
        table(("force", "plane", "space"), runs),
    ))  # fmt: skip


def verdict(record: Mapping[str, Any]) -> str:
    """Return in a sentence how far the two simulators agree, beside what is asked for."""
    policies, tau = record["policies"], record["tau"]["all"]
    grown = [f"`{name}`" for name, own in policies.items() if own["growth"] > GROWTH]
    lost, before = (sum(own[place] for own in policies.values()) for place in ("lost_space", "lost_plane"))
    runs = record["episodes"] * len(record["cases"]) * len(policies)
    ranks = f"Kendall's tau {tau:.2f}, {'at least' if tau >= TAU else 'below'} the {TAU:g} that is asked for"
    errors = f"errors of {', '.join(grown)} more than {GROWTH:g} times larger" if grown else "no error 1.5 times larger"
    return (
        f"{len(policies)} policies, {len(record['cases'])} cases, {record['episodes']} episodes of each. {ranks}; "
        f"{errors}; {lost} of {runs} episodes lost, in the plane {before}."
    )
