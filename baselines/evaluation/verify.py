"""Check a file of results, and run a share of its episodes again: `auv-gym verify --help`."""

from __future__ import annotations

import math
import secrets
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from tyro.conf import Positional, arg

from baselines.evaluation.cells import Cell
from baselines.evaluation.metrics import Measures
from baselines.evaluation.report.numbers import pool
from baselines.evaluation.report.terminal import console, entries_table, run_and_show
from baselines.evaluation.request import checked_policies
from baselines.evaluation.results import ResultFile
from baselines.evaluation.runner import STEP_LIMIT, Run
from baselines.evaluation.score import EXPERT, OPTIMUM_POLICY
from baselines.evaluation.suites import Suite, list_suites, load_suite
from baselines.tools.command_line import DONE, FAILED, UsageError, called, parse
from baselines.tools.workers import DEFAULT_JOBS, Workers

PROGRAM = "auv-gym verify"
TOLERANCES = {"steady_rmse": 1e-5, "effort": 1e-5, "smoothness": 1e-5, "failed": 0.0}
"""Metrics that are compared, with their absolute tolerances; that of `steady_rmse` is in m."""
LIMITS = {"steady_rmse": 1e6, "effort": 1.0, "smoothness": 4.0}
"""Largest possible values of metrics."""
_RELATIVE = 1e-3
"""Relative tolerance of a metric, since its last digits depend on the machine."""
_SHOWN = 5
"""Largest number of differences that are printed."""


@dataclass(frozen=True)
class Options:
    """Check the results of policies in a frozen suite and print their scores; with POLICY, run a share of them again.

    Exit status: 0 done, 1 the file is damaged or implausible or its results are not repeated, 2 wrong usage.

    Example: auv-gym verify runs/evaluate/results.npz helm
    """

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """The file results.npz of an evaluation."""
    policy: Annotated[Positional[str], arg(metavar="[POLICY]")] = ""
    """The policy, as for evaluate --policy; it may have another path now. Without a policy, no episode runs."""
    share: float = 0.05
    """Share of the episodes of each case that is run again, in (0, 1]."""
    seed: int | None = None
    """Seed of the choice of episodes. Default: a random one, which is printed."""
    step_limit: float = STEP_LIMIT
    """Largest mean time of a policy for one action, in seconds; a slower policy fails."""
    jobs: int = DEFAULT_JOBS
    """Number of worker processes."""


def main(arguments: Sequence[str]) -> int:
    """Verify a file of results and return the exit status."""
    options = parse(Options, arguments, PROGRAM)
    if not 0 < options.share <= 1:
        raise UsageError(f"--share is {options.share}; it must be above 0 and at most 1")
    if options.jobs < 1 or not options.step_limit > 0 or (options.seed or 0) < 0:
        raise UsageError("--jobs and --step-limit must be positive, and --seed must not be negative")
    try:
        suite, runs = checked_results(options.file)
        out, episodes = console(), sum(len(run.measures or ()) for run in runs)
        print(f"{options.file}: {episodes} episodes of {suite.name}, plausible")
        out.print(entries_table("Results in the file", "speed range", pool(runs), out))
        return _repeated(suite, runs, options) if options.policy else DONE
    except OSError as error:
        raise UsageError(f"cannot read {options.file}: {error.strerror}") from error
    except ValueError as error:
        print(f"{called(PROGRAM)}: {error}", file=sys.stderr)
        return FAILED


def checked_results(file: Path) -> tuple[Suite, list[Run]]:
    """Return the suite and the runs of a file of results after a check that its numbers are possible.

    Raises:
        OSError: it cannot be read.
        ValueError: it is damaged, its suite does not exist, or numbers contradict each other.
    """
    content = ResultFile.read(file)
    if content.suite not in list_suites():
        raise ValueError(f"{file} has no frozen suite; results of {', '.join(list_suites())} can be verified")
    suite = load_suite(content.suite)
    cells = {cell.scenario.name: cell for cell in suite.cells}
    for run in content.runs:
        m, cell, where = run.measures, cells.get(run.scenario.name), f"{run.policy} in {run.scenario.name}"
        if m is None or cell is None or run.cell_hash != cell.hash or len(m) != len(cell.episodes):
            raise ValueError(f"{where}: its episodes are not those of {suite.name}; all of a case must be run")
        if reason := _implausible(m, cell):
            raise ValueError(f"{where}: {reason}")
    return suite, list(content.runs)


