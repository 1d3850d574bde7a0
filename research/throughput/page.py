"""The page of the documentation that says how fast everything is, docs/speed.md."""

from __future__ import annotations

from collections.abc import Sequence

from research.pages import table
from research.throughput.figures import Figure

_INTRODUCTION = """# Speed

<!-- Made by `python -m research throughput --record`; do not edit. -->

How fast it is, measured by `make bench`: processor time on one thread, medians of rounds in which what is compared
takes turns, so that a busy machine slows all of it alike. Ratios say how many times faster ours is than what it stands
against. Times are of one run on a shared machine: another run may give twice as much, or half. Where there is a goal,
the last column says whether it is met. The scenario is `{scenario}`, every disturbance
at once; [From equation to code](codegen.md) says where the speed comes from."""


def page(record: Sequence[Figure], machine: str, scenario: str) -> str:
    """Return the text of the page for the figures of a machine."""
    rows = [
        (
            figure.case.replace("  ", "… "),
            figure.text,
            figure.goal_text,
            {None: "", True: "yes", False: "no"}[figure.met],
        )
        for figure in record
    ]
    picture = "![Vehicle steps per second against the number of vehicles](images/bench.png)"
    head = _INTRODUCTION.format(scenario=scenario)
    return f"{head}\n\nMeasured on {machine}.\n\n{picture}\n\n{table(('what', 'measured', 'goal', 'met'), rows)}\n"
