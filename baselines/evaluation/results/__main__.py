"""Run as `python -m baselines.evaluation.results`."""

import sys

from baselines.evaluation.results.command import PROGRAM, main
from baselines.tools.command_line import run

sys.exit(run(main, PROGRAM))
