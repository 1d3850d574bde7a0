"""The recorded results of the frozen suites, and the comparison with the best controller of each cell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property

from auv_gym.physics.namespaces import Array
from baselines.evaluation.metrics import Measures
from baselines.evaluation.recorded import recorded_runs
from baselines.evaluation.report.numbers import Entry, measures_of, pool
from baselines.evaluation.runner import Run
from baselines.evaluation.score import (
    EXPERT,
    OPTIMUM_POLICY,
    Score,
    capped,
    error_cap,
    paired,
    relative_error,
    speed_range_of,
)
from baselines.evaluation.suites import Suite, SuiteError, load_suite
from baselines.space import SPACE_POLICIES, SPEED_RANGE

MAIN_AGENT, SPACE_AGENT = "helm", "helm-3d"
"""The agents that the pages compare with `CONTROLLERS`, in the plane and in space."""
CONTROLLERS = ("nmpc", "nmpc-adverse", "ekf", "los-pid", "lqi")
"""Tuned controllers; an error is compared with that of the best of them in each cell."""
ROUNDING = 1e-5
"""Difference of mean errors [m] by which another policy may be better than the full-information optimum in a case: the
tolerance of the solver."""


@dataclass(frozen=True)
class Results:
    """The recorded results of a suite."""

    suite: Suite
    runs: tuple[Run, ...]

    @property
    def speed_ranges(self) -> list[str]:
        """The speed ranges of its cells; "space" is one."""
        found = (speed_range_of(cell.scenario.name) for cell in self.suite.cells)
        return [name for name in dict.fromkeys(found) if name]

    @property
    def agent(self) -> str:
        """The agent that is compared with the controllers."""
        return SPACE_AGENT if self.speed_ranges == [SPEED_RANGE] else MAIN_AGENT

    @property
    def controllers(self) -> list[str]:
        """Those of `CONTROLLERS` that have run."""
        return [name for name in CONTROLLERS if name in self.policies]

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

    def errors(self, policy: str, speed_range: str = "") -> dict[str, Array]:
        """Return the steady-state errors [m] of a policy by cell, failed episodes with the error cap, (M,) each.

        Args:
            policy: its name; * stands for the speed range.
            speed_range: of the cells; "" for all.
        """
        named = {cell: policy.replace("*", cell.partition("-")[0]) for cell in self.cases}
        return {
            cell: capped(case[named[cell]], error_cap(cell))
            for cell, case in self.cases.items()
            if cell.startswith(speed_range) and named[cell] in case
        }

    @cached_property
    def best(self) -> dict[str, str]:
        """The controller with the smallest mean error, by cell."""
        every = {policy: self.errors(policy) for policy in self.controllers}
        return {cell: min(every, key=lambda policy: every[policy][cell].mean()) for cell in self.cases}

    def to_best(self, errors: Mapping[str, Array]) -> Score:
        """Return the geometric mean over cells of the ratio of mean errors to those of the best controller.

        Args:
            errors: as `errors` returns them, or of agents from S training seeds, shape (S, M) for each cell.
        """
        rivals = (capped(self.cases[cell][self.best[cell]], error_cap(cell)) for cell in errors)
        pairs = [(theirs[: own.shape[-1]], own) for theirs, own in zip(rivals, errors.values(), strict=True)]
        return relative_error(*map(list, zip(*pairs, strict=True)))

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
        SuiteError: results of the expert, of a controller or of the agent are missing or outdated.
    """
    suite = load_suite(name)
    runs, notes = recorded_runs(suite)
    results = Results(suite, runs)
    in_space = results.agent == SPACE_AGENT
    controllers = [p for p in CONTROLLERS if not in_space or p in SPACE_POLICIES]
    if missing := sorted({EXPERT, results.agent, *controllers} - set(results.policies)):
        raise SuiteError(f"{name} has no valid results of {', '.join(missing)}: {'; '.join(notes) or 'record them'}")
    return results
