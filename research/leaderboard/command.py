"""Verify a submission, enter it, write the page of the leaderboard: `python -m research leaderboard --help`."""

from __future__ import annotations

import secrets
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from tyro.conf import Positional, arg

from baselines.evaluation.progress import progress
from baselines.evaluation.report.terminal import console, entries_table
from baselines.evaluation.request import checked_folder, checked_policies
from baselines.evaluation.runner import STEP_LIMIT, Run, runs
from baselines.evaluation.submission.files import MEASURED, Submission, read
from baselines.evaluation.submission.making import own_files, own_submission
from baselines.evaluation.submission.reproduction import (
    RELATIVE,
    SHARE,
    Chosen,
    cells_of,
    chosen,
    mismatches,
    smallest_caught,
)
from baselines.tools.command_line import DONE, FAILED, UsageError, called, parse
from baselines.tools.files import write_atomically
from baselines.tools.workers import DEFAULT_JOBS, Workers
from research.leaderboard.board import boards, enter, place_of, stamp
from research.leaderboard.page import leaderboard_json, page
from research.leaderboard.scores import entries, yardsticks

T = TypeVar("T")

PROGRAM = "python -m research leaderboard"
PAGE = "leaderboard.md"  # file of the page
TABLE = "leaderboard.json"  # file of its numbers
TOLD = 5
"""Most numbers that are named where an entry is not reproduced."""
MOST_SEED = 2**32  # of the seeds that are drawn, and that may be given


@dataclass(frozen=True)
class Options:
    """Check what somebody has submitted, run it again, and keep the leaderboard.

    Exit status: 0 done, 1 the file is damaged, contradicts itself or is not reproduced, 2 wrong usage.
    """

    action: Annotated[Positional[Literal["verify", "enter", "page", "own"]], arg(metavar="ACTION")]
    """verify FILE [POLICY]: check a submission and show its scores; with the policy run a random share of its episodes
    again. enter FILE: check a submission and put it on the leaderboard. page: write the leaderboard's page. own: make
    the project's own submissions from its recorded rows, verify them, and write the page."""
    words: Annotated[Positional[tuple[str, ...]], arg(metavar="[FILE [POLICY]]")] = ()
    """The submission, and the policy as evaluate.py --policy takes it."""
    share: float = SHARE
    """Share of each case's episodes that is run again, from above 0 to 1."""
    seed: int | None = None
    """Seed that chooses them. Default: one that nobody knew before; it is shown."""
    stamp: bool = False
    """Write down that an entry of the leaderboard was reproduced, and write the page."""
    replace: bool = False
    """Enter in place of an entry of the same name."""
    folder: Path = Path("leaderboard")
    """Folder of the leaderboard, SUITE/NAME.npz."""
    out: Path = Path("docs")
    """Folder for its page, leaderboard.md and leaderboard.json."""
    step_limit: float = STEP_LIMIT
    """Seconds that a policy may take for a decision, on average; a slower one fails."""
    jobs: int = DEFAULT_JOBS
    """Worker processes."""


