"""Build, check and record the frozen suites: `python -m baselines.evaluation.suites --help`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from baselines import list_policies
from baselines.evaluation import recorded, suites
from baselines.evaluation.progress import progress
from baselines.evaluation.report.numbers import versions
from baselines.evaluation.runner import STEP_LIMIT, Cell, runs
from baselines.evaluation.score import regime_of
from baselines.evaluation.suites.builder import SUITES, build
from baselines.tools.command_line import DONE, FAILED, UsageError, parse, run
from baselines.tools.workers import Workers

PROGRAM = "python -m baselines.evaluation.suites"


@dataclass(frozen=True)
class Options:
    """Build a frozen suite, check that its episodes still generate what they did, or record what policies do in it.

    Exit status: 0 done, 1 the suite is damaged, its episodes differ or a policy failed, 2 wrong usage.
    """

    action: Annotated[Positional[Literal["build", "check", "record"]], arg(metavar="build|check|record")]
    """Build replaces the file and its hash; check compares every episode; record keeps the policies' results."""
    name: Annotated[Positional[str], arg(metavar="NAME")]
    """The suite."""
    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = ()
    """Policies to record; without any, all that have a name."""
    episodes: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Record the first episodes of each cell only, for a policy that is too slow for all."""
    step_limit: float = STEP_LIMIT
    """Seconds that a policy may take for a decision, on average; a slower one fails."""
    jobs: int = 1
    """Worker processes. With one the time per decision is that of an idle processor."""


def main(arguments: Sequence[str]) -> int:
    """Build or check as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    if options.name not in SUITES:
        raise UsageError(f"unknown suite {options.name!r}; allowed are {', '.join(SUITES)}")
    if options.action == "build":
        print(f"{suites.save(options.name, build(options.name))}  {options.name}")
        return DONE
    try:
        suite = suites.load(options.name)
        if options.action == "record":
            return _record(suite, options)
        for cell, recorded in zip(suite.cells, suite.digests, strict=True):
            suites.check_cell(cell, recorded)
    except suites.SuiteError as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        return FAILED
    episodes = sum(len(cell.episodes) for cell in suite.cells)
    print(f"{suite.hash}  {suite.name}: {len(suite.cells)} cells, {episodes} episodes, all as they were")
    return DONE


def _record(suite: suites.Suite, options: Options) -> int:
    """Record policy by policy, so that an interruption costs one of them."""
    policies = options.policy or tuple(list_policies())
    if unknown := [policy for policy in policies if policy not in list_policies()]:
        raise UsageError(f"{unknown[0]!r} is not the name of a policy; allowed are {', '.join(list_policies())}")
    if options.episodes is not None and options.episodes < 1:
        raise UsageError(f"--episodes is {options.episodes}; it must be 1 or more")
    cells = tuple(Cell(cell.scenario, cell.episodes[: options.episodes]) for cell in suite.cells)
    failed = False
    for policy in policies:
        regimes = recorded.regimes_of(policy)
        own = [cell for cell in cells if regime_of(cell.scenario.name) in regimes]
        steps = sum(len(cell.episodes) * cell.scenario.steps for cell in own)
        with progress(len(own), steps) as report:
            found = []
            for result in runs((policy,), own, Workers(options.jobs), options.step_limit, report.board.note):
                report.run(result)
                found.append(result)
        try:
            recorded.save(suite, found, versions(), regimes=regimes)
        except ValueError as error:
            reasons = dict.fromkeys(run.error for run in found if run.error)
            print(f"{PROGRAM}: {error}: {'; '.join(map(str, reasons))}", file=sys.stderr)
            failed = True
    return FAILED if failed else DONE


if __name__ == "__main__":
    sys.exit(run(main, PROGRAM))
