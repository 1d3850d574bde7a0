"""Score controllers and agents: `python evaluate.py --help`. In the installed package: `auv-gym evaluate`."""

import sys

from baselines.__main__ import COMMANDS, call

if __name__ == "__main__":
    sys.exit(call(COMMANDS["evaluate"], sys.argv[1:], "evaluate.py"))
