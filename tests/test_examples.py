"""The examples and the notebooks: each library has a script and a row of the page, and they run."""

import json
import os
import re
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


def output_of(words, folder):
    """Run Python in a folder, where the commands of its environment are in the path, and return what it prints."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, *map(str, words)]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_an_example_with_an_installed_library_runs(tmp_path):
    assert "works: " in output_of([SCRIPTS / "with_sb3.py", "--quick"], tmp_path)


def script(notebook):
    """Return the code cells as a script, in which shell lines are calls, without the cell of the installation."""
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    install, *code = ("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    assert install.startswith("%pip install")
    call = r"import subprocess; subprocess.run('\1', shell=True, check=True)"
    return re.sub(r"^!(.*)$", call, "\n".join(code), flags=re.MULTILINE)


@pytest.mark.slow
@pytest.mark.parametrize("notebook", sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")), ids=lambda path: path.stem)
def test_notebook_runs(notebook, tmp_path):
    (tmp_path / "script.py").write_text(script(notebook), encoding="utf-8")
    printed = output_of(["-W", "error", "script.py"], tmp_path)
    errors = dict(re.findall(r"^(\w+) +([\d.]+) cm, \d+ of 20 failed$", printed, re.MULTILINE))
    assert float(errors["helm"]) < float(errors["ekf"]) < float(errors["backstepping"])


@pytest.mark.filterwarnings(r"ignore:.torch\.jit:DeprecationWarning")  # d3rlpy writes TorchScript
def test_a_network_is_a_policy_for_evaluation(tmp_path, monkeypatch):
    """`make_policy` loads the file that `write_policy` writes."""
    monkeypatch.syspath_prepend(str(SCRIPTS))
    import torch
    from offline_policy import write_policy

    from baselines import run_episode

    name = write_policy(torch.jit.trace(torch.nn.Linear(18, 2), torch.zeros(1, 18)), Path(tmp_path, "made"))
    assert len(run_episode(name, "cruise-calm").rewards) > 0
