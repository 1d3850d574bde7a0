"""A few kills; `python tests/kills.py` has many, and the other faults."""

import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[1] / "kills.py"


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/cwd").exists(), reason="looks at processes in /proc")
def test_what_is_killed_goes_on_to_the_same_result():
    done = subprocess.run(
        [sys.executable, SCRIPT, "--quick", "--kills", "3"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
