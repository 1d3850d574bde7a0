"""What a submission comes to: the figures of evaluate.py's tables, against the recorded anchors of its suite."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from baselines.evaluation import recorded
from baselines.evaluation.report.columns import ranked
from baselines.evaluation.report.numbers import Entry, pool
from baselines.evaluation.runner import Run
from baselines.evaluation.submission.files import Submission
from baselines.evaluation.suites import Suite

_MARK = "entry "  # before the names of entries, which may be those of policies


def anchor_errors(suite: Suite) -> tuple[Run, ...]:
    """Return the recorded runs of a suite's anchors, the score's 0 and 1.

    Raises:
        ValueError: there are none that count; the message says why.
    """
    found = recorded.load_recorded(suite)
    for policy in suite.anchors:
        if all(run.policy != policy for run in found.runs):
            reason = recorded.missing(suite.name) or found.refused.get(policy, "there are none")
            raise ValueError(
                f"the recorded rows of {policy} in {suite.name}, which scores need, do not count: {reason}"
            )
    return tuple(run for run in found.runs if run.policy in suite.anchors)


def entries(submissions: Sequence[Submission], ends: Sequence[Run]) -> list[Entry]:
    """Return the figures of submissions of one suite, a regime at a time, the best first.

    Args:
        submissions: with names of their own.
        ends: runs of its anchors, see `anchor_errors`.
    """
    runs = [replace(run, policy=_MARK + s.name) for s in submissions for run in s.runs]
    anchors = submissions[0].suite.anchors
    own = [e for e in pool([*ends, *runs], anchors) if e.policy.startswith(_MARK)]
    named = [replace(entry, policy=entry.policy.removeprefix(_MARK), recorded=False) for entry in own]
    places = dict.fromkeys(entry.place for entry in named)
    return [entry for place in places for entry in ranked([e for e in named if e.place == place])]
