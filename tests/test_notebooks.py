"""The notebooks run without changes, in another process and folder; the cell of the installation is left out."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def script(notebook):
    """Return the code cells as a script, in which shell lines are calls."""
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    install, *code = ("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    assert install.startswith("%pip install")
    call = r"import subprocess; subprocess.run('\1', shell=True, check=True)"
    return re.sub(r"^!(.*)$", call, "\n".join(code), flags=re.MULTILINE)


@pytest.mark.slow
@pytest.mark.parametrize("notebook", sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")), ids=lambda path: path.stem)
def test_notebook_runs(notebook, tmp_path):
    (tmp_path / "script.py").write_text(script(notebook), encoding="utf-8")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        [sys.executable, "-W", "error", "script.py"],
        cwd=tmp_path,
        env={**os.environ, "PATH": path, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=180,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    found = dict(re.findall(r"^(\w+) +([\d.]+) cm, \d+ of 20 failed$", done.stdout, re.MULTILINE))
    assert float(found["helm"]) < float(found["ekf"]) < float(found["backstepping"])
