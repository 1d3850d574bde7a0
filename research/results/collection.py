"""The recorded results of the frozen suites: scores and errors of every policy, pooled and by case."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

from baselines.evaluation import recorded, suites
from baselines.evaluation.metrics import Measures
from baselines.evaluation.report.numbers import Entry, measures_of, pool
from baselines.evaluation.runner import Run
from baselines.evaluation.score import OPTIMUM_POLICY, Score, paired, score, speed_range_of
from baselines.evaluation.suites import Suite, SuiteError

ROUNDING = 1e-5
"""Difference of mean errors [m] by which another policy may be better than the full-information optimum in a case: the
tolerance of the solver."""


@dataclass(frozen=True)
class Results:
    """The recorded results of a suite."""

    suite: Suite
    runs: tuple[Run, ...]
    pooled: list[Entry]
    scores: dict[str, dict[str, Score]]  # by policy and case
    steady_rmses: dict[str, dict[str, float]]  # [m] mean error by policy and case

    @classmethod
    def of(cls, suite: Suite, runs: Sequence[Run]) -> Results:
        """Return the results of recorded runs, which must include those of the suite's anchors."""
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
        """Measures by scenario and policy, in metres of the paper's vehicle."""
        return measures_of(self.runs)

    @property
    def policies(self) -> list[str]:
        """The policies, in the order of the registry."""
        return list(self.scores)

    def runs_of(self, policy: str, speed_range: str) -> list[Run]:
        """Return the runs of a policy in the cases of a speed range."""
        return [r for r in self.runs if r.policy == policy and speed_range_of(r.scenario.name) == speed_range]

    def measures(self, policy: str, speed_range: str) -> list[Measures]:
        """Return the measures of a policy in each case of a speed range."""
        return [r.measures for r in self.runs_of(policy, speed_range) if r.measures is not None]


def better_than(best: str, results: Results) -> list[tuple[str, str, float]]:
    """Return the policies with a smaller mean error than `best` in a case: case, policy, difference [m].

    Errors are compared in the same episodes. `OPTIMUM_POLICY` is left out.
    """
    found = []
    for case, measures in results.cases.items():
        for policy in sorted(set(measures) - {best, OPTIMUM_POLICY}) if best in measures else ():
            own, its = paired(measures[policy], measures[best])
            if (gain := float((its.steady_rmse - own.steady_rmse).mean())) > 0:
                found.append((case, policy, gain))
    return found


@cache
def results_of(name: str) -> Results:
    """Return the recorded results of a suite.

    Raises:
        SuiteError: the rows of its anchors are missing, or of other code than the present one.
    """
    suite = suites.load_suite(name)
    found = recorded.load_recorded(suite)
    if missing := sorted({*suite.anchors} - {run.policy for run in found.runs}):
        reasons = "; ".join(found.refused.get(policy, f"{policy} is not recorded") for policy in missing)
        raise SuiteError(f"{name} has no valid rows of {', '.join(missing)}: {reasons}")
    return Results.of(suite, found.runs)
