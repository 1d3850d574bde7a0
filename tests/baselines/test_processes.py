"""Real processes: a worker that ends, a full device, a second process in a folder, checkpoints of other code."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from auv_gym.scenarios.presets import PRESETS
from baselines.tools.command_line import THREADS, UsageError, run
from baselines.training.config import Config
from baselines.training.run_folder import LOCK, RunFolder, TrainingError, locked

ROOT = Path(__file__).parents[2]
SMALL = replace(PRESETS["cruise-calm"], name="small", steps=15)
CONFIG = Config("ppo", ((SMALL, 1.0),))
ENVIRONMENT = os.environ | {"PYTHONPATH": str(ROOT)}


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_output_to_a_full_device_is_one_line(tmp_path):
    SMALL.save(tmp_path / "small.toml")
    words = "--scenario small.toml --episodes 1 --jobs 1 --out out"
    command = [sys.executable, str(ROOT / "evaluate.py"), *words.split()]
    with open("/dev/full", "w") as full:  # noqa: PTH123
        pipes = {"stdout": full, "stderr": subprocess.PIPE}
        process = subprocess.run(command, env=ENVIRONMENT, text=True, cwd=tmp_path, check=False, **pipes)
    assert process.returncode == 1
    assert "Traceback" not in process.stderr
    assert "Exception ignored" not in process.stderr
    assert "No space left on device" in process.stderr.splitlines()[-1]


def test_a_folder_belongs_to_one_process_until_that_is_gone(tmp_path):
    code = "import sys; from pathlib import Path; from baselines.training.run_folder import locked\n"
    code += "with locked(Path('run')): print('held', flush=True); sys.stdin.read()"
    holder = subprocess.Popen(
        [sys.executable, "-c", code], cwd=tmp_path, env=ENVIRONMENT, stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    try:
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(UsageError, match=r"another training writes to .*run; wait"), locked(tmp_path / "run"):
            pass
    finally:
        holder.kill()
        holder.communicate()
    with locked(tmp_path / "run"):
        assert [file.name for file in (tmp_path / "run").iterdir()] == [LOCK]


@pytest.mark.parametrize(("value", "expected"), [(None, {1}), ("2", {2}), ("2,4", {2}), ("many", set())])
def test_a_command_uses_one_thread_by_default(value, expected, monkeypatch, capsys):
    threads = set()
    monkeypatch.setattr(sys, "argv", ["it"])
    monkeypatch.setenv(THREADS, value or "")
    if value is None:
        monkeypatch.delenv(THREADS)
    with threadpool_limits(3):
        status = run(lambda _: threads.update(pool["num_threads"] for pool in threadpool_info()) or 0, "it")
    assert threads == expected
    assert status == (0 if expected else 2)
    assert ("OMP_NUM_THREADS is 'many'; it must be an integer" in capsys.readouterr().err) == bool(status)


def test_a_lost_worker_is_one_line(tmp_path):
    code = (
        "import os, sys; from baselines.tools.command_line import run; from baselines.tools.workers import Workers\n"
        "sys.exit(run(lambda _: list(Workers(2).results(os._exit, [(3,), (3,)])) or 0, 'it'))"
    )
    process = subprocess.run([sys.executable, "-c", code], env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert process.returncode == 1
    assert process.stderr.startswith("it: a worker process ended unexpectedly")
    assert "Traceback" not in process.stderr  # joblib may warn that another process has removed its folder first


def test_a_checkpoint_of_other_code_is_refused(tmp_path, monkeypatch):
    begun = RunFolder(CONFIG, tmp_path)
    begun.log(10, score=0.5)
    begun.save_checkpoint({"timesteps": 10, "numbers": [1.0, 2.0]})
    begun.close()
    run = RunFolder(CONFIG, tmp_path)
    assert run.load_checkpoint()["numbers"] == [1.0, 2.0]
    lacks = r"cannot resume from .*: KeyError: 'vehicle_names'; start again in another folder"
    with pytest.raises(TrainingError, match=lacks), run.restoring():
        run.load_checkpoint()["vehicle_names"]
    monkeypatch.setattr("baselines.training.run_folder.code_digest", lambda: bytes(32))
    with pytest.raises(TrainingError, match=r"cannot resume from .*: .* the code of .* has changed since"):
        RunFolder(CONFIG, tmp_path).load_checkpoint()
