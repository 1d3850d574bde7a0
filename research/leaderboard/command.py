"""Manage the leaderboard: add and verify submissions, write the page: `python -m research leaderboard --help`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from baselines.agents.agent import Agent
from baselines.agents.names import agent_folder
from baselines.evaluation import recorded, suites
from baselines.evaluation.about import About
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.runner import STEP_LIMIT
from baselines.evaluation.submission.command import check_numbers, episodes_to_run, read_file, reproduce
from baselines.evaluation.submission.files import Submission, submission_of
from baselines.evaluation.submission.reproduction import REPRODUCED_SHARE
from baselines.evaluation.submission.scores import anchor_errors
from baselines.policies import list_policies
from baselines.tools.command_line import DONE, FAILED, UsageError, called, checked_folder, parse
from baselines.tools.files import write_atomically
from baselines.tools.workers import DEFAULT_JOBS
from research.leaderboard.board import boards, enter, stamp
from research.leaderboard.page import leaderboard_page

PROGRAM = "python -m research leaderboard"
PAGE = "leaderboard.md"  # file of the page
OWN = ("backstepping", "nmpc", "helm", "apg-preview-cruise", "apg-preview-slow")
"""Policies of the project on the leaderboard."""
SUITE = "benchmark-v2"
"""Suite of the project's own entries."""
_ARGUMENTS = {"enter": ("FILE", 1), "reproduce": ("FILE POLICY", 2), "own": ("no file", 0), "page": ("no file", 0)}


@dataclass(frozen=True)
class Options:
    """Add submissions to the leaderboard, verify them, and write its page.

    Exit status: 0 done, 1 a submission is damaged or not reproduced, 2 wrong usage.
    """

    action: Annotated[Positional[Literal["enter", "reproduce", "own", "page"]], arg(metavar="ACTION")]
    """enter FILE: check a submission and add it. reproduce FILE POLICY: run a random share of the episodes of an entry
    again and record that it is verified. own: make the project's own entries from its recorded rows, and reproduce
    them. page: write the page only; the other actions write it too."""
    words: Annotated[Positional[tuple[str, ...]], arg(metavar="[FILE [POLICY]]")] = ()
    """The submission, and the policy as for evaluate.py --policy."""
    share: float = REPRODUCED_SHARE
    """Share of the episodes of each case that is run again, from 0.05 to 1; they are selected at random."""
    replace: bool = False
    """Replace an entry of the same name."""
    folder: Path = Path("leaderboard")
    """Folder of the leaderboard, with files SUITE/NAME.npz."""
    out: Path = Path("docs")
    """Folder for the page, leaderboard.md."""
    jobs: int = DEFAULT_JOBS
    """Worker processes."""


def main(arguments: Sequence[str]) -> int:
    """Run an action and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options = parse(Options, arguments, PROGRAM)
    wanted, count = _ARGUMENTS[options.action]
    if len(options.words) != count:
        raise UsageError(f"{options.action} takes {wanted}; given are {len(options.words)} words")
    check_numbers(options.share, None, STEP_LIMIT, options.jobs)
    if options.share < REPRODUCED_SHARE:
        raise UsageError(f"--share is {options.share}; an entry is verified by {REPRODUCED_SHARE} or more")
    try:
        if options.action == "enter":
            _enter(options)
        elif options.action == "reproduce":
            file = Path(options.words[0])
            if not _reproduced(read_file(file), options.words[1], file, options):
                return FAILED
        elif options.action == "own":
            for policy, file in own_files(options.folder):
                submission = own_submission(SUITE, policy)
                enter(submission, options.folder, replace=True)
                if not _reproduced(submission, policy, file, options):
                    return FAILED
        return _page(options)
    except ValueError as error:
        print(f"{called(PROGRAM)}: {error}", file=sys.stderr)
        return FAILED


def _enter(options: Options) -> None:
    submission = read_file(Path(options.words[0]))
    anchor_errors(submission.suite)
    checked_folder(options.folder, "folder")
    try:
        print(f"Entered {enter(submission, options.folder, options.replace)}")
    except FileExistsError as error:
        raise UsageError(str(error)) from error


def _reproduced(submission: Submission, policy: str, file: Path, options: Options) -> bool:
    """Run a share of an entry's episodes again, record the success, and return whether the entry is verified.

    An entry is verified if the policy is the submitted one and gives the same numbers.
    """
    print(f"{file}:")
    episodes, seed = episodes_to_run(submission, options.share, None)
    if reproduce(submission, policy, episodes, options.jobs, STEP_LIMIT) != DONE:
        return False
    if fingerprint(policy) != submission.fingerprint:
        print(f"not verified: {policy} is not the policy that was submitted", file=sys.stderr)
        return False
    stamp(file, options.folder, sum(map(len, episodes.values())), submission.episodes, seed)
    return True


def _page(options: Options) -> int:
    try:
        found = boards(options.folder)
    except OSError as error:
        raise UsageError(f"cannot read {error.filename}: {error.strerror}") from error
    if not found:
        raise UsageError(f"there is no submission in --folder {options.folder}; the files must be SUITE/NAME.npz")
    checked_folder(options.out)
    write_atomically(options.out / PAGE, leaderboard_page(found))
    count = sum(len(board.submissions) for board in found)
    print(f"Wrote {options.out / PAGE}: {count} entries")
    return DONE


def own_submission(suite_name: str, policy: str) -> Submission:
    """Return the submission of one of the project's policies, from its recorded rows.

    Raises:
        ValueError: the policy has no rows, or its rows are not valid any more.
    """
    suite, digest = suites.load_suite(suite_name), fingerprint(policy)
    found = recorded.load_recorded(suite)
    rows = [replace(run, fingerprint=digest) for run in found.runs if run.policy == policy]
    if not rows:
        reason = found.refused.get(policy, "there are none")
        raise ValueError(f"there are no valid recorded rows of {policy} in {suite_name}: {reason}")
    record = rows[0].recorded
    assert record is not None
    command = f"python -m research suites record {suite_name} --policy {policy}"
    return submission_of(suite, rows, policy, _about(policy), record.versions, command)


def _about(policy: str) -> About:
    folder = agent_folder(policy)
    training = Agent.load(folder).training if folder else {}
    steps = training.get("config", {}).get("timesteps")
    return About("auv_gym", "", list_policies()[policy], steps, training.get("seconds"))


def own_files(folder: Path) -> list[tuple[str, Path]]:
    """Return policy and file of each of the project's own entries in the folder of a leaderboard."""
    return [(policy, folder / SUITE / f"{policy}.npz") for policy in OWN]
