"""Score controllers and agents: `python evaluate.py --help`."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from baselines.tools.command_line import parse, run

PROGRAM = "evaluate.py"


@dataclass(frozen=True)
class Options:
    """Run policies through the same episodes; print the table, write report.html, results.json, results.csv and plots.

    The expert, backstepping, always runs too: it is the yardstick of effort and smoothness. Exit status: 0 done, 1 a
    policy failed or the results could not be written, 2 wrong usage.
    """

    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = ()
    """Policies by name, FILE.py:FACTORY or a FILE.zip of Stable-Baselines3, compared with the expert; without any, the
    expert alone."""
    suite: Annotated[str | None, arg(metavar="S", help_behavior_hint="")] = None
    """Frozen: "benchmark-v1" (the default), "benchmark-v1-validation", "ood-v1" or "unmodelled-v1"; other policies are
    shown as they were recorded. Drawn from the seed: "presets" (every preset), or "paper" (the paper's, with its
    numbers and figures recomputed)."""
    scenario: Annotated[tuple[str, ...], arg(metavar="S [S ...]", help_behavior_hint="")] = ()
    """Scenarios in place of a suite: names of presets, or .toml and .json files."""
    episodes: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Episodes of each policy in each scenario. Default: 20; in a frozen suite all of them."""
    seed: int = 0
    """Seed of the first episode that is drawn; episode i has seed + i, whatever the policy."""
    jobs: Annotated[int | None, arg(metavar="INT", help_behavior_hint="")] = None
    """Worker processes; the results are the same for any number. Default: 2, or 1 on a single processor."""
    cluster: Annotated[str | None, arg(metavar="ADDRESS", help_behavior_hint="")] = None
    """Run on a Ray cluster, in --jobs processes (default: all that it has): HOST:PORT of its head, "auto" for the one
    that this machine belongs to, "local" for one made for the occasion."""
    out: Path = Path("runs/evaluate")
    """Folder for the results."""
    step_limit: float = 0.1
    """Seconds that a policy may take for a decision, on average; a slower one fails."""
    stability: bool = False
    """Instead of running scenarios, examine where the policies are stable about steady motion in still water, and
    certify it for references that vary."""
    resume: bool = False
    """Use the finished runs that an interrupted evaluation has left in the folder; a policy whose file has changed
    since runs again."""


def main(arguments: Sequence[str]) -> int:
    """Evaluate as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options, command = parse(Options, arguments, PROGRAM), f"python {PROGRAM} {shlex.join(arguments)}".rstrip()
    from baselines.evaluation.command import evaluate
    from baselines.evaluation.request import Request, checked_folder, checked_policies
    from baselines.evaluation.score import EXPERT

    if options.stability:
        from baselines.evaluation.stability.report import report

        return report(checked_policies(options.policy or (EXPERT,)), checked_folder(options.out), command)
    request = Request.of(
        options.policy,
        options.suite,
        options.scenario,
        options.episodes,
        options.seed,
        options.jobs,
        options.out,
        options.step_limit,
        options.resume,
        options.cluster,
        command,
    )
    return evaluate(request)


if __name__ == "__main__":
    sys.exit(run(main, PROGRAM))
