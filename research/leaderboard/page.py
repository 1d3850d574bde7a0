"""The page of the leaderboard."""

from __future__ import annotations

import re
from collections.abc import Sequence

from baselines.evaluation.report.columns import COLUMNS
from baselines.evaluation.report.numbers import Entry
from baselines.evaluation.submission.files import Submission
from research.leaderboard.board import Leaderboard

PROGRAM = "python -m research leaderboard"
_TEXT = f"""# Leaderboard

<!-- Made by `{PROGRAM} page`; do not edit. -->

All submitted policies, by suite and speed range, the best first. To add yours see [Submit](enter.md).

- The score is 0 for the expert and 1 for the policy that is named with the suite. Its 95 % interval is over paired
  episodes.
- *Failures* have the 95 % upper confidence bound of the failure rate. *Effort* and *command rate* are relative to the
  expert.
- *Time* is that of one decision on the submitter's machine, with many vehicles simulated together. *Training* is the
  cost that the submitter states.
- *Verified* entries were run again by the project, on a random share of their episodes. Of the others only the file was
  checked.

[Evaluation](metrics.md) has the definitions.
"""
_NONE = "-"  # text of a missing value
NBSP = "\N{NO-BREAK SPACE}"  # space within a line of a cell
BREAK = "<br>"  # separator of the lines of a cell
_HEADINGS = [
    "rank", "entry<br>by", "score<br>95 %", "error [m]", "failures", "effort<br>command rate", "time [ms]", "training",
    "verified",
]  # fmt: skip
"""Headings of the tables."""


def leaderboard_page(boards: Sequence[Leaderboard]) -> str:
    """Return the page as Markdown."""
    parts = [_TEXT]
    for board in boards:
        suite = board.suite
        count = sum(len(cell.episodes) for cell in suite.cells)
        setting = f"{len(suite.cells)} cells, {count} episodes, SHA-256 `{suite.hash}`. `{suite.anchors.one}` scores 1."
        parts.append(f"## {suite.name}\n\n{setting}\n")
        by_name = {s.name: s for s in board.submissions}
        for place in dict.fromkeys(entry.place for entry in board.entries):
            own = [entry for entry in board.entries if entry.place == place]
            parts.append(f"### {place}\n\n{_table(board, own)}\n")
        parts.append("### Descriptions\n")
        parts.append("\n".join(_described(by_name[name]) for name in sorted(by_name)) + "\n")
    return "\n".join(parts)


def _table(board: Leaderboard, entries: Sequence[Entry]) -> str:
    """Return the table of one speed range; its cells have two lines, so that it fits on a page."""
    by_name, rows = {s.name: s for s in board.submissions}, []
    for rank, entry in enumerate(entries, start=1):
        s, text = by_name[entry.policy], {column.key: column.text(entry) for column in COLUMNS}
        figures = (
            [text["score.mean"], text["score.ci95"]],
            [text["steady_rmse_m.mean"]],
            text["failed"].partition(" (")[::2],
            [text["effort_ratio"], text["smoothness_ratio"]],
            [text["decision_ms"]],
            costs(s),
            verification(board, s.name),
        )
        cells = [BREAK.join(line.strip(")").replace(" ", NBSP) for line in lines if line) for lines in figures]
        rows.append([str(rank), f"`{s.name}`{BREAK}{plain(s.about.author) or _NONE}", *cells])
    lines = [_HEADINGS, ["--:", "---", *("--:" for _ in _HEADINGS[2:])], *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _described(s: Submission) -> str:
    """Return the line of an entry in the list of descriptions."""
    more = f" [Link]({s.about.link})." if s.about.link else ""
    words = plain(s.about.description).rstrip(".") or "no description"
    return (
        f"- `{s.name}`: {words}.{more} Policy `{s.fingerprint[:12]}`, run on {s.date} with auv_gym "
        f"{plain(str(s.versions.get('auv_gym', _NONE)))}."
    )


def verification(board: Leaderboard, name: str) -> list[str]:
    """Return the lines of the cell about the reproduction of an entry."""
    found = board.verified.get(name)
    return [f"{found['episodes']} of {found['of']}", found["date"]] if found else ["no"]


def costs(s: Submission) -> list[str]:
    """Return the lines of the cell about the stated cost of a training."""
    steps, seconds = s.about.training_steps, s.about.training_seconds
    lines = [] if steps is None else [f"{_short(steps)} steps"]
    return [*lines, *([] if seconds is None else [_time(seconds)])] or [_NONE]


def _time(seconds: float) -> str:
    """Return a time with its unit."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.3g} h"


def _short(count: float) -> str:
    for size, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if count >= size:
            return f"{count / size:.3g} {letter}"
    return f"{count:.0f}"


def plain(text: str) -> str:
    """Return a submitter's text with all punctuation escaped, so that it contains no Markdown and no HTML."""
    return re.sub(r"([!-/:-@\[-`{-~])", r"\\\1", text)
