"""Run as `python -m baselines.evaluation.knows`."""

import sys

from baselines.evaluation.knows.command import PROGRAM, main
from baselines.tools.command_line import run

sys.exit(run(main, PROGRAM))
