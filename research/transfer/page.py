"""The values of docs/transfer.md: the same policies in two simulators."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from baselines.tools.files import read_json
from research.transfer.comparison import GROWTH, TAU, TRANSFER_FILE


def context(_: str = "") -> dict[str, Any]:
    """Return the values of the page's template."""
    vehicles = [_vehicle(name, record) for name, record in read_json(TRANSFER_FILE).items()]
    return {"vehicles": vehicles, "tau": f"{TAU:g}", "growth": f"{GROWTH:g}"}


def _vehicle(name: str, record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the texts and tables of a vehicle."""
    tau, cases = record["tau"], record["cases"]
    policies = sorted(record["policies"].items(), key=lambda item: item[1]["plane_m"])
    ranks = [*(f"{tau['by_case'][case]:.2f}" for case in cases), f"{tau['all']:.2f} ({_ends(tau['ci95'])})"]
    return {
        "name": name,
        "verdict": verdict(record),
        "cases": cases,
        "policies": [_policy(policy, own, cases) for policy, own in policies],
        "ranks": ["tau", *ranks, f"{tau['medians']:.2f}"],
        "trials": _trials(record["trials"]),
    }


def _policy(name: str, own: Mapping[str, Any], cases: list[str]) -> list[Any]:
    low, high = own["ci95"]
    growth = f"{own['growth']:.2g} ({low:.2g} ... {high:.2g})"
    by_case = (f"{own['growth_by_case'][case]:.2g}" for case in cases)
    errors = f"{own['plane_m']:.3g}", f"{own['space_m']:.3g}"
    return [f"`{name}`", *errors, growth, f"{own['failed_plane']} / {own['failed_space']}", *by_case]


def _ends(interval: tuple[float, float]) -> str:
    low, high = interval
    return f"{low:.2f} ... {high:.2f}"


def _trials(record: Mapping[str, Any]) -> str:
    """Return a sentence that compares the steady motion in both simulators."""
    speeds, diameters = ([r["space"] / r["plane"] for r in record[kind]] for kind in ("straight", "turns"))
    return (
        f"Under the same surge force the steady speed in 6-DOF is {min(speeds):.2f} to {max(speeds):.2f} times that in "
        f"the plane. Under the same yaw torque the turning diameter is {min(diameters):.2f} to {max(diameters):.2f} "
        "times as large."
    )


def _smallest(names: list[str]) -> str:
    """Return which policy has the smallest error, and which ones do not differ significantly from it."""
    first, *level = (f"`{name}`" for name in names)
    return f"{first} has the smallest error" + (f", level with {', '.join(level)}" if level else "")


def verdict(record: Mapping[str, Any]) -> str:
    """Return sentences that compare ranks and errors in both simulators."""
    policies, tau = record["policies"], record["tau"]["all"]
    ratios = sorted((own["growth"], name) for name, own in policies.items())
    grown = sum(own["growth"] > GROWTH for own in policies.values())
    failed, before = (sum(own[place] for own in policies.values()) for place in ("failed_space", "failed_plane"))
    runs = record["episodes"] * len(record["cases"]) * len(policies)
    return (
        f"Kendall's tau is {tau:.2f} ({_ends(record['tau']['ci95'])}). In the plane "
        f"{_smallest(record['best']['plane'])}; in 6-DOF {_smallest(record['best']['space'])}. The errors in 6-DOF are "
        f"{ratios[0][0]:.2f} (`{ratios[0][1]}`) to {ratios[-1][0]:.2f} (`{ratios[-1][1]}`) times those in the plane; "
        f"the ratio of {grown} of {len(policies)} policies exceeds {GROWTH:g}. Failures: {failed} of {runs} episodes "
        f"in 6-DOF, {before} in the plane."
    )
