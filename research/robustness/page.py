"""The values of docs/safety.md: the results of the studies in this folder."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from baselines.evaluation.metrics import failure_bound
from baselines.evaluation.score import speed_range_of
from research.robustness import failure_rate, guards


def context(_: str = "") -> dict[str, Any]:
    """Return the rows of the tables of the page."""
    rates = [row for policy, own in failure_rate.failure_counts().items() for row in _rates(policy, own["counts"])]
    _, _, episodes, failures, at_most, _ = next(row for row in rates if row[0] == "`helm`")
    assert failures == "0"  # as the first sentence says
    return {
        "rates": rates,
        "episodes": episodes,
        "at_most": at_most,
        "guards": guards.compared(),
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
