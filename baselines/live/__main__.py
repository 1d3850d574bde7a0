"""Run as `python -m baselines.live`."""

import sys

from baselines.live.command import PROGRAM, main
from baselines.tools.command_line import run

if __name__ == "__main__":
    sys.exit(run(main, PROGRAM))
