"""Train agents that correct an expert: `auv-gym train --help`, in a checkout also `python train.py --help`."""

from __future__ import annotations

from collections.abc import Sequence

from baselines.tools.command_line import parse, typed
from baselines.training.options import PROGRAM, Options


def main(arguments: Sequence[str]) -> int:
    """Run the command and return its exit status.

    Raises:
        ModuleNotFoundError: a library for training is not installed.
        UsageError: an argument is wrong.
    """
    options = parse(Options, arguments, PROGRAM)
    from baselines.training.command import train
    from baselines.training.request import Request

    return train(Request.of(options, typed(PROGRAM, arguments)))
