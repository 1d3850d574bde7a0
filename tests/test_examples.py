"""The examples: each library has a script and a row of the page."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from examples.__main__ import EXAMPLES, PAGE, ROOT, main

SCRIPTS = ROOT / "examples"


def test_every_example_has_a_script_and_every_script_an_example():
    assert {file.stem.removeprefix("with_") for file in SCRIPTS.glob("with_*.py")} == set(EXAMPLES)


def test_the_page_has_a_row_for_each_example():
    for name, example in EXAMPLES.items():
        (row,) = (line for line in PAGE.read_text(encoding="utf-8").splitlines() if f"`with_{name}.py`" in line)
        title, versions = row.strip("| ").split(" | ")[:2]
        assert title == example.title
        assert {each.split(" ")[0] for each in versions.split(", ")} == {*example.packages, "gymnasium"}


def test_an_unknown_example_is_refused(capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["nothing"])
    assert "unknown example 'nothing'; allowed are sb3" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sb3"])
def test_examples_with_installed_libraries_run(name, tmp_path):
    done = subprocess.run(
        [sys.executable, str(SCRIPTS / f"with_{name}.py"), "--quick"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "works: " in done.stdout


@pytest.mark.filterwarnings(r"ignore:.torch\.jit:DeprecationWarning")  # d3rlpy writes TorchScript
def test_a_network_is_a_policy_for_evaluation(tmp_path, monkeypatch):
    """`make_policy` loads the file that `write_policy` writes."""
    monkeypatch.syspath_prepend(str(SCRIPTS))
    import torch
    from offline_policy import write_policy

    from baselines import run_episode

    name = write_policy(torch.jit.trace(torch.nn.Linear(18, 2), torch.zeros(1, 18)), Path(tmp_path, "made"))
    assert len(run_episode(name, "cruise-calm").rewards) > 0
