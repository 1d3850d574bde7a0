"""Run as `python -m baselines.export`."""

import sys

from baselines.export.command import PROGRAM, main
from baselines.tools.command_line import run

if __name__ == "__main__":
    sys.exit(run(main, PROGRAM))
