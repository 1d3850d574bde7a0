"""Run as `python -m baselines.evaluation.floor`."""

import sys

from baselines.evaluation.floor.command import PROGRAM, main
from baselines.tools.command_line import run

sys.exit(run(main, PROGRAM))
