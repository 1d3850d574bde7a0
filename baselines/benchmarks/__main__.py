"""Run as `python -m baselines.benchmarks`."""

import sys

from baselines.benchmarks.command import PROGRAM, main
from baselines.tools.command_line import run

sys.exit(run(main, PROGRAM))
