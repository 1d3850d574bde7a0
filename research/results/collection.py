"""What is recorded of the frozen suites, put together: scores of every policy, pooled and case by case."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

from baselines.evaluation import recorded, suites
from baselines.evaluation.metrics import Measures
from baselines.evaluation.report.numbers import Entry, measures_of, pool
from baselines.evaluation.runner import Run
from baselines.evaluation.score import OPTIMUM_POLICY, Score, paired, score, speed_range_of
from baselines.evaluation.suites import Suite

SUITES = ("benchmark-v2", "ood-v1", "unmodelled-v1", "deep-v1", "sealed-v1")
"""The suites of the results page."""
TOLERANCE = {"benchmark-v2": 2e-3, "ood-v1": 1e-2, "unmodelled-v1": 1e-2, "deep-v1": 1e-2, "sealed-v1": 1e-2}
"""Mean error [m] by which another policy may be better than the oracle in a case, by suite: where a current is
nearly as fast as the path, the oracle's plan through the water turns sharply, and a few episodes settle late."""
ROUNDING = 1e-5
"""[m] by which another policy may be better than the bound in a case: the tolerance to which that is solved."""


@dataclass(frozen=True)
class Results:
    """What is recorded of a suite."""

    suite: Suite
    runs: tuple[Run, ...]
    pooled: list[Entry]
    scores: dict[str, dict[str, Score]]  # of each policy in each case alone, by policy, by case
    steady_rmses: dict[str, dict[str, float]]  # [m] mean error of each policy in each case alone, by policy, by case

    @classmethod
    def of(cls, suite: Suite, runs: Sequence[Run]) -> Results:
        """Return the results of recorded runs, those of the suite's anchors among them."""
        cases, (zero, one) = measures_of(runs), suite.anchors
        scores: dict[str, dict[str, Score]] = {}
        steady_rmses: dict[str, dict[str, float]] = {}
        for run_ in runs:
            policy, name = run_.policy, run_.scenario.name
            three = paired(*(cases[name][key] for key in (zero, policy, one)))
            scores.setdefault(policy, {})[name] = score(*([m.steady_rmse] for m in three))
            steady_rmses.setdefault(policy, {})[name] = float(cases[name][policy].steady_rmse.mean())
        return cls(suite, tuple(runs), pool(runs, suite.anchors), scores, steady_rmses)

    @cached_property
    def cases(self) -> dict[str, dict[str, Measures]]:
        """What was measured in metres of the paper's vehicle, by scenario, then by policy."""
        return measures_of(self.runs)

    @property
    def policies(self) -> list[str]:
        """The policies, in the order of the registry."""
        return list(self.scores)

    def measures(self, policy: str, speed_range: str) -> list[Measures]:
        """Return what was measured of a policy in the cases of a speed range."""
        own = [
            run_ for run_ in self.runs if run_.policy == policy and speed_range_of(run_.scenario.name) == speed_range
        ]
        return [run_.measures for run_ in own if run_.measures is not None]


def better_than(best: str, results: Results) -> list[tuple[str, str, float]]:
    """Return case, policy and by how much [m] its mean error is smaller than that of `best`, wherever it is.

    The errors are those of the same episodes. That `OPTIMUM_POLICY` is better than another is no fault, and left out.
    """
    found = []
    for case, measures in results.cases.items():
        for policy in sorted(set(measures) - {best, OPTIMUM_POLICY}) if best in measures else ():
            own, its = paired(measures[policy], measures[best])
            if (gain := float((its.steady_rmse - own.steady_rmse).mean())) > 0:
                found.append((case, policy, gain))
    return found


def collected(name: str) -> tuple[Results | None, dict[str, str]]:
    """Return what is recorded of a suite, None without its anchors; and why rows of policies do not count."""
    suite = suites.load_suite(name)
    found = recorded.load_recorded(suite)
    complete = set(suite.anchors) <= {run_.policy for run_ in found.runs}
    return Results.of(suite, found.runs) if complete else None, found.refused


@cache
def results_of(name: str) -> Results | None:
    """Return what is recorded of a suite; None without its anchors."""
    return collected(name)[0]
