"""Where tasks run: the same results from this process, worker processes and a pool of Ray's kind; clear refusals."""

import json
import multiprocessing.pool
import socket
import sys

import pytest

import evaluate
from baselines.tools.command_line import UsageError, WorkerError, run
from baselines.tools.workers import DEFAULT_JOBS, ClusterError, Workers, connect


def power(base, exponent):
    return base**exponent


@pytest.mark.parametrize("workers", [Workers(), Workers(2), Workers(3, on_cluster=True)])
def test_results_are_the_same_everywhere(ray, workers):
    tasks = [(base, exponent) for base in range(5) for exponent in range(3)]
    assert sorted(workers.results(power, tasks)) == sorted(power(*task) for task in tasks)
    assert list(workers.results(power, [])) == []


def test_an_evaluation_on_a_cluster_is_that_of_one_machine(ray, tmp_path):
    common = ["--scenario", "slow-calm", "--policy", "open-loop", "--episodes", "2", "--out"]
    assert evaluate.main([*common, str(tmp_path / "a"), "--jobs", "1"]) == 0
    assert evaluate.main([*common, str(tmp_path / "b"), "--cluster", "local"]) == 0
    assert ray.addresses == ["local"]
    a, b = (json.loads((tmp_path / name / "results.json").read_text())["results"] for name in "ab")
    for row in (*a, *b):
        del row["seconds"], row["decision_ms"]
    assert a == b


def dying_pool(times):
    """Return a pool whose first ones lose a machine after two results, so many of them."""
    made = []

    class Pool(multiprocessing.pool.ThreadPool):
        def imap_unordered(self, *arguments, **options):
            made.append(self)
            for i, result in enumerate(super().imap_unordered(*arguments, **options)):
                if i == 2 and len(made) <= times:
                    raise RuntimeError("the actor\ndied")
                yield result

    return Pool


def test_what_a_dead_machine_had_in_hand_is_tried_once_more(ray, monkeypatch, tmp_path, capsys):
    tasks = [(base, 2) for base in range(7)]
    for times in (0, 1):
        monkeypatch.setattr(sys.modules["ray.util.multiprocessing"], "Pool", dying_pool(times))
        assert sorted(Workers(3, on_cluster=True).results(power, tasks)) == [base**2 for base in range(7)]
    monkeypatch.setattr(sys.modules["ray.util.multiprocessing"], "Pool", dying_pool(2))
    with pytest.raises(WorkerError, match="failed twice, with 3 tasks left: RuntimeError: the actor died"):
        list(Workers(3, on_cluster=True).results(power, tasks))
    monkeypatch.setattr(sys.modules["ray.util.multiprocessing"], "Pool", dying_pool(2))
    common = ["--scenario", "slow-calm", "cruise-calm", "slow-noise", "--policy", "open-loop", "--episodes", "1"]
    monkeypatch.setattr(sys, "argv", ["evaluate.py", *common, "--cluster", "local", "--out", str(tmp_path)])
    assert run(evaluate.main, "evaluate.py") == 1
    assert capsys.readouterr().err.splitlines()[-1].startswith("evaluate.py: the Ray cluster failed twice, with 2")


def test_an_address_that_answers(ray, monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as server:
        address = f"127.0.0.1:{server.getsockname()[1]}"
        assert connect(address) == 3
        assert connect(f"ray://{address}") == 3
        ray.locked = True
        with pytest.raises(ClusterError, match="set RAY_AUTH_TOKEN"):
            connect(address)
        ray.silent = 0.3
        monkeypatch.setattr("baselines.tools.workers.JOINING", 0.05)
        with pytest.raises(ClusterError, match=r"no answer within 0.05 s"):
            connect(address)
        ray.silent = 0.0
    with pytest.raises(ClusterError, match="cannot reach the Ray cluster 127"):
        connect(address)
    assert ray.addresses == [address, f"ray://{address}"]


def test_workers_of_a_command_line(ray):
    assert Workers.of(None, None) == Workers(DEFAULT_JOBS)
    assert Workers.of(5, None) == Workers(5)
    assert Workers.of(None, "local") == Workers(3, on_cluster=True)
    assert Workers.of(2, "local") == Workers(2, on_cluster=True)
    with pytest.raises(ValueError, match="--jobs is 0; it must be 1 or more"):
        Workers.of(0, "local")


def test_words_that_are_no_text_are_refused(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["evaluate.py", "--out", "a\udcff"])
    assert run(evaluate.main, evaluate.PROGRAM) == 2
    says = "evaluate.py: 'a\\udcff' holds characters that cannot be printed; leave them out\n"
    assert capsys.readouterr().err == says


@pytest.mark.parametrize("address", ["nonsense", "nowhere:x", "host:99999", ":1"])
def test_an_address_that_is_none(ray, address):
    with pytest.raises(ClusterError, match="cannot reach the Ray cluster"):
        connect(address)


def test_ray_fails_or_is_missing(ray, monkeypatch, tmp_path):
    with pytest.raises(ClusterError, match="cannot use the Ray cluster auto"):
        connect("auto")
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(UsageError, match=r"pip install 'auv-gym\[cluster\]'"):
        evaluate.main(["--cluster", "local", "--scenario", "slow-calm", "--out", str(tmp_path)])
