"""Run as `python -m baselines.tuning`."""

import sys

from baselines.tools.command_line import run
from baselines.tuning.command import PROGRAM, main

sys.exit(run(main, PROGRAM))
