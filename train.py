"""Train agents: `python train.py --help`. Installed as a package: `auv-gym train`."""

import sys
from collections.abc import Sequence

from baselines.__main__ import COMMANDS, call

PROGRAM = "train.py"


def main(arguments: Sequence[str]) -> int:
    """Train as the arguments say and return the exit status; see `baselines.training.entry.main`."""
    from baselines.training import entry

    return entry.main(arguments)


if __name__ == "__main__":
    sys.exit(call(COMMANDS["train"], sys.argv[1:], PROGRAM))
