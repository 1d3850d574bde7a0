"""The examples: each library has a script, an entry of the record and a row of the page."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from examples.__main__ import EXAMPLES, PAGE, RECORD, ROOT, main, page_with, table

SCRIPTS = ROOT / "examples"


def test_every_example_has_a_script_and_every_script_an_example():
    assert {file.stem.removeprefix("with_") for file in SCRIPTS.glob("with_*.py")} == set(EXAMPLES)


def test_the_page_shows_the_record():
    record = json.loads(RECORD.read_text(encoding="utf-8"))
    text = PAGE.read_text(encoding="utf-8")
    assert list(record) == list(EXAMPLES), "run `make examples`"
    assert page_with(text, record) == text, "run `make examples`"
    assert len(table(record).splitlines()) == 2 + len(EXAMPLES)
    for name, entry in record.items():
        assert set(entry["versions"]) == {*EXAMPLES[name].packages, "gymnasium"}


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
