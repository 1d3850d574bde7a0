"""Score controllers and agents: `auv-gym evaluate --help`, in a checkout also `python evaluate.py --help`."""

from __future__ import annotations

from collections.abc import Sequence

from baselines.evaluation.options import Options
from baselines.tools.command_line import parse, typed

PROGRAM = "evaluate.py"


def main(arguments: Sequence[str]) -> int:
    """Run an evaluation and return the exit status; modules that take long to import are imported after the check."""
    options, command = parse(Options, arguments, PROGRAM), typed(PROGRAM, arguments)
    from baselines.evaluation.evaluate import evaluate
    from baselines.evaluation.request import Request

    return evaluate(Request.of(options, command))
