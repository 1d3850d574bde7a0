"""Train agents: `python train.py --help`."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence

from baselines.tools.command_line import UsageError, parse, run
from baselines.training.options import PROGRAM, Options


def main(arguments: Sequence[str]) -> int:
    """Train as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense, or what training needs is not installed.
    """
    options = parse(Options, arguments, PROGRAM)
    try:
        from baselines.training.command import train
        from baselines.training.request import Request

        request = Request.of(options, f"python {PROGRAM} {shlex.join(arguments)}")
    except ImportError as error:
        raise UsageError(f"{error}; training needs more packages: pip install 'auv-gym[train]'") from error
    return train(request)


if __name__ == "__main__":
    sys.exit(run(main, PROGRAM))
