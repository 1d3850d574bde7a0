"""Train agents: `python train.py --help`. In the installed package: `auv-gym train`."""

import sys

from baselines.__main__ import COMMANDS, call, end

if __name__ == "__main__":
    end(call(COMMANDS["train"], sys.argv[1:], "train.py"))
