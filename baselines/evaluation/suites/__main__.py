"""Build, check and record the frozen suites: `python -m baselines.evaluation.suites --help`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from baselines.command_line import DONE, FAILED, UsageError, parse, run
from baselines.evaluation import recorded, suites
from baselines.evaluation.report import versions
from baselines.evaluation.runner import run_all
from baselines.evaluation.suites.builder import SUITES, build

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
    """Policies to record."""
    jobs: int = 2
    """Worker processes."""


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
            return _record(suite, options.policy, options.jobs)
        for cell, recorded in zip(suite.cells, suite.digests, strict=True):
            suites.check_cell(cell, recorded)
    except suites.SuiteError as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        return FAILED
    episodes = sum(len(cell.episodes) for cell in suite.cells)
    print(f"{suite.hash}  {suite.name}: {len(suite.cells)} cells, {episodes} episodes, all as they were")
    return DONE


def _record(suite: suites.Suite, policies: Sequence[str], jobs: int) -> int:
    if not policies:
        raise UsageError("--policy is missing; name the policies to record")
    runs = run_all(policies, suite.cells, jobs, lambda run: print(run.policy, run.scenario.name, flush=True))
    try:
        recorded.save(suite, runs, versions())
    except ValueError as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        return FAILED
    return DONE


if __name__ == "__main__":
    sys.exit(run(main, PROGRAM))
