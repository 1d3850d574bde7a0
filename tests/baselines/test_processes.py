"""Real processes: what a signal, a full device, a second process and other damage leave behind."""

import os
import random
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from auv_gym.scenarios.presets import PRESETS
from baselines.tools.command_line import THREADS, UsageError, run
from baselines.training.config import Config
from baselines.training.run_folder import LOCK, RunFolder, TrainingError, locked

ROOT = Path(__file__).parents[2]
SMALL = replace(PRESETS["cruise-calm"], name="small", steps=15)
QUICK = ["--set", "n_envs=8", "n_steps=5", "hidden_size=8"]
CONFIG = Config("ppo", ((SMALL, 1.0),))


def started(program, *arguments, **options):
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    command = [sys.executable, str(ROOT / program), *arguments]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | options
    return subprocess.Popen(command, env=environment, text=True, start_new_session=True, **pipes)


def of_session(process):
    """Return the processes of a session that its first one has begun, and which are still there."""
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, session = stat.read_text().rpartition(")")[2].split()[:4]
        except OSError:
            continue
        if int(session) == process.pid and state != "Z":
            found.append(stat.parent.name)
    return found


def wait_for(condition, seconds=60):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it takes too long"
        time.sleep(0.05)


@contextmanager
def none_left(process):
    """Let a test have a process that leaves no other one behind, whatever the test does."""
    try:
        yield process
        wait_for(lambda: not of_session(process))
    finally:
        process.kill()
        for pid in of_session(process):
            os.kill(int(pid), signal.SIGKILL)
        process.communicate()


def ends_clean(process, end):
    """End a command in the middle of its work; a terminal sends its signal to all processes, others to the first."""
    if end == TERMINAL:
        os.killpg(process.pid, signal.SIGINT)
    else:
        process.send_signal(end)
    _, err = process.communicate(timeout=60)
    assert "Traceback" not in err
    assert process.returncode == (-signal.SIGKILL if end == signal.SIGKILL else 1)
    if end != signal.SIGKILL:
        noise = "resource_tracker", "warnings.warn("  # joblib may tell behind it of what it cleans up
        assert "interrupted" in [line for line in err.splitlines() if not any(word in line for word in noise)][-1], err


needs_proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes in /proc")


TERMINAL = "SIGINT to all"
"""What a terminal sends when Ctrl-C is pressed."""
ENDS = [("evaluate.py", end) for end in (signal.SIGTERM, signal.SIGINT, signal.SIGKILL, TERMINAL)]
"""For the other program one way to end of each kind is enough: signals and workers are code that both share."""
PROCESSES = 5  # the first, its two workers, and two that clean up behind it


@needs_proc
@pytest.mark.slow
@pytest.mark.parametrize(("program", "end"), [*ENDS, ("train.py", signal.SIGTERM), ("train.py", signal.SIGKILL)])
def test_no_process_is_left_behind(program, end, tmp_path):
    """Two worker processes at work; a terminal sends its signal to all of them, others go to the first alone."""
    SMALL.save(tmp_path / "small.toml")
    arguments = {
        "train.py": ["--scenario", "small.toml", *QUICK, "--seeds", "2", "--timesteps", "100000000", "--out", "out"],
        "evaluate.py": [
            "--scenario",
            "cruise-calm",
            "slow-calm",
            "--policy",
            "nmpc",
            "--episodes",
            "300",
            "--out",
            "out",
        ],
    }[program]
    with none_left(started(program, *arguments, "--jobs", "2", cwd=tmp_path)) as process:
        if program == "train.py":
            wait_for(lambda: all((tmp_path / f"out/seed-{i}/progress.csv").exists() for i in range(2)), 200)
        else:
            wait_for(lambda: len(of_session(process)) >= PROCESSES, 200)
            time.sleep(2)
        ends_clean(process, end)


