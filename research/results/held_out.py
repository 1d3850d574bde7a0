"""Run policies on held-out episodes: `python -m research held-out --help`.

The episodes are drawn from the cases of the frozen suites with separate seeds, on which no policy was trained, tuned or
chosen. The rows are kept in `research/data/held_out/`. `make pages` compares the leads with those on the frozen
episodes.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from auv_gym.scenarios.presets import SPEED_RANGES
from baselines.evaluation import recorded, suites
from baselines.evaluation.runner import drawn, run_all
from baselines.evaluation.score import ADVERSE_RIVAL, EXPERT, FORESIGHTED, RIVAL
from baselines.evaluation.suites import Suite
from baselines.policies import list_policies
from baselines.tools.command_line import DONE, FAILED, UsageError, called, check_words, parse
from baselines.tools.files import versions
from baselines.tools.workers import Workers
from research import DATA
from research.seeds import HELD_OUT

PROGRAM = "python -m research held-out"
HELD_OUT_FOLDER = DATA / "held_out"
HELD_OUT_SEED = HELD_OUT.first  # seed of the first episode of each case
HELD_OUT_EPISODES = {"benchmark-v2": 64, "unmodelled-v1": 24}
"""Number of episodes of each case, by suite."""
_FAMILIES = ("apg", "apg-preview", "apg-adverse", "apg-scratch")
"""Families of agents, each with one agent for every speed range."""
_POLICIES = (
    EXPERT,
    *FORESIGHTED,
    "ekf",
    *(f"{family}-{speed_range}" for family in _FAMILIES for speed_range in SPEED_RANGES),
    "helm",
    "helm-any",
    ADVERSE_RIVAL,
    RIVAL,
)
"""Policies by default, the slowest ones last."""


@dataclass(frozen=True)
class Options:
    """Draw held-out episodes of the cases of frozen suites, run policies on them and keep the results.

    Exit status: 0 done, 1 a policy failed, 2 wrong usage.
    """

    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = _POLICIES
    """Names of policies."""
    suite: Annotated[tuple[str, ...], arg(metavar="S [S ...]", help_behavior_hint="")] = tuple(HELD_OUT_EPISODES)
    """Suites with the cases of the episodes."""
    case: Annotated[tuple[str, ...], arg(metavar="C [C ...]", help_behavior_hint="")] = ()
    """Names of cases, for a short run. Default: all."""
    episodes: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Episodes of each case. Default: 64 of benchmark-v2, 24 of unmodelled-v1."""
    jobs: int = 1
    """Worker processes. With one process the time of a decision is that of an idle processor."""
    out: Path = HELD_OUT_FOLDER
    """Folder for the results, SUITE/POLICY.npz."""


def held_out(name: str, episodes: int | None = None, cases: Sequence[str] = ()) -> Suite:
    """Return a suite of held-out episodes, drawn from some or all cases of a frozen suite.

    Args:
        name: name of the frozen suite.
        episodes: number of episodes of each case. None: `HELD_OUT_EPISODES`.
        cases: names of cases. Empty: all.

    Raises:
        ValueError: there is no such suite, or no such case in it.
    """
    frozen = suites.load_suite(name)
    known = [cell.scenario.name for cell in frozen.cells]
    if unknown := [case for case in cases if case not in known]:
        raise ValueError(f"{unknown[0]!r} is no case of {name}; allowed are {', '.join(known)}")
    count = episodes or HELD_OUT_EPISODES[name]
    chosen = [cell.scenario for cell in frozen.cells if cell.scenario.name in (cases or known)]
    names = " ".join(scenario.name for scenario in chosen)
    digest = hashlib.sha256(f"{frozen.source[1]} {HELD_OUT_SEED} {count} {names}".encode()).hexdigest()
    cells = tuple(drawn(scenario, count, HELD_OUT_SEED) for scenario in chosen)
    return Suite(name, digest, cells, (), frozen.anchors, (frozen.source[0], digest))


def main(arguments: Sequence[str]) -> int:
    """Run policies, keep their results, and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options = parse(Options, arguments, PROGRAM)
    check_words("policy", options.policy, list_policies())
    check_words("suite", options.suite, HELD_OUT_EPISODES)
    if options.episodes is not None and options.episodes < 1:
        raise UsageError(f"--episodes is {options.episodes}; it must be 1 or more")
    try:
        chosen = [held_out(name, options.episodes, options.case) for name in options.suite]
    except ValueError as error:
        raise UsageError(f"--case: {error}") from error
    done = [_record(suite, policy, options) for policy in options.policy for suite in chosen]
    return DONE if all(done) else FAILED


def _record(suite: Suite, policy: str, options: Options) -> bool:
    """Run a policy in the cells of its speed ranges, keep the rows, and return whether it succeeded."""
    speed_ranges = recorded.speed_ranges_of(policy)
    cells = suite.cells_in(speed_ranges)
    if not cells:
        return True
    runs = run_all((policy,), cells, Workers(options.jobs))
    try:
        recorded.save_recorded(suite, runs, versions(), options.out, speed_ranges)
    except ValueError as error:
        print(f"{called(PROGRAM)}: {error}: {next(run.error for run in runs if run.error)}", file=sys.stderr)
        return False
    print(f"{suite.name}: {policy}, {sum(len(cell.episodes) for cell in cells)} episodes", flush=True)
    return True
