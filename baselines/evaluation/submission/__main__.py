"""Run as `python -m baselines.evaluation.submission`."""

from __future__ import annotations

import sys

from baselines.evaluation.submission.command import PROGRAM, main
from baselines.tools.command_line import run

if __name__ == "__main__":
    sys.exit(run(main, PROGRAM))
