"""Score controllers and agents: `python evaluate.py --help`. In the installed package: `auv-gym evaluate`."""

import sys
from importlib.util import find_spec

from baselines.__main__ import COMMANDS, call, end

if __name__ == "__main__":
    if find_spec("research"):
        import research  # noqa: F401, it adds the suites of a clone
    end(call(COMMANDS["evaluate"], sys.argv[1:], "evaluate.py"))
