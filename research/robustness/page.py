"""The sections of docs/safety.md that are written from what the commands of this room have kept."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from baselines.evaluation.metrics import most_lost
from baselines.evaluation.score import regime_of
from baselines.tools.files import read_json
from research import DOCS
from research.pages import table
from research.robustness import certificate, falsification, saved

PAGE = DOCS / "safety.md"  # whose sections are written here
SHOWN = 6
"""How many coordinates of a sea the page shows, the largest ones."""


def filled(text: str) -> str:
    """Return the page with its sections written anew: what stands between `<!-- NAME: ... -->` and `<!-- end -->`.

    Raises:
        ValueError: a section is missing.
    """
    for name, section in SECTIONS.items():
        head, begin, rest = text.partition(f"<!-- {name}: ")
        comment, close, rest = rest.partition("-->\n")
        _, end, tail = rest.partition("<!-- end -->")
        if not (begin and close and end):
            raise ValueError(f"the page has no section {name!r}")
        text = f"{head}{begin}{comment}{close}\n{section()}\n\n{end}{tail}"
    return text


def _table(command: str, heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table, or what makes its rows where there are none yet."""
    return table(heads, rows) if rows else f"Not measured yet: `{command}`."


def certificates() -> str:
    """Return the table of lost episodes, by policy and by what the episodes were drawn from."""
    rows = []
    for policy, own in certificate.kept().items():
        groups: dict[str, list[certificate.Count]] = {}
        for name, count in own["counts"].items():
            place = name if name in certificate.ADVERSE else f"the eight cases, {regime_of(name)}"
            groups.setdefault(place, []).append(count)
        for place, counts in groups.items():
            lost, episodes = certificate.together(counts)
            worst = max(count.largest_tail_m for count in counts)
            at_most = f"{100 * most_lost(lost, episodes):.2g} %"
            alike = "" if len({count.episodes for count in counts}) == 1 else ", some more often"
            rows.append([f"`{policy}`", f"{place}{alike}", str(episodes), str(lost), at_most, f"{100 * worst:.3g}"])
    return _table(
        certificate.PROGRAM, ("policy", "episodes of", "episodes", "lost", "at most", "largest tail [cm]"), rows
    )


def found_seas() -> str:
    """Return the table of the mildest seas that were found."""
    rows = []
    for name, found in sorted(falsification.kept().items(), key=lambda item: _place(item[1])):
        severity = found["severity"] if found["severity"] is not None else math.inf
        known = [(key, x) for key, x in found["coordinates"].items() if key != "direction"]
        largest = sorted(known, key=lambda entry: -abs(entry[1]))[:SHOWN]
        rows.append([
            f"`{found['policy']}`",
            f"{found['regime']}, {found['sea']}",
            f"[{severity:.2f}](seas/{name}.toml)" if math.isfinite(severity) else "none found",
            f"{found['lost']} of {falsification.CONFIRMED}",
            str(found["episodes"]),
            ", ".join(f"{key} {x:+.2f}" for key, x in largest),
        ])  # fmt: skip
    return _table(
        falsification.PROGRAM, ("policy", "sea", "severity", "lost", "episodes run", "its largest coordinates"), rows
    )


def _place(found: Mapping[str, Any]) -> tuple[str, str, float]:
    return found["sea"], found["regime"], -(found["severity"] or math.inf)


def guards() -> dict[str, Any]:
    """Return what is kept of guards, by part; {} where nothing is."""
    record: dict[str, Any] = read_json(saved.FILE) if saved.FILE.exists() else {}
    return record


def in_suites() -> str:
    """Return the table of what guards save in the frozen suites."""
    rows = [
        [
            f"`{policy}`",
            suite,
            str(row["episodes"]),
            *(str(row[key]) for key in ("lost", "guarded_lost", "expert_keeps", "guarded_expert_keeps")),
            f"{row['tail_mm']:.2f}",
            f"{row['guarded_tail_mm']:.2f}",
        ]
        for policy, own in guards().get("suites", {}).items()
        for suite, row in own.items()
        if suite != "fingerprint"
    ]
    heads = "agent", "suite", "episodes", "lost", "with a guard", "of the expert's", "with a guard"
    return _table(saved.PROGRAM, (*heads, "mean tail [mm]", "with a guard"), rows)


def failures() -> str:
    """Return the table of networks that fail."""
    rows = [
        [policy, failure, str(row["episodes"]), str(row["lost"]), str(row["guarded_lost"])]
        for policy, own in guards().get("failures", {}).items()
        for failure, row in own.items()
        if failure != "fingerprint"
    ]
    return _table(f"{saved.PROGRAM} --failures", ("agent", "its network is", "episodes", "lost", "with a guard"), rows)


SECTIONS: Mapping[str, Callable[[], str]] = {
    "certificates": certificates,
    "seas": found_seas,
    "suites": in_suites,
    "failures": failures,
}
"""What makes each section of the page, by name."""
