"""The values of docs/safety.md: the results of the studies in this folder."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from baselines.evaluation.metrics import failure_bound
from baselines.evaluation.score import speed_range_of
from baselines.tools.files import read_json
from research.robustness import failure_rate, falsification, guards

_SHOWN = 6
"""Number of coordinates of a point on the page, the largest ones."""


def context(_: str = "") -> dict[str, Any]:
    """Return the rows of the tables of the page."""
    kept = read_json(guards.GUARDS_FILE)
    rates = [row for policy, own in failure_rate.failure_counts().items() for row in _rates(policy, own["counts"])]
    _, _, episodes, failures, at_most, _ = next(row for row in rates if row[0] == "`helm`")
    assert failures == "0"  # as the first sentence says
    return {
        "rates": rates,
        "episodes": episodes,
        "at_most": at_most,
        "points": [_point(name, found) for name, found in sorted(falsification.found_points().items(), key=_place)],
        "suites": [
            [f"`{policy}`", suite, *(row[k] for k in guards.COUNTS), *(f"{row[k]:.2f}" for k in guards.STEADY_RMSES)]
            for policy, own in kept.items()
            for suite, row in own.items()
            if suite != guards.FINGERPRINT
        ],
    }


def _rates(policy: str, counts: Mapping[str, failure_rate.FailureCount]) -> list[list[str]]:
    """Return the rows of a policy, one for each set of scenarios."""
    groups: dict[str, list[failure_rate.FailureCount]] = {}
    for name, count in counts.items():
        groups.setdefault(f"the eight cases, {speed_range_of(name)}", []).append(count)
    rows = []
    for place, own in groups.items():
        failed, episodes, worst = failure_rate.total(own)
        at_most = f"{100 * failure_bound(failed, episodes):.2g} %"
        unequal = "" if len({count["episodes"] for count in own}) == 1 else ", some more often"
        rows.append([f"`{policy}`", f"{place}{unequal}", str(episodes), str(failed), at_most, f"{100 * worst:.3g}"])
    return rows


def _place(item: tuple[str, Mapping[str, Any]]) -> tuple[str, float]:
    found = item[1]
    return found["speed_range"], -(found["severity"] or math.inf)


def _point(name: str, found: Mapping[str, Any]) -> list[str]:
    known = [(key, x) for key, x in found["coordinates"].items() if key != "direction"]
    largest = sorted(known, key=lambda entry: -abs(entry[1]))[:_SHOWN]
    severity = found["severity"]
    return [
        f"`{found['policy']}`",
        found["speed_range"],
        "none found" if severity is None else f"[{severity:.2f}](failing-scenarios/{name}.toml)",
        f"{found['failed']} of {falsification.CONFIRMED}",
        str(found["episodes"]),
        ", ".join(f"{key} {x:+.2f}" for key, x in largest),
    ]
