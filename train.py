"""Train agents: `python train.py --help`. In the installed package: `auv-gym train`."""

import sys

from baselines.__main__ import COMMANDS, call

if __name__ == "__main__":
    sys.exit(call(COMMANDS["train"], sys.argv[1:], "train.py"))
