"""On a Ray cluster of a head and two workers: `make cluster-test`. Needs the extra `cluster`, which tests do without.

Each node is a set of processes of this machine. A worker and a whole node are killed in the middle; the results are
those of one machine, to the bit.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest
from ray.cluster_utils import Cluster

from baselines.agents.agent import WEIGHTS
from baselines.tools.workers import PATIENCE, ClusterError, connect
from baselines.training.run_folder import AGENT, CHECKPOINT

ROOT = Path(__file__).parents[1]
DYING = """
import os, pathlib, signal
from baselines import make_policy

class Dying:
    def __init__(self, vehicle):
        self.law, self.steps = make_policy("backstepping", vehicle), 0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.steps += 1
        flag, name = pathlib.Path({flag!r}), pathlib.Path("/proc/self/cmdline").read_bytes()
        if self.steps == 50 and name.startswith(b"ray::") and not flag.exists():
            flag.touch()
            os.kill({victim}, signal.SIGKILL)
        return self.law.predict(observation, state, episode_start, deterministic)

def make(vehicle=None):
    return Dying(vehicle)
"""
"""A policy that once, in its 50th step on a cluster, kills its worker or that one's parent, the node."""
EPISODES = ("--scenario", "slow-storm", "cruise-storm", "slow-noise", "cruise-noise", "--episodes", "4")
PATIENT = 900.0  # [s] that a busy machine may take
TINY = 'name = "tiny"\nsteps = 15\n\n[path]\nspeed = 1.0\nturn_rate = 0.1\n'
TRAINING = ("--algo", "ppo", "--seeds", "2", "--timesteps", "5120", "--set", "n_envs=8", "n_steps=32", "batch_size=64")


@pytest.fixture(scope="module")
def environment():
    """Return the variables of the commands and of what the cluster starts."""
    slow = {"RAY_agent_register_timeout_ms": "300000", "RAY_raylet_start_wait_time_s": "300"}  # a busy machine is
    variables = {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "RAY_ENABLE_UV_RUN_RUNTIME_ENV": "0", **slow}
    with pytest.MonkeyPatch.context() as patch:
        for name, value in variables.items():
            patch.setenv(name, value)
        yield {**os.environ, **variables}


@pytest.fixture
def cluster(environment):
    """A head without processors and two workers with one each."""
    started = Cluster(initialize_head=True, head_node_args={"num_cpus": 0, "include_dashboard": False})
    try:
        for _ in range(2):
            started.add_node(num_cpus=1)
        started.wait_for_nodes()
        yield started
    finally:
        started.shutdown()


def begun(environment, name, *words):
    command = [sys.executable, "-m", "baselines", name, *map(str, words)]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def called(environment, name, *words):
    """Run a command and return how it ends and what it says on stderr."""
    process = begun(environment, name, *words)
    err = process.communicate(timeout=PATIENT)[1]
    return process.returncode, err


def results(folder):
    rows = json.loads((folder / "results.json").read_text(encoding="utf-8"))["results"]
    return [{key: value for key, value in row.items() if key not in ("seconds", "decision_ms")} for row in rows]


@pytest.mark.parametrize("victim", ["getpid", "getppid"])
def test_an_evaluation_outlives_a_worker_and_a_node(cluster, environment, victim, tmp_path):
    flag = tmp_path / "flag"
    policy = DYING.replace("{flag!r}", repr(str(flag))).replace("{victim}", f"os.{victim}()")
    (tmp_path / "dying.py").write_text(policy, encoding="utf-8")
    words = (*EPISODES, "--policy", f"{tmp_path / 'dying.py'}:make", "--out")
    status, err = called(environment, "evaluate", *words, tmp_path / "here", "--jobs", "1")
    assert (status, flag.exists()) == (0, False), err
    status, err = called(environment, "evaluate", *words, tmp_path / "there", "--cluster", cluster.address)
    assert (status, flag.exists()) == (0, True), err
    assert results(tmp_path / "there") == results(tmp_path / "here")


def workers(cluster, name):
    """Return the processes of a cluster's workers that run a task of that name."""
    nodes = {node.all_processes["raylet"][0].process.pid for node in cluster.worker_nodes}
    return [int(folder.name) for folder in Path("/proc").glob("[0-9]*") if _is_of(folder, nodes, f"ray::{name}")]


def _is_of(process, parents, name):
    with suppress(OSError):  # it has just ended
        parent = int((process / "stat").read_text().rpartition(")")[2].split()[1])
        return parent in parents and (process / "cmdline").read_bytes().startswith(name.encode())
    return False


@pytest.mark.parametrize("victim", ["worker", "node"])
def test_a_training_outlives_a_worker_and_a_node(cluster, environment, victim, tmp_path):
    here, there = tmp_path / "here", tmp_path / "there"
    (tmp_path / "tiny.toml").write_text(TINY, encoding="utf-8")
    words = (*TRAINING, "--scenario", tmp_path / "tiny.toml", "--out")
    status, err = called(environment, "train", *words, here, "--jobs", "1")
    assert status == 0, err
    process = begun(environment, "train", *words, there, "--cluster", cluster.address)
    deadline = time.monotonic() + PATIENT
    while not (own := workers(cluster, "train_one")) or not list(there.glob(f"*/{CHECKPOINT}")):
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < deadline
        time.sleep(0.05)
    if victim == "worker":
        os.kill(own[0], signal.SIGKILL)
    else:
        cluster.remove_node(cluster.worker_nodes[0], allow_graceful=False)
    err = process.communicate(timeout=PATIENT)[1]
    assert process.returncode == 0, err
    for seed in ("seed-0", "seed-1"):
        assert (there / seed / AGENT / WEIGHTS).read_bytes() == (here / seed / AGENT / WEIGHTS).read_bytes()


@pytest.mark.parametrize("name", ["evaluate", "train"])
def test_an_address_that_says_nothing_fails_soon(environment, name, tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
        status, err = called(environment, name, "--cluster", address, "--out", tmp_path / "out")
        start = time.monotonic()
        with pytest.raises(ClusterError):
            connect(address)
        assert time.monotonic() - start < 10
    assert (status, err.count("\n")) == (2, 1), err
    assert f"cannot reach the Ray cluster {address}: no answer within {PATIENCE:g} s" in err


def test_a_cluster_that_is_gone_ends_the_command(cluster, environment, tmp_path):
    process = begun(environment, "train", *TRAINING, "--out", tmp_path / "out", "--cluster", cluster.address)
    while not workers(cluster, "train_one"):
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.05)
    for node in list(cluster.worker_nodes):
        cluster.remove_node(node, allow_graceful=False)
    cluster.remove_node(cluster.head_node, allow_graceful=False)
    err = process.communicate(timeout=PATIENT)[1]
    assert process.returncode == 1
    last = err.splitlines()[-1]  # of ours, or of Ray itself, which ends a program whose head is lost for a minute
    assert "--resume goes on" in last or "Failed to connect to GCS" in last
