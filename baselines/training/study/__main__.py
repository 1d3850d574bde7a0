"""Run as `python -m baselines.training.study`."""

import sys

from baselines.tools.command_line import run
from baselines.training.study.command import PROGRAM, main

sys.exit(run(main, PROGRAM))