def _implausible(m: Measures, cell: Cell) -> str:
    """Return the reason why metrics are impossible or contradict each other; "" if there is none."""
    for name, largest in LIMITS.items():
        values = getattr(m, name)
        if not ((values >= 0) & (values <= largest)).all():
            return f"{name} is not within [0, {largest:g}] everywhere"
    if (~m.failed & (m.steady_rmse > cell.scenario.lost_distance * (1 + 1e-6))).any():
        return "an episode beyond the lost distance is not counted as failed"
    # For N commands a, the sum of the N - 1 squared changes is at most 4 times the sum of a^2.
    steps = cell.scenario.steps
    share = np.where(m.failed, 2.0, steps / max(steps - 1, 1))
    if (m.smoothness > 4 * share * m.effort * (1 + 1e-5) + 1e-9).any():
        return "the command rate is too large for the effort"
    return ""


def _repeated(suite: Suite, runs: Sequence[Run], options: Options) -> int:
    """Run a share of the episodes of a policy again, print what differs and return the exit status."""
    checked_policies([options.policy])
    names = list(dict.fromkeys(run.policy for run in runs))
    others = [options.policy] if options.policy in names else [n for n in names if n not in (EXPERT, OPTIMUM_POLICY)]
    if len(others) != 1:  # a single other policy may have another path now
        raise UsageError(f"{options.file} has no results of {options.policy!r}, but of {', '.join(names)}")
    (name,) = others
    seed = secrets.randbelow(2**32) if options.seed is None else options.seed
    rng, cells = np.random.default_rng(seed), {cell.scenario.name: cell for cell in suite.cells}
    before, some = {run.scenario.name: run for run in runs if run.policy == name}, {}
    for scenario in before:  # a random share of the episodes of each case, at least one
        n = len(cells[scenario].episodes)
        some[scenario] = np.sort(rng.permutation(n)[: max(1, math.ceil(options.share * n - 1e-9))]).tolist()
    count = sum(map(len, some.values()))
    print(f"Running {count} episodes of {name} again, chosen by --seed {seed}", flush=True)
    parts = [Cell(cells[s].scenario, tuple(cells[s].episodes[i] for i in chosen)) for s, chosen in some.items()]
    again = run_and_show([(options.policy, part) for part in parts], Workers(options.jobs), options.step_limit)
    lines = [line for run in again for line in _differences(before[run.scenario.name], run, some[run.scenario.name])]
    if lines:
        print("\n".join((f"NOT REPEATED: {len(lines)} numbers differ", *lines[:_SHOWN])))
        return FAILED
    detectable = 1 - 0.05 ** (1 / count)  # share of forged episodes of which such a sample has one with 95 %
    print(
        f"Repeated: all {len(TOLERANCES) * count} numbers, to {100 * _RELATIVE:g} % of each. If "
        f"{100 * detectable:.1f} % of the episodes were forged, this would have found one with 95 % probability. The "
        "numbers of the other policies, times and texts in the file were not checked."
    )
    return DONE


def _differences(before: Run, again: Run, episodes: Sequence[int]) -> list[str]:
    """Return a line for each number that is not repeated."""
    if again.measures is None:
        raise ValueError(f"{again.policy} fails in {again.scenario.name}: {again.error}")
    lines = []
    for name, absolute in TOLERANCES.items():
        values = getattr(before.measures, name)[episodes].tolist(), getattr(again.measures, name).tolist()
        for i, old, new in zip(episodes, *values, strict=True):
            if not abs(new - old) <= absolute + _RELATIVE * abs(old) * (name != "failed"):
                where = f"episode {i} of {before.scenario.name}"
                lines.append(f"  {where}: {name} {old:.6g} in the file, {new:.6g} now")
    return lines
