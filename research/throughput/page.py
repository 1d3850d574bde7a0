"""The values and the figure of docs/speed.md: how fast everything is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from baselines.tools.figure_style import panels, to_png
from baselines.tools.files import read_json
from research import DATA
from research.throughput.figures import SCENARIO, Figure

THROUGHPUT_FILE = DATA / "throughput.json"  # what was measured


def context(page: str) -> dict[str, Any]:
    """Return machine, scenario and the rows of the table."""
    del page
    record = read_json(THROUGHPUT_FILE)
    rows = [row(Figure(**figure)) for figure in record["figures"]]
    return {"machine": record["machine"], "scenario": SCENARIO, "rows": rows}


def figures(page: str) -> dict[str, bytes]:
    """Return the figure of vehicle steps per second against N."""
    del page
    return {"bench.png": throughput_figure(read_json(THROUGHPUT_FILE)["steps_per_second"])}


def row(figure: Figure) -> tuple[str, str, str, str]:
    """Return what a table says of a number: what it is, its value, its goal, and whether that is met."""
    met = {None: "", True: "yes", False: "no"}[figure.met]
    return figure.case.replace("  ", "… "), figure.text, figure.goal_text, met


def throughput_figure(points: Mapping[str, Sequence[tuple[int, float]]]) -> bytes:
    """Return the figure of vehicle steps per second against N, by what is stepped."""
    figure, [[axes]] = panels(1, 1, (7.0, 4.5))
    for label, own in points.items():
        axes.loglog(*zip(*own, strict=True), marker="o", label=label)
    axes.set(xlabel="vehicles side by side", ylabel="vehicle steps per second")
    axes.legend()
    return to_png(figure)
