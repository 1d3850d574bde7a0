"""Score controllers and agents: `python evaluate.py --help`."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence

from baselines.evaluation.options import Options
from baselines.tools.command_line import parse, run

PROGRAM = "evaluate.py"


def main(arguments: Sequence[str]) -> int:
    """Evaluate as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options, command = parse(Options, arguments, PROGRAM), f"python {PROGRAM} {shlex.join(arguments)}".rstrip()
    from baselines.evaluation.command import evaluate
    from baselines.evaluation.request import Request, checked_folder, checked_policies
    from baselines.evaluation.score import EXPERT

    if options.stability:
        from baselines.evaluation.stability.report import report

        return report(checked_policies(options.policy or (EXPERT,)), checked_folder(options.out), command)
    return evaluate(Request.of(options, command))


if __name__ == "__main__":
    sys.exit(run(main, PROGRAM))
