"""Run as `python -m auv_gym.identify LOG.csv`; the command and its report come with `baselines`."""

import sys
from importlib import import_module

if __name__ == "__main__":
    sys.exit(import_module("baselines.__main__").call("identify", sys.argv[1:], "python -m auv_gym.identify"))
