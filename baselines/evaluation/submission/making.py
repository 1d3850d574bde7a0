"""What `evaluate.py --submit NAME` checks and writes."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict

from baselines.evaluation import suites
from baselines.evaluation.options import Options
from baselines.evaluation.runner import Run
from baselines.evaluation.submission.about import NOTHING, checked_about, checked_name
from baselines.evaluation.submission.files import save, submission_of
from baselines.tools.command_line import DONE, FAILED, UsageError
from baselines.tools.files import versions


def check_options(options: Options, suite: str | None) -> None:
    """Look whether a submission can come of an evaluation, before anything runs.

    Raises:
        UsageError: it cannot; the message says what to change.
    """
    if options.submit is None:
        if options.about != NOTHING:
            raise UsageError("--author, --link, --description and --training-... are for --submit NAME; add it")
        return
    if suite not in suites.list_suites():
        allowed = ", ".join(suites.list_suites())
        raise UsageError(f"--submit needs a frozen suite, one of {allowed}: --suite benchmark-v2")
    if len(set(options.policy)) != 1:
        raise UsageError(f"--submit needs one policy, --policy P; there are {len(set(options.policy))}")
    if options.episodes is not None:
        raise UsageError("--submit needs all episodes of the suite; leave out --episodes")
    try:
        checked_name(options.submit)
        checked_about(asdict(options.about))
    except ValueError as error:
        raise UsageError(f"--submit: {error}") from error


def write_submission(options: Options, suite_name: str, command: str, found: Sequence[Run]) -> int:
    """Write the submission of an evaluation beside its other files, say where, and return the exit status.

    Args:
        options: of the evaluation, with `submit`.
        suite_name: of the frozen suite.
        command: as the user gave it.
        found: the runs of the evaluation.

    Raises:
        OSError: it cannot be written.
    """
    (policy,) = set(options.policy)
    assert options.submit is not None
    own = [run for run in found if run.policy == policy]
    file = options.out / f"{options.submit}.npz"
    try:
        suite = suites.load(suite_name)
        made = submission_of(suite, own, options.submit, options.about, versions(), command)
        size = save(made, file)
    except ValueError as error:
        print(f"no submission: {error}", file=sys.stderr)
        return FAILED
    print(f"Wrote {file}, {size / 1000:.0f} kB: {made.episodes} episodes of {suite.name}")
    print(f"Look at it with `auv-gym submit {file} {policy!r}`")
    return DONE
