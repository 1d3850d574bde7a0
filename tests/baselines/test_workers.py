"""Where tasks run: the same results from this process, worker processes and tasks of Ray's kind; clear refusals."""

import json
import socket
import sys
import threading
from contextlib import ExitStack, contextmanager, suppress

import pytest

import evaluate
from baselines.tools.command_line import UsageError, WorkerError, run
from baselines.tools.workers import DEFAULT_JOBS, SETTINGS, ClusterError, Workers, connect


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


def test_a_cluster_that_loses_a_task_for_good_is_one_line(ray, monkeypatch, tmp_path, capsys):
    def get(task):
        if len(given) == 2:
            raise RuntimeError("the node\ndied")
        given.append(task)
        return task.result()

    ray.get, given = get, []
    with pytest.raises(WorkerError, match="failed, with 5 tasks left: RuntimeError: the node died"):
        list(Workers(3, on_cluster=True).results(power, [(base, 2) for base in range(7)]))
    given.clear()
    common = ["--scenario", "slow-calm", "cruise-calm", "slow-noise", "--policy", "open-loop", "--episodes", "1"]
    monkeypatch.setattr(sys, "argv", ["evaluate.py", *common, "--cluster", "local", "--out", str(tmp_path)])
    assert run(evaluate.main, "evaluate.py") == 1
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("evaluate.py:")]
    assert lines == ["evaluate.py: the Ray cluster failed, with 4 tasks left: RuntimeError: the node died"]


@contextmanager
def answering(text):
    """Give the address of something that answers whoever connects with a text and keeps the connection."""
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer():
            with suppress(OSError), ExitStack() as held:
                while True:
                    held.enter_context(server.accept()[0]).sendall(text)

        thread = threading.Thread(target=answer)
        thread.start()
        yield f"127.0.0.1:{server.getsockname()[1]}"
        server.shutdown(socket.SHUT_RDWR)
        thread.join()


def test_an_address_that_answers(ray, monkeypatch):
    with answering(SETTINGS) as address:
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


def test_an_address_without_a_cluster(ray, monkeypatch):
    monkeypatch.setattr("baselines.tools.workers.PATIENCE", 0.1)
    with answering(b"HTTP/1.1 400 Bad Request") as address, pytest.raises(ClusterError, match="is no Ray cluster"):
        connect(address)
    with answering(b"") as address:
        with pytest.raises(ClusterError, match=r"no answer within 0.1 s"):
            connect(address)
        monkeypatch.setenv("RAY_USE_TLS", "1")
        assert connect(address) == 3
    assert ray.addresses == [address]


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
    with pytest.raises(UsageError, match=r"a cluster needs Ray: pip install .*\[cluster\]'"):
        evaluate.main(["--cluster", "local", "--scenario", "slow-calm", "--out", str(tmp_path)])
