"""Score controllers and agents: `python evaluate.py --help`. In the installed package: `auv-gym evaluate`."""

import sys
from collections.abc import Sequence

from baselines.__main__ import COMMANDS, call

PROGRAM = "evaluate.py"


def main(arguments: Sequence[str]) -> int:
    """Run the evaluation and return the exit status; see `baselines.evaluation.entry.main`."""
    from baselines.evaluation import entry

    return entry.main(arguments)


if __name__ == "__main__":
    sys.exit(call(COMMANDS["evaluate"], sys.argv[1:], PROGRAM))
