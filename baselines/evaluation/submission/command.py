"""Verify a submission: `auv-gym submit --help`."""

from __future__ import annotations

import secrets
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from baselines.evaluation.progress import run_and_show
from baselines.evaluation.report.terminal import console, entries_table
from baselines.evaluation.request import checked_policies
from baselines.evaluation.runner import STEP_LIMIT
from baselines.evaluation.submission.files import SUBMITTED, Submission, read_submission
from baselines.evaluation.submission.reproduction import (
    RELATIVE,
    REPRODUCED_SHARE,
    ChosenEpisodes,
    chosen,
    chosen_cells,
    detectable_share,
    mismatches,
)
from baselines.evaluation.submission.scores import anchor_errors, entries
from baselines.tools.command_line import DONE, FAILED, UsageError, called, parse
from baselines.tools.workers import DEFAULT_JOBS, Workers

PROGRAM = "auv-gym submit"
_SHOWN = 5
"""Largest number of mismatches that are printed."""
MOST_SEED = 2**32  # upper limit of the seeds that choose the episodes


@dataclass(frozen=True)
class Options:
    """Check a submission and print its scores; with POLICY, run a share of its episodes again.

    Exit status: 0 done, 1 the file is damaged or inconsistent or its results are not reproduced, 2 wrong usage.
    """

    file: Annotated[Positional[Path], arg(metavar="FILE")]
    """The submission, NAME.npz."""
    policy: Annotated[Positional[str], arg(metavar="[POLICY]")] = ""
    """The policy, as for evaluate.py --policy. Without a policy, no episode runs."""
    share: float = REPRODUCED_SHARE
    """Share of the episodes of each case that is run again, in (0, 1]."""
    seed: int | None = None
    """Seed of the choice of episodes. Default: a random one, which is printed."""
    step_limit: float = STEP_LIMIT
    """Largest mean time of a policy for one action, in seconds; a slower policy fails."""
    jobs: int = DEFAULT_JOBS
    """Number of worker processes."""


def main(arguments: Sequence[str]) -> int:
    """Verify a submission and return the exit status.

    Raises:
        UsageError: the arguments are wrong.
    """
    options = parse(Options, arguments, PROGRAM)
    check_numbers(options.share, options.seed, options.step_limit, options.jobs)
    try:
        submission = read_file(options.file)
        print(
            f"{options.file}: {submission.name}, {submission.episodes} episodes of {submission.suite.name}, consistent"
        )
        out = console()
        out.print(entries_table("Scores", "speed range", entries([submission], anchor_errors(submission.suite)), out))
        if not options.policy:
            return DONE
        episodes, _ = episodes_to_run(submission, options.share, options.seed)
        return reproduce(submission, options.policy, episodes, options.jobs, options.step_limit)
    except ValueError as error:
        print(f"{called(PROGRAM)}: {error}", file=sys.stderr)
        return FAILED


def check_numbers(share: float, seed: int | None, step_limit: float, jobs: int) -> None:
    """Raise UsageError if a number is out of range."""
    if not 0 < share <= 1:
        raise UsageError(f"--share is {share}; it must be above 0 and at most 1")
    if seed is not None and not 0 <= seed < MOST_SEED:
        raise UsageError(f"--seed is {seed}; it must be 0 or more and below {MOST_SEED}")
    if jobs < 1 or not step_limit > 0:
        raise UsageError("--jobs and --step-limit must be positive")


def read_file(file: Path) -> Submission:
    """Return the submission of a file.

    Raises:
        UsageError: there is no such file.
        ValueError: it is no submission, or inconsistent.
    """
    try:
        return read_submission(file)
    except OSError as error:
        raise UsageError(f"cannot read {file}: {error.strerror}") from error


def episodes_to_run(submission: Submission, share: float, seed: int | None) -> tuple[ChosenEpisodes, int]:
    """Return the episodes to run again and the seed of their choice, and print the seed."""
    seed = secrets.randbelow(MOST_SEED) if seed is None else seed
    episodes = chosen(submission, share, seed)
    count = sum(map(len, episodes.values()))
    print(f"Running {count} of {submission.episodes} episodes again, chosen by --seed {seed}", flush=True)
    return episodes, seed


def reproduce(submission: Submission, policy: str, episodes: ChosenEpisodes, jobs: int, step_limit: float) -> int:
    """Run a share of the episodes again, print what differs and return the exit status."""
    checked_policies([policy])
    pairs = [(policy, cell) for cell in chosen_cells(submission, episodes)]
    again = run_and_show(pairs, Workers(jobs), step_limit)
    if again[0].fingerprint != submission.fingerprint:
        print(f"note: {policy} is not the submitted policy: its fingerprint differs", file=sys.stderr)
    count, found = sum(map(len, episodes.values())), mismatches(submission, episodes, again)
    if found:
        wrong = len({(m.scenario, m.episode) for m in found})
        print(f"NOT REPRODUCED: {wrong} of {count} episodes differ")
        for mismatch in found[:_SHOWN]:
            print(f"  {mismatch}")
        return FAILED
    print(f"Reproduced: all {len(SUBMITTED) * count} numbers, to {100 * RELATIVE:g} % of each.")
    share = 100 * detectable_share(count)
    print(f"If {share:.1f} % of the episodes had been forged, this test would have found it with 95 % probability.")
    return DONE
