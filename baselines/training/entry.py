"""Train agents that correct an expert: `auv-gym train --help`, in a checkout also `python train.py --help`."""

from __future__ import annotations

from collections.abc import Sequence

from baselines.tools.command_line import parse, typed
from baselines.training.options import PROGRAM, Options


def main(arguments: Sequence[str]) -> int:
    """Train as the arguments say and return the exit status.

    Raises:
        ModuleNotFoundError: what training needs is not installed.
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    from baselines.training.command import train
    from baselines.training.request import Request

    return train(Request.of(options, typed(PROGRAM, arguments)))
