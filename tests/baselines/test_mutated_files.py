"""Some damaged files of every format; `tests/mutated_files.py` reads as many as one wants."""

import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import settings
from mutated_files import FORMATS

SCRIPT = Path(__file__).parents[1] / "mutated_files.py"
COUNT = settings().max_examples // 5


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="measures memory by /proc")
@pytest.mark.parametrize("kind", FORMATS)
def test_damaged_files_are_refused_in_one_line_in_little_time_and_memory(kind):
    command = [sys.executable, SCRIPT, kind, "--count", str(COUNT)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=SCRIPT.parents[1])
    assert done.returncode == 0, done.stdout + done.stderr
