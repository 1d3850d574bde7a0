"""Run as `python -m benchmarks`."""

from __future__ import annotations

import logging
import os
import platform
import sys
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch
from matplotlib.figure import Figure

from baselines.tools.command_line import DONE, parse, run
from baselines.tools.figure_style import panels, to_png
from baselines.tools.files import json_text, write_atomically
from benchmarks.cases import CASES, SCENARIO, curves

PROGRAM = "python -m benchmarks"


@dataclass(frozen=True)
class Options:
    """Measure the speed of the environments; print a table, write bench.json and bench.png.

    Exit status: 0 done, 2 wrong usage.
    """

    quick: bool = False
    """Fewer, shorter and smaller rounds: whether all of it still runs, not how fast."""
    out: Path = Path("runs/bench")
    """Folder of bench.json and bench.png."""


def drawn(points: Mapping[str, Sequence[tuple[int, float]]]) -> Figure:
    """Return the figure of vehicle steps per second against N."""
    figure, [[axes]] = panels(1, 1, (7.0, 4.5))
    for label, own in points.items():
        axes.loglog(*zip(*own, strict=True), marker="o", label=label)
    axes.set(xlabel="sub-environments N", ylabel="vehicle steps per second")
    axes.legend()
    return figure


def main(arguments: Sequence[str]) -> int:
    """Run every case as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options, rows = parse(Options, arguments, PROGRAM), []
    logging.basicConfig(format="%(message)s")
    logging.getLogger("auv_gym").setLevel(logging.INFO)
    warnings.filterwarnings("ignore", module="gymnasium")
    torch.set_num_threads(1)
    print(f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores; processor time on one thread")
    print(f"scenario {SCENARIO}: every disturbance at once; ratio: peer / ours, or the share\n")
    print(f"{'case':<68} {'ours [us]':>10} {'peer [us]':>10} {'ratio':>7}  per")
    for case in CASES:
        for row in case(options.quick):
            rows.append(asdict(row))
            numbers = f"{1e6 * row.ours:>10.3f} {1e6 * row.peer:>10.3f} {row.ratio:>7.3f}"
            print(f"{row.case:<68} {numbers}  {row.unit}", flush=True)
    points = curves(options.quick)
    options.out.mkdir(parents=True, exist_ok=True)
    record = {"rows": rows, "steps_per_second": points, "quick": options.quick}
    write_atomically(options.out / "bench.json", json_text(record))
    write_atomically(options.out / "bench.png", to_png(drawn(points)))
    print(f"\nwritten: {options.out / 'bench.json'}, {options.out / 'bench.png'}")
    return DONE


if __name__ == "__main__":
    sys.exit(run(main, PROGRAM))
