"""Run predictive control with gains searched for the error alone: `python -m research error-only`.

The gains are the result of `auv-gym tune nmpc --speed-range cruise --error-only`, repeated from its own result until it
gained nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from baselines.evaluation.report.terminal import run_and_show
from baselines.evaluation.score import RIVAL, relative_error
from baselines.evaluation.suites import load_suite
from baselines.tools.command_line import DONE
from baselines.tools.workers import DEFAULT_JOBS, Workers
from research import DATA
from research.pages import with_interval
from research.results.collection import MAIN_AGENT, results_of
from research.trainings.seed_runs import keep_seed_runs, trained

NAME, SUITE, RANGE = "nmpc-error-only", "benchmark-v3", "cruise"
STORM = f"{RANGE}-storm"
GAINS = DATA / f"{NAME}.json"


def main(_: Sequence[str]) -> int:
    """Run the controller on the suite, record the results and return the exit status."""
    suite = load_suite(SUITE)
    runs = run_and_show([(str(GAINS), cell) for cell in suite.cells_in((RANGE,))], Workers(DEFAULT_JOBS))
    keep_seed_runs(suite, NAME, [runs], "python -m research error-only")
    return DONE


def context() -> dict[str, Any]:
    """Return errors and command rates over those of the other gains, and those of the agent over them.

    Each is a ratio with its interval as text: of the errors in all cells, of those in storms, of the command rates.
    """
    results, own = results_of(SUITE), trained(SUITE)[NAME]
    errors = {p: results.errors(p, RANGE) for p in (RIVAL, MAIN_AGENT)}
    errors[NAME] = {cell: seeds[0] for cell, seeds in own.capped.items()}
    rates = {p: float(np.mean([results.cases[c][p].smoothness for c in own.capped])) for p in (RIVAL, MAIN_AGENT)}
    rates[NAME] = own.smoothness

    def ratios(rival: str, mine: str) -> tuple[str, str, str]:
        every, storm = (
            with_interval(relative_error(*([errors[policy][cell] for cell in cells] for policy in (rival, mine))))
            for cells in (own.capped, [STORM])
        )
        return every, storm, f"{rates[mine] / rates[rival]:.2g}"

    return {"to_priced": ratios(RIVAL, NAME), "agent_to": ratios(NAME, MAIN_AGENT)}
