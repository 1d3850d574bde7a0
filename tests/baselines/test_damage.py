"""A few damaged files, kills and signals; `tests/mutated_files.py` and `tests/kills.py` have as many as one wants."""

import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import settings
from mutated_files import FORMATS, tried

from baselines.tools import files

COUNT = settings().max_examples // 5
KILLS = Path(__file__).parents[1] / "kills.py"
SLOW = "model.zip"  # a fifth of a second for a file


@pytest.mark.parametrize("kind", [pytest.param(k, marks=pytest.mark.slow if k == SLOW else ()) for k in FORMATS])
def test_damaged_files_are_read_or_refused_in_one_line(kind, monkeypatch):
    monkeypatch.setattr(files, "DATA_FOLDERS", list(files.DATA_FOLDERS))
    refused, wrong = tried(kind, COUNT, seed=0)
    assert not wrong, "\n".join(wrong)
    assert refused > 0


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/cwd").exists(), reason="looks at processes in /proc")
def test_an_interrupted_command_continues_to_the_same_result_and_leaves_no_process():
    words = [sys.executable, KILLS, "--quick", "--kills", "3"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