@needs_proc
@pytest.mark.slow
@pytest.mark.parametrize("end", [signal.SIGKILL, TERMINAL])
def test_no_process_is_left_behind_of_one_training_in_two(end, tmp_path):
    SMALL.save(tmp_path / "small.toml")
    words = ["--scenario", "small.toml", *QUICK, "groups=2", "--timesteps", "100000000", "--jobs", "2", "--out", "out"]
    with none_left(started("train.py", "--algo", "apg", *words, cwd=tmp_path)) as process:
        wait_for((tmp_path / "out/progress.csv").exists, 200)
        wait_for(lambda: len(of_session(process)) >= PROCESSES - 1)
        ends_clean(process, end)


@needs_proc
def test_workers_that_still_import_leave_an_interrupt_to_the_first_process(tmp_path):
    """All but the first get one, as soon as they are there; they go on, and what they are for arrives."""
    code = (
        "import sys, time; from baselines.tools.command_line import run; from baselines.tools.workers import Workers\n"
        "sys.exit(run(lambda _: list(Workers(2).results(time.sleep, [(2.0,), (2.0,)])) and 0, 'it'))"
    )
    (tmp_path / "it.py").write_text(code, encoding="utf-8")
    process = started(tmp_path / "it.py")
    try:
        wait_for(lambda: len(of_session(process)) >= PROCESSES, 200)
        for pid in of_session(process):
            if int(pid) != process.pid:
                os.kill(int(pid), signal.SIGINT)
        _, err = process.communicate(timeout=200)
        assert (process.returncode, err) == (0, "")
    finally:
        process.kill()
        process.communicate()


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("program", ["train.py", "evaluate.py"])
def test_output_to_a_full_device_is_one_line(program, tmp_path):
    SMALL.save(tmp_path / "small.toml")
    arguments = {
        "train.py": ["--scenario", "small.toml", *QUICK, "--timesteps", "80", "--out", "out"],
        "evaluate.py": ["--scenario", "small.toml", "--episodes", "1", "--jobs", "1", "--out", "out"],
    }[program]
    with open("/dev/full", "w") as full:  # noqa: PTH123
        process = started(program, *arguments, cwd=tmp_path, stdout=full)
        _, err = process.communicate(timeout=300)
    assert process.returncode == 1
    assert "Traceback" not in err
    assert "Exception ignored" not in err
    assert "No space left on device" in err.splitlines()[-1]


