"""Submissions made: by `evaluate.py --submit NAME`, and of the project's own policies from their recorded rows."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

from baselines import list_policies
from baselines.agents.agent import Agent
from baselines.agents.names import agent_folder
from baselines.evaluation import recorded, suites
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.options import Options
from baselines.evaluation.runner import Run
from baselines.evaluation.submission.about import NOTHING, About, checked_about, checked_name
from baselines.evaluation.submission.files import Submission, save, submission_of
from baselines.tools.command_line import DONE, FAILED, UsageError
from baselines.tools.files import versions

if TYPE_CHECKING:
    from baselines.evaluation.request import Request

OWN = ("backstepping", "nmpc", "helm", "apg-preview-cruise", "apg-preview-slow")
"""Policies of the project that are on its leaderboard."""
OWN_SUITES = ("benchmark-v2",)
"""Suites in which they are."""


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


def write_submission(request: Request, found: Sequence[Run]) -> int:
    """Write the submission of an evaluation beside its other files, say where, and return the exit status.

    Raises:
        OSError: it cannot be written.
    """
    options, (policy,) = request.options, set(request.options.policy)
    assert options.submit is not None
    own = [run for run in found if run.policy == policy]
    file = options.out / f"{options.submit}.npz"
    try:
        suite = suites.load(request.suite or "")
        made = submission_of(suite, own, options.submit, options.about, versions(), request.command)
        size = save(made, file)
    except ValueError as error:
        print(f"no submission: {error}", file=sys.stderr)
        return FAILED
    print(f"Wrote {file}, {size / 1000:.0f} kB: {made.episodes} episodes of {suite.name}")
    print(f"Look at it with `python -m research leaderboard verify {file} {policy!r}`")
    return DONE


def own_submission(suite_name: str, policy: str) -> Submission:
    """Return the submission of one of the project's policies, from its recorded rows.

    Raises:
        ValueError: its rows do not count, or it has none.
    """
    suite, digest = suites.load(suite_name), fingerprint(policy)
    found = recorded.load(suite)
    rows = [replace(run, fingerprint=digest) for run in found.runs if run.policy == policy]
    if not rows:
        reason = found.refused.get(policy, "there are none")
        raise ValueError(f"the recorded rows of {policy} in {suite_name} do not count: {reason}")
    record = rows[0].recorded
    assert record is not None
    command = f"python -m research suites record {suite_name} --policy {policy}"
    return submission_of(suite, rows, policy, _about(policy), record.versions, command)


def _about(policy: str) -> About:
    folder = agent_folder(policy)
    training = Agent.load(folder).training if folder else {}
    steps = training.get("config", {}).get("timesteps")
    return About("auv_gym", "", list_policies()[policy], steps, training.get("seconds"))


def own_files(folder: Path) -> list[tuple[str, str, Path]]:
    """Return suite, policy and file of each of the project's own submissions in the folder of a leaderboard."""
    return [(suite, policy, folder / suite / f"{policy}.npz") for suite in OWN_SUITES for policy in OWN]
