"""Measure how fast environments, policies and training are: `python -m research throughput --help`."""

from __future__ import annotations

import logging
import os
import platform
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch

from auv_gym.codegen import native
from baselines.tools.command_line import DONE, parse
from baselines.tools.files import json_text, write_atomically
from research.throughput import environments, learning, policies, tracing
from research.throughput.figures import SCENARIO, Case
from research.throughput.page import THROUGHPUT_FILE, throughput_figure
from research.throughput.timing import TimedRun, interleaved, typical_time

PROGRAM = "python -m research throughput"
_CASES: tuple[Case, ...] = (
    environments.first_cases,
    environments.scalar_cases,
    environments.vector_cases,
    environments.scaling_cases,
    environments.drawing_cases,
    tracing.tracing_cases,
    policies.decision_cases,
    policies.evaluation_cases,
    policies.command_cases,
    learning.torch_cases,
    learning.gradient_cases,
    learning.sb3_cases,
    learning.window_cases,
    learning.group_cases,
    learning.training_cases,
)
"""What `make bench` runs, in this order."""


@dataclass(frozen=True)
class Options:
    """Measure how fast environments, policies and training are; print a table, write bench.json and bench.png.

    Exit status: 0 done, 2 wrong usage.
    """

    quick: bool = False
    """Fewer, shorter and smaller rounds: whether all of it still runs, not how fast."""
    only: str = ""
    """Only the groups of cases whose name holds this, such as scalar, vector, decision or training."""
    out: Path = Path("runs/bench")
    """Folder of the files."""
    record: bool = False
    """Keep what was measured for docs/speed.md, too, which `python -m research pages speed` then writes."""


def curves(quick: bool) -> dict[str, list[tuple[int, float]]]:
    """Return vehicle steps per second against N, by what is stepped; tapes and resets are left out."""
    sizes = (1, 16, 64) if quick else (1, 4, 16, 64, 256, 1024, 4096, 16384)
    runs: dict[str, tuple[int, Callable[[int, int], TimedRun]]] = {
        "auv_gym": (sizes[-1], environments.track),
        "auv_gym, torch": (sizes[-1], lambda n, k: learning.on_torch(n, k, compiled=not quick)),
        "Pendulum-v1, SyncVectorEnv": (1024, lambda n, k: environments.peer("Pendulum-v1", n, "sync", k)),
        "CartPole-v1, native": (sizes[-1], lambda n, k: environments.peer("CartPole-v1", n, environments.NATIVE, k)),
    }
    return {
        label: [
            (n, 1 / typical_time(interleaved(3, run(n, max(4, min(64, 8192 // n))))[0])) for n in sizes if n <= largest
        ]
        for label, (largest, run) in runs.items()
    }


def machine() -> str:
    """Return what it is measured on."""
    compiler = native.compiler() if native.wanted() else None
    code = compiler[1].splitlines()[0] if compiler else "no compiler"
    processor = platform.processor() or platform.machine()
    return f"{processor}, {os.cpu_count()} cores, Python {platform.python_version()}, {code}"


def main(arguments: Sequence[str]) -> int:
    """Run every case as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options, figures = parse(Options, arguments, PROGRAM), []
    logging.basicConfig(format="%(message)s")
    logging.getLogger("auv_gym").setLevel(logging.INFO)
    warnings.filterwarnings("ignore", module="gymnasium")
    torch.set_num_threads(1)
    print(f"{machine()}; processor time on one thread; scenario {SCENARIO}\n")
    for case in _CASES:
        for figure in case(options.quick) if options.only in case.__name__ else ():
            figures.append(figure)
            goal = f"goal {figure.goal_text}: {'met' if figure.met else 'missed'}" if figure.goal is not None else ""
            print(f"{figure.case:<76} {figure.text:>10}  {goal}", flush=True)
    points = {} if options.only else curves(options.quick)
    text = json_text({
        "machine": machine(),
        "quick": options.quick,
        "figures": [asdict(figure) for figure in figures],
        "steps_per_second": points,
    })  # fmt: skip
    options.out.mkdir(parents=True, exist_ok=True)
    write_atomically(options.out / "bench.json", text)
    if points:
        write_atomically(options.out / "bench.png", throughput_figure(points))
        if options.record:
            write_atomically(THROUGHPUT_FILE, text)
    print(f"\nwritten: {options.out / 'bench.json'}")
    return DONE