def main(arguments: Sequence[str]) -> int:
    """Do as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    least, most = {"verify": (1, 2), "enter": (1, 1), "page": (0, 0), "own": (0, 0)}[options.action]
    if not least <= len(options.words) <= most:
        wants = {"verify": "FILE [POLICY]", "enter": "FILE"}.get(options.action, "no file")
        raise UsageError(f"{options.action} takes {wants}; given are {len(options.words)} words")
    if not 0 < options.share <= 1:
        raise UsageError(f"--share is {options.share}; it must be above 0 and at most 1")
    if options.seed is not None and not 0 <= options.seed < MOST_SEED:
        raise UsageError(f"--seed is {options.seed}; it must be 0 or more and below {MOST_SEED}")
    if options.jobs < 1 or not options.step_limit > 0:
        raise UsageError("--jobs and --step-limit must be positive")
    if options.stamp and len(options.words) < 2:
        raise UsageError("--stamp is for verify FILE POLICY: only what ran again is reproduced")
    actions = {"verify": _verify, "enter": _enter, "page": _page, "own": _own}
    try:
        return actions[options.action](options)
    except ValueError as error:
        print(f"{called(PROGRAM)}: {error}", file=sys.stderr)
        return FAILED


def _read(options: Options) -> Submission:
    """Return the submission that is named; a file that is not there is wrong usage, a wrong one is not."""
    file = options.words[0]
    try:
        return read(Path(file))
    except OSError as error:
        raise UsageError(f"cannot read {file}: {error.strerror}") from error


def _verify(options: Options) -> int:
    submission = _read(options)
    print(
        f"{options.words[0]}: {submission.name}, {submission.episodes} episodes of {submission.suite.name}, consistent"
    )
    found = entries([submission], yardsticks(submission.suite))
    out = console()
    out.print(entries_table("What it comes to", "regime", found, out))
    if len(options.words) < 2:
        return DONE
    episodes, seed = _chosen(submission, options)
    status = _reproduce(submission, options.words[1], episodes, options)
    if status == DONE and options.stamp:
        count = sum(map(len, episodes.values()))
        stamp(Path(options.words[0]), options.folder, count, submission.episodes, seed)
        return _page(options)
    return status


def _chosen(submission: Submission, options: Options) -> tuple[Chosen, int]:
    """Return the episodes to run again, and the seed that chose them, which is told."""
    seed = secrets.randbelow(MOST_SEED) if options.seed is None else options.seed
    episodes = chosen(submission, options.share, seed)
    count = sum(map(len, episodes.values()))
    print(f"Running {count} of {submission.episodes} episodes again, chosen by --seed {seed}", flush=True)
    return episodes, seed


def _reproduce(submission: Submission, policy: str, episodes: Chosen, options: Options) -> int:
    """Run a share of the episodes again, say what comes of it and return the exit status."""
    checked_policies([policy])
    again: list[Run] = []
    cells = cells_of(submission, episodes)
    with progress(len(cells), sum(len(cell.episodes) * cell.scenario.steps for cell in cells)) as report:
        pairs = [(policy, cell) for cell in cells]
        for run in runs(pairs, Workers(options.jobs), options.step_limit, report.board.note):
            report.run(run)
            again.append(run)
    if again[0].fingerprint != submission.fingerprint:
        print(f"note: {policy} is not the policy that was submitted: its fingerprint is another one", file=sys.stderr)
    count, found = sum(map(len, episodes.values())), mismatches(submission, episodes, again)
    if found:
        wrong = len({(m.scenario, m.episode) for m in found})
        print(f"NOT REPRODUCED: {wrong} of {count} episodes differ")
        for mismatch in found[:TOLD]:
            print(f"  {mismatch}")
        return FAILED
    print(f"Reproduced: all {len(MEASURED) * count} numbers, to {100 * RELATIVE:g} % of each.")
    caught = 100 * smallest_caught(count)
    print(f"Had {caught:.1f} % of the episodes been made up, this would have shown it with 95 % certainty.")
    return DONE


def _enter(options: Options) -> int:
    submission = _read(options)
    yardsticks(submission.suite)
    checked_folder(options.folder, "folder")
    try:
        enter(submission, options.folder, options.replace)
    except FileExistsError as error:
        raise UsageError(str(error)) from error
    print(f"Entered {place_of(submission, options.folder)}")
    return _page(options)


def _page(options: Options) -> int:
    found = _readable(partial(boards, options.folder))
    if not found:
        raise UsageError(f"there is no submission in --folder {options.folder}; expected is SUITE/NAME.npz")
    checked_folder(options.out)
    for name, text in ((PAGE, page(found)), (TABLE, leaderboard_json(found))):
        write_atomically(options.out / name, text)
    count = sum(len(board.submissions) for board in found)
    print(f"Wrote {options.out / PAGE} and {options.out / TABLE}: {count} entries")
    return DONE


def _readable(make: Callable[[], T]) -> T:
    """Return what `make` returns; raise UsageError where a file cannot be read, ValueError where it is a wrong one."""
    try:
        return make()
    except OSError as error:
        raise UsageError(f"cannot read {error.filename}: {error.strerror}") from error


def _own(options: Options) -> int:
    for suite, policy, file in own_files(options.folder):
        submission = own_submission(suite, policy)
        enter(submission, options.folder, replace=True)
        print(f"{file}:")
        episodes, seed = _chosen(submission, options)
        if _reproduce(submission, policy, episodes, options) != DONE:
            return FAILED
        stamp(file, options.folder, sum(map(len, episodes.values())), submission.episodes, seed)
    return _page(options)