def test_a_folder_belongs_to_one_process_until_that_is_gone(tmp_path):
    code = "import sys; from pathlib import Path; from baselines.training.run_folder import locked\n"
    code += "with locked(Path('run')): print('held', flush=True); sys.stdin.read()"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    holder = subprocess.Popen(
        [sys.executable, "-c", code], cwd=tmp_path, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE
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


def test_a_file_system_without_locks_is_refused(tmp_path, monkeypatch):
    def acquire(self, **_):
        raise NotImplementedError

    monkeypatch.setattr("filelock.FileLock.acquire", acquire)
    with pytest.raises(UsageError, match="has no locks; choose a folder on another one"), locked(tmp_path):
        pass


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    """A run's folder with a checkpoint, and the bytes of the latter."""
    import torch

    folder = tmp_path_factory.mktemp("run")
    made = RunFolder(CONFIG, folder)
    made.log(10, score=0.5)
    made.save_checkpoint({"timesteps": 10, "weights": torch.arange(100.0), "name": "x" * 50})
    made.close()
    return folder, (folder / "checkpoint.pt").read_bytes()


def test_no_single_bit_of_a_checkpoint_can_change_unnoticed(checkpoint):
    folder, content = checkpoint
    assert RunFolder(CONFIG, folder).load_checkpoint()["name"] == "x" * 50
    rng = random.Random(0)
    for bit in [0, len(content) * 8 - 1, *(rng.randrange(len(content) * 8) for _ in range(300))]:
        damaged = bytearray(content)
        damaged[bit // 8] ^= 1 << bit % 8
        (folder / "checkpoint.pt").write_bytes(damaged)
        with pytest.raises(TrainingError, match=r"cannot resume from .*: it is damaged, its SHA-256 differs; start"):
            RunFolder(CONFIG, folder).load_checkpoint()
    (folder / "checkpoint.pt").write_bytes(content)


@pytest.mark.parametrize("left", [b"", b"x", None])
def test_half_a_checkpoint_is_refused(checkpoint, left):
    folder, content = checkpoint
    (folder / "checkpoint.pt").write_bytes(content[:500] if left is None else left)
    with pytest.raises(TrainingError, match="it is damaged"):
        RunFolder(CONFIG, folder).load_checkpoint()
    (folder / "checkpoint.pt").write_bytes(content)


@pytest.mark.parametrize(
    "text",
    ["timesteps,score\n10,1,2,3\n", "timesteps\nmany\n", "a\n1\n", "", "timesteps,loss\n11,1\n", 'timesteps\n"1'],
)
def test_damaged_progress_is_refused(checkpoint, text):
    folder, _ = checkpoint
    before = (folder / "progress.csv").read_bytes()
    (folder / "progress.csv").write_text(text)
    with pytest.raises(TrainingError, match=r"progress.csv is damaged"):
        RunFolder(CONFIG, folder).load_checkpoint()
    (folder / "progress.csv").write_bytes(before)


def test_a_folder_that_another_training_took_first_is_left_alone(checkpoint):
    folder, _ = checkpoint
    with pytest.raises(TrainingError, match="holds another training"):
        RunFolder(replace(CONFIG, seed=1), folder)


def threads_of(monkeypatch, value):
    """Return the threads of NumPy's libraries in a command, and what it leaves in the environment."""
    from threadpoolctl import threadpool_info, threadpool_limits

    found = []
    monkeypatch.setattr(sys, "argv", ["it"])
    if value is None:
        monkeypatch.delenv(THREADS, raising=False)
    else:
        monkeypatch.setenv(THREADS, value)
    before = threadpool_limits(3)
    try:
        status = run(lambda _: found.extend(pool["num_threads"] for pool in threadpool_info()) or 0, "it")
    finally:
        before.restore_original_limits()
    return status, set(found), os.environ[THREADS]


def test_a_command_uses_one_thread_by_default(monkeypatch, capsys):
    assert threads_of(monkeypatch, None) == (0, {1}, "1")
    assert threads_of(monkeypatch, "2") == (0, {2}, "2")
    assert threads_of(monkeypatch, "2,4") == (0, {2}, "2,4")
    for wrong in ("0", "many", ""):
        assert threads_of(monkeypatch, wrong) == (2, set(), wrong)
        assert f"it: OMP_NUM_THREADS is '{wrong}'; it must be an integer" in capsys.readouterr().err


def test_a_lost_worker_is_one_line(tmp_path):
    code = (
        "import os, sys; from baselines.tools.command_line import run; from baselines.tools.workers import Workers\n"
        "sys.exit(run(lambda _: list(Workers(2).results(os._exit, [(3,), (3,)])) or 0, 'it'))"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert process.returncode == 1
    assert process.stderr.startswith("it: a worker process ended unexpectedly")
    assert process.stderr.count("\n") == 1


def test_a_checkpoint_of_other_code_is_refused(tmp_path, monkeypatch):
    run = RunFolder(CONFIG, tmp_path / "run")
    run.log(10, score=0.5)
    run.save_checkpoint({"timesteps": 10, "numbers": [1.0, 2.0]})
    run.close()
    assert RunFolder(CONFIG, tmp_path / "run").load_checkpoint()["numbers"] == [1.0, 2.0]
    monkeypatch.setattr("baselines.training.checkpoint.code_digest", lambda: bytes(32))
    with pytest.raises(TrainingError, match=r"cannot resume from .*: the code of .* has changed since"):
        RunFolder(CONFIG, tmp_path / "run").load_checkpoint()


def test_what_a_trainer_misses_in_a_checkpoint_is_one_line(checkpoint):
    run = RunFolder(CONFIG, checkpoint[0])
    with (
        pytest.raises(
            TrainingError, match=r"cannot resume from .*: it has no 'vehicle_names'; start again in another folder"
        ),
        run.restoring(),
    ):
        run.load_checkpoint()["vehicle_names"]
