"""The values of docs/elsewhere.md: what two simulators say about the same policies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from baselines.tools.files import read_json
from research.transfer.comparison import GROWTH, TAU, TRANSFER_FILE


def context(page: str) -> dict[str, Any]:
    """Return the tables of each vehicle."""
    del page
    return {"vehicles": [_vehicle(name, record) for name, record in read_json(TRANSFER_FILE).items()]}


def _vehicle(name: str, record: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the page shows of a vehicle, of what the study has kept."""
    tau, cases, causes, trials = (record[key] for key in ("tau", "cases", "causes", "trials"))
    policies = sorted(record["policies"].items(), key=lambda item: item[1]["plane_m"])
    runs = [(f"{r['F_u']:.3g} N ahead", f"{r['plane']:.3g} m/s", f"{r['space']:.3g} m/s") for r in trials["straight"]]
    turns = [(f"{r['F_r']:.3g} N m in yaw", f"{r['plane']:.3g} m", f"{r['space']:.3g} m") for r in trials["turns"]]
    return {
        "name": name,
        "verdict": verdict(record),
        "cases": cases,
        "policies": [_policy(policy, own, cases) for policy, own in policies],
        "ranks": [
            *((case, f"{tau['by_case'][case]:.2f}") for case in cases),
            ("all", f"**{tau['all']:.2f}** ({_ends(tau['ci95'])})"),
            ("all, by medians", f"{tau['medians']:.2f}"),
        ],
        "causes": {
            "case": causes["case"],
            "policies": [f"`{policy}`" for policy in causes["policies"]],
            "growth": [(what, *(f"{of[p]:.2f}" for p in causes["policies"])) for what, of in causes["growth"].items()],
        },
        "trials": runs + turns,
    }


def _policy(name: str, own: Mapping[str, Any], cases: list[str]) -> list[Any]:
    growth = f"{own['growth']:.2f} ({_ends(own['ci95'])})"
    by_case = (f"{own['growth_by_case'][case]:.2f}" for case in cases)
    errors = f"{own['plane_m']:.3g}", f"{own['space_m']:.3g}"
    return [f"`{name}`", *errors, growth, own["lost_plane"], own["lost_space"], *by_case]


def _ends(interval: tuple[float, float]) -> str:
    low, high = interval
    return f"{low:.2f} ... {high:.2f}"


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
