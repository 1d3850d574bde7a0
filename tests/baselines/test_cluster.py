"""Evaluations and trainings on a Dask cluster of this machine: the same bits, also if a worker is killed."""

import gc
import json
import os
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from distributed import Client

from baselines.agents.agent import WEIGHTS
from baselines.evaluation import command as evaluation
from baselines.evaluation.results import ResultFile
from baselines.tools.command_line import WorkerError
from baselines.tools.workers import Workers
from baselines.training import command as training

SLOW = """
import time

import numpy as np
from auv_gym import decode_observation


class Slow:
    def predict(self, observation, *_, **__):
        time.sleep(0.004)
        o = decode_observation(observation)
        action = np.stack(((o.F_uR - 60 * o.e_x) / o.F_u_max, (o.F_rR - 200 * o.psi_e - 150 * o.r_e) / o.F_r_max), -1)
        return np.clip(action, -1, 1), None
"""


TINY = "--algo ppo --scenario tiny.toml --timesteps 512 --set n_envs=8 n_steps=16 batch_size=64"


def tiny(folder):
    text = 'name = "tiny"\nsteps = 15\n\n[path]\nspeed = 1.0\nturn_rate = 0.1\n'
    (folder / "tiny.toml").write_text(text, encoding="utf-8")


def dask(*arguments):
    """Start a part of the cluster; its processes end with it."""
    return subprocess.Popen(
        [sys.executable, "-m", "dask", *arguments], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    """The file of a scheduler with two workers, in another folder than the caller, and the workers."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "away").mkdir()
    file = str(tmp_path / "scheduler.json")
    local = "--host", "127.0.0.1"
    scheduler = dask("scheduler", *local, "--port", "0", "--no-dashboard", "--scheduler-file", file)
    options = "--nthreads", "1", "--no-nanny", "--no-dashboard", "--scheduler-file", file
    workers = [dask("worker", *local, *options, "--local-directory", str(tmp_path / "away")) for _ in range(2)]
    with Client(scheduler_file=file, set_as_default=False, timeout=60) as client:
        client.wait_for_workers(2, timeout=60)
    yield file, workers
    for process in (*workers, scheduler):
        process.terminate()
        process.wait(30)


def measured(folder):
    return {run.key: run.measures for run in ResultFile.read(Path(folder, "results.npz")).runs}


def test_the_workers_of_a_cluster_give_the_same_bits_also_if_one_is_killed(cluster, tmp_path):
    file, workers = cluster
    Path("slow.py").write_text(SLOW, encoding="utf-8")
    words = ["--policy", "slow.py:Slow", "helm", "--scenario", "cruise-calm", "cruise-current", "slow-storm"]
    words += ["--episodes", "4", "--step-limit", "1"]
    assert evaluation.main([*words, "--jobs", "2", "--out", "here"]) == 0
    killer = subprocess.Popen(
        [sys.executable, "-c", f"import os, time; time.sleep(3); os.kill({workers[0].pid}, {int(signal.SIGKILL)})"]
    )
    assert evaluation.main([*words, "--cluster", file, "--out", "there"]) == 0
    assert killer.poll() is not None, "the cluster was faster than the kill"
    assert workers[0].wait(10) == -signal.SIGKILL
    here, there = measured("here"), measured("there")
    assert here.keys() == there.keys()
    for key, one in here.items():
        for name, values in vars(one).items():
            np.testing.assert_array_equal(getattr(there[key], name), values, err_msg=f"{key} {name}")


def test_trainings_on_a_cluster_have_the_weights_of_those_on_one_machine(cluster, tmp_path):
    file, _ = cluster
    tiny(tmp_path)
    words = [*shlex.split(TINY), "--seeds", "2"]
    assert training.main([*words, "--jobs", "1", "--out", "here"]) == 0
    assert training.main([*words, "--cluster", file, "--out", "there"]) == 0
    for seed in ("seed-0", "seed-1"):
        here, there = (Path(out, seed, "agent", WEIGHTS).read_bytes() for out in ("here", "there"))
        assert here == there


def test_the_array_job_of_the_page_trains_a_seed_and_continues_it(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "many-runs.md").read_text(encoding="utf-8")
    script = "#!/bin/bash" + page.split("```text\n#!/bin/bash")[1].split("```")[0]
    assert len(script.split("\n")) <= 15
    tiny(tmp_path)
    quick = f'auv-gym() {{ "{sys.executable}" -m baselines "$@" {TINY}; }}\n'
    (tmp_path / "job").write_text(script.replace("seed=$", f"{quick}seed=$", 1), encoding="utf-8")
    environment = {**os.environ, "SLURM_ARRAY_TASK_ID": "3"}
    for _ in range(2):
        subprocess.run(["bash", "-e", "job"], cwd=tmp_path, env=environment, check=True, capture_output=True)
    assert (tmp_path / "runs/train/storm/seed-3/agent" / WEIGHTS).exists()


def square(x):
    return os.getpid(), x * x


def test_tasks_run_in_other_processes_and_one_that_fails_raises_its_error(cluster):
    file, _ = cluster
    pids, squares = zip(*Workers(cluster=file).results(square, [(k,) for k in range(20)]), strict=True)
    assert sorted(squares) == [k * k for k in range(20)]
    assert os.getpid() not in pids
    with pytest.raises(ZeroDivisionError):
        list(Workers(cluster=json.loads(Path(file).read_text())["address"]).results(divmod, [(1, 0)]))


@pytest.mark.parametrize(
    ("cluster", "message"),
    [
        ("tcp://127.0.0.1:9", "no Dask scheduler answers at tcp://127.0.0.1:9: OSError: Timed out"),
        ("localhost", "no Dask scheduler answers at localhost: ValueError: missing port number"),
        ("empty.json", "no Dask scheduler answers at empty.json"),
        ("missing.json", "cannot read missing.json; --cluster is the file of a Dask scheduler, or its address"),
    ],
)
def test_a_cluster_that_does_not_answer_is_one_line(cluster, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("empty.json").write_text("{}")
    monkeypatch.setattr("baselines.tools.workers._ANSWER", 1)
    start = time.monotonic()
    with pytest.raises(WorkerError, match=message):
        list(Workers(cluster=cluster).results(square, [(1,)]))
    gc.collect()  # calls the destructor of the client
    assert time.monotonic() - start < 10
