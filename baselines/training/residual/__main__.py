"""Run as `python -m baselines.training.residual`."""

import sys

from baselines.tools.command_line import run
from baselines.training.residual.command import PROGRAM, main

sys.exit(run(main, PROGRAM))
