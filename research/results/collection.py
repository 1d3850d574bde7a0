"""The recorded results of the frozen suites."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

from auv_gym.physics.namespaces import Array
from baselines.evaluation.metrics import Measures
from baselines.evaluation.recorded import recorded_runs
from baselines.evaluation.report.numbers import Entry, measures_of, pool
from baselines.evaluation.runner import Run
from baselines.evaluation.score import EXPERT, OPTIMUM_POLICY, paired, speed_range_of
from baselines.evaluation.suites import Suite, SuiteError, load_suite

ROUNDING = 1e-5
"""Difference of mean errors [m] by which another policy may be better than the full-information optimum in a case: the
tolerance of the solver."""


@dataclass(frozen=True)
class Results:
    """The recorded results of a suite."""

    suite: Suite
    runs: tuple[Run, ...]

    @cached_property
    def pooled(self) -> list[Entry]:
        """Results by policy and speed range."""
        return pool(self.runs)

    @cached_property
    def cases(self) -> dict[str, dict[str, Measures]]:
        """Metrics by scenario and policy, in metres of the paper's vehicle."""
        return measures_of(self.runs)

    @property
    def policies(self) -> list[str]:
        """The policies, in the order of the registry."""
        return list(dict.fromkeys(run.policy for run in self.runs))

    def steady_rmses(self, policy: str, speed_range: str) -> dict[str, Array]:
        """Return the steady-state errors [m] of a policy by scenario of a speed range, shape (M,) each."""
        names = [name for name, case in self.cases.items() if speed_range_of(name) == speed_range and policy in case]
        return {name: self.cases[name][policy].steady_rmse for name in names}

    def better_than(self, best: str) -> list[tuple[str, str, float]]:
        """Return the policies with a smaller mean error than `best` in a case: case, policy, difference [m].

        Errors are compared in the same episodes. `OPTIMUM_POLICY` is left out.
        """
        rows = []
        for name, case in self.cases.items():
            for policy in sorted(set(case) - {best, OPTIMUM_POLICY}) if best in case else ():
                other, reference = paired(case[policy], case[best])
                if (gain := float((reference.steady_rmse - other.steady_rmse).mean())) > 0:
                    rows.append((name, policy, gain))
        return rows


@cache
def results_of(name: str) -> Results:
    """Return the recorded results of a suite.

    Raises:
        SuiteError: the results of the expert or the optimum are missing or outdated.
    """
    suite = load_suite(name)
    runs, notes = recorded_runs(suite)
    if missing := sorted({EXPERT, OPTIMUM_POLICY} - {run.policy for run in runs}):
        raise SuiteError(f"{name} has no valid results of {', '.join(missing)}: {'; '.join(notes) or 'record them'}")
    return Results(suite, runs)
