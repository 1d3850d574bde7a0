"""Run predictive control with gains searched for the error alone: `python -m research error-only`.

The gains are the result of `auv-gym tune nmpc --speed-range cruise --error-only`, repeated from its own result until it
gained nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from baselines.evaluation.metrics import Measures
from baselines.evaluation.report.terminal import run_and_show
from baselines.evaluation.score import capped, error_cap, relative_error
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
    results, own = results_of(SUITE), {cell: agents[0] for cell, agents in trained(SUITE)[NAME].measures.items()}

    def ratios(rival: Mapping[str, Measures], mine: Mapping[str, Measures]) -> tuple[str, str, str]:
        pairs = {cell: [capped(m[cell], error_cap(cell)) for m in (rival, mine)] for cell in own}
        rates = [np.mean(np.concatenate([m[cell].smoothness for cell in own])) for m in (rival, mine)]
        errors = (relative_error(*zip(*(pairs[cell] for cell in cells), strict=True)) for cells in (own, [STORM]))
        every, storm = map(with_interval, errors)
        return every, storm, f"{rates[1] / rates[0]:.2g}"

    nmpc, agent = ({cell: results.cases[cell][policy] for cell in own} for policy in ("nmpc", MAIN_AGENT))
    return {"to_priced": ratios(nmpc, own), "agent_to": ratios(own, agent)}
