"""What is left to gain, of the results page: how far the best policies are from the floor of measurement noise."""

from __future__ import annotations

import math
from collections.abc import Mapping

from baselines.evaluation.report.columns import NONE
from baselines.evaluation.score import FORESIGHTED, RIVAL, fixed, regime_of
from research.lower_bounds.floor.command import PROGRAM, Floor, recorded_floors
from research.pages import table
from research.results.collection import Results

_FLOOR = "floor"
"""Stands in the place of a policy."""


def what_is_left(results: Results) -> list[str]:
    """Return the section with the floor, the rival and the best policy of each regime; [] where no floor is known."""
    floors = recorded_floors(results.suite.source[1])
    if not floors or results.suite.anchors.one not in results.tails:
        return []
    parts = [_TEXT]
    for regime in dict.fromkeys(entry.place for entry in results.pooled):
        tails = _tails(results, regime, floors)
        noisy = [case for case in floors if regime_of(case) == regime]
        scores = _scores(tails, *results.suite.anchors)
        best = max((policy for policy in tails if policy not in (_FLOOR, *FORESIGHTED)), key=scores.__getitem__)
        shown = [
            policy for policy in dict.fromkeys((_FLOOR, best, RIVAL, results.suite.anchors.zero)) if policy in tails
        ]
        rows = [
            [
                policy if policy == _FLOOR else f"`{policy}`",
                fixed(scores[policy]),
                NONE if policy == _FLOOR else fixed(scores[_FLOOR] - scores[policy]),
                *(f"{1e3 * tails[policy][case]:.1f}" for case in noisy),
                NONE if policy == _FLOOR else " / ".join(f"{tails[policy][c] / tails[_FLOOR][c]:.1f}" for c in noisy),
            ]
            for policy in shown
            if policy in tails
        ]
        cases = [case.removeprefix(f"{regime}-") for case in noisy]
        parts.append(table((regime, "score", "left", *(f"{case} [mm]" for case in cases), "times the floor"), rows))
    return parts


def _tails(results: Results, regime: str, floors: Mapping[str, Floor]) -> dict[str, dict[str, float]]:
    """Return the mean tail errors [m] by policy, then by case of a regime, of those that ran in all of them whole.

    That of the floor is the bound's where measurements are exact.
    """
    lengths = {c.scenario.name: len(c.episodes) for c in results.suite.cells if regime_of(c.scenario.name) == regime}
    found: dict[str, dict[str, float]] = {}
    for run in results.runs:
        if run.measures is not None and lengths.get(run.scenario.name) == len(run.measures):
            found.setdefault(run.policy, {})[run.scenario.name] = results.tails[run.policy][run.scenario.name]
    whole = {policy: own for policy, own in found.items() if len(own) == len(lengths)}
    best = whole[results.suite.anchors.one]
    return whole | {_FLOOR: {c: max(floors[c].tail_m, best[c]) if c in floors else best[c] for c in lengths}}


def _scores(tails: Mapping[str, Mapping[str, float]], zero: str, one: str) -> dict[str, float]:
    """Return the pooled scores of the policies; a cell of a regime has as many episodes as another."""
    pooled = {policy: math.fsum(own.values()) for policy, own in tails.items()}
    return {policy: (pooled[zero] - own) / (pooled[zero] - pooled[one]) for policy, own in pooled.items()}


_TEXT = f"""### What is left

A vehicle can be kept no nearer to its reference than it can be located. The *floor* is how near that is for whom
everything is told but what chance has drawn: the numbers behind the measurement errors, the gusts, the phases of the
waves and the start; vehicle, lag and statistics of the sea are known, and commands are free and unlimited
(`{PROGRAM}`;
[Evaluation](../metrics.md#the-floor-of-measurement-noise) says how it is computed). Where measurements are
exact, in six of the eight cases, it is the bound. *Left* is the score between a policy and the floor. The floor itself
is out of reach: nobody is told vehicle, lag and waves, and commands are limited."""
