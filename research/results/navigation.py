"""What the navigation alone would be off in a deep suite, and every policy's error beyond that."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from auv_gym.physics.namespaces import Array
from baselines.evaluation.metrics import bootstrap_interval
from baselines.evaluation.score import FORESIGHTED, fixed, fixed_ends, regime_of
from research.pages import table
from research.results.collection import Results
from research.suites.deep import navigation_tails

NAVIGATION = """### Navigation

Between position fixes the position is reckoned, and most of an error is that of the navigation. The first row is the
mean tail error [m] of a controller without an error of its own, which keeps the estimated position exactly on the
reference; below it by how much [m] each policy's is larger in the same episodes, with the 95 % interval of the mean
over all cases by bootstrap over episodes. Less than zero is possible: who takes the mean of the estimate's jumps, or
learns from them how wrong the sensors are, knows more than the estimate says. Who scores 1 needs no navigation, so
that on the scale of the scores above nobody gets far from 0."""


def navigation(results: Results, regimes: Sequence[str]) -> list[str]:
    """Return what the navigation alone would be off, and every policy's error beyond that; [] where none reckons."""
    floor = {c.scenario.name: navigation_tails(c) for c in results.suite.cells if c.scenario.sensors.reckoning}
    cases, parts = results.cases, [NAVIGATION] if floor else []
    for regime in regimes if floor else ():
        own = [case for case in floor if regime_of(case) == regime]
        rows = [["navigation", *(fixed(floor[case].mean()) for case in own), *_mean([floor[case] for case in own])]]
        for policy in [p for p in results.policies if p not in FORESIGHTED and all(p in cases[case] for case in own)]:
            tails = [cases[case][policy].tail for case in own]
            more = [tail - floor[case][: len(tail)] for tail, case in zip(tails, own, strict=True)]
            rows.append([f"`{policy}`", *(fixed(m.mean()) for m in more), *_mean(more)])
        parts.append(table([regime, *(case.removeprefix(f"{regime}-") for case in own), "all", "95 %"], rows))
    return parts


def _mean(values: Sequence[Array]) -> tuple[str, str]:
    """Return the mean over all cases and its interval."""
    every = np.concatenate(values)
    return fixed(every.mean()), fixed_ends(bootstrap_interval(every))
