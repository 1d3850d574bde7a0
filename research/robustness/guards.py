"""Failures and errors of agents with and without a guard in frozen suites: `python -m research guards`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from baselines.agents.names import GUARD
from baselines.evaluation.suites import load_suite
from baselines.tools.command_line import DONE, parse
from baselines.tools.files import read_json
from research import DATA
from research.robustness import faults

PROGRAM = "python -m research guards"
GUARDS_FILE = DATA / "guards.json"  # record of the results
SUITES = ("unmodelled-v1", "sealed-v2")
"""Suites in which agents fail."""


@dataclass(frozen=True)
class Options(faults.Options):
    """Run agents without and with a guard in frozen suites.

    Exit status: 0 done, 2 wrong usage.
    """

    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = ("helm", "apg-preview-cruise")
    """Names of agents."""
    episodes: int = 16
    """Largest number of episodes of each cell, the first ones."""
    out: Path = GUARDS_FILE
    """File to which the results are added."""


def main(arguments: Sequence[str]) -> int:
    """Run the agents, record the results, and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options = parse(Options, arguments, PROGRAM)
    cells = [cell for suite in SUITES for cell in load_suite(suite).cells]
    faults.record_runs([name + end for name in options.policy for end in ("", GUARD)], cells, options)
    return DONE


def compared() -> list[list[str]]:
    """Return a row of the page for each agent and suite: episodes, and failures and error without -> with a guard."""
    record = read_json(GUARDS_FILE)
    table = []
    for policy in (name for name in record if not name.endswith(GUARD)):
        for suite in SUITES:
            names = [cell.scenario.name for cell in load_suite(suite).cells]
            sides = [[record[p][name] for name in names if name in record[p]] for p in (policy, f"{policy}{GUARD}")]
            episodes = sum(row["episodes"] for row in sides[0])
            table.append([f"`{policy}`", suite, str(episodes), faults.both(sides)])
    return table
