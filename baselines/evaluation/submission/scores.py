"""Computes the results of submissions for tables, with the recorded anchors of their suite."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from baselines.evaluation import recorded
from baselines.evaluation.report.columns import ranked
from baselines.evaluation.report.numbers import Entry, pool
from baselines.evaluation.runner import Run
from baselines.evaluation.submission.files import Submission
from baselines.evaluation.suites import Suite

_PREFIX = "entry "  # prefix of the names of entries, which can be the same as names of policies


def anchor_errors(suite: Suite) -> tuple[Run, ...]:
    """Return the recorded runs of the two anchors of a suite.

    Raises:
        ValueError: they are missing or outdated; the message has the reason.
    """
    found = recorded.load_recorded(suite)
    for policy in suite.anchors:
        if all(run.policy != policy for run in found.runs):
            reason = recorded.missing(suite.name) or found.refused.get(policy, "there are none")
            raise ValueError(
                f"scores need the recorded rows of {policy} in {suite.name}, which cannot be used: {reason}"
            )
    return tuple(run for run in found.runs if run.policy in suite.anchors)


def entries(submissions: Sequence[Submission], ends: Sequence[Run]) -> list[Entry]:
    """Return the results of submissions of one suite, by speed range, the best first.

    Args:
        submissions: submissions with different names.
        ends: runs of the suite's anchors, see `anchor_errors`.
    """
    runs = [replace(run, policy=_PREFIX + s.name) for s in submissions for run in s.runs]
    anchors = submissions[0].suite.anchors
    own = [e for e in pool([*ends, *runs], anchors) if e.policy.startswith(_PREFIX)]
    named = [replace(entry, policy=entry.policy.removeprefix(_PREFIX), recorded=False) for entry in own]
    places = dict.fromkeys(entry.place for entry in named)
    return [entry for place in places for entry in ranked([e for e in named if e.place == place])]
