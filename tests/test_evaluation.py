"""evaluate.py: its mistakes in one line, its numbers by hand, its results the same for any number of workers."""

import csv
import importlib.util
import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import baselines
from auv_gym.scenario import PRESETS, Scenario
from auv_gym.sensors import Sensors
from baselines.command_line import run
from baselines.evaluation import metrics
from baselines.evaluation.metrics import EpisodeRecord
from baselines.evaluation.report import compare, write_atomically
from baselines.evaluation.request import Request
from baselines.evaluation.runner import Task, make_env, run_all, run_episode, run_task
from baselines.evaluation.tables import results_table

SCRIPT = Path(__file__).parents[1] / "evaluate.py"
SMALL = Scenario(name="small", sensors=Sensors(position=0.05), steps=45)
ROW = {
    "policy": str, "scenario": str, "episodes": int, "rmse_m": float, "tail_rmse_m": dict, "effort_ratio": float,
    "smoothness_ratio": float, "failures": int, "saturation": float, "return_mean": float, "seconds": float,
    "error": type(None), "warnings": list,
}  # fmt: skip


@pytest.fixture(scope="module")
def script():
    spec = importlib.util.spec_from_file_location("evaluate", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules["evaluate"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    yield module
    del sys.modules["evaluate"]


@pytest.fixture
def call(script, monkeypatch, tmp_path):
    """Run the script in-process in an empty folder and return its exit status."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["evaluate.py", *arguments])
        return run(script.main, script.PROGRAM)

    return call


@pytest.fixture
def small(tmp_path):
    file = tmp_path / "small.toml"
    SMALL.save(file)
    return str(file)


class Raising:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        raise RuntimeError("no\nidea")


class NotANumber:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full(2, np.nan, dtype=np.float32), state


@pytest.fixture
def bad_policies(monkeypatch):
    monkeypatch.setitem(baselines.POLICIES, "raising", (Raising, {}, "raises"))
    monkeypatch.setitem(baselines.POLICIES, "nan", (NotANumber, {}, "is not a number"))


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--bogus"], "--bogus"),
        (["extra"], "extra"),
        (["--episodes"], "--episodes"),
        (["--episodes", "x"], "--episodes"),
        (["--episodes", "0"], "1 or more"),
        (["--seed", "-1"], "0 or more"),
        (["--jobs", "0"], "1 or more"),
        (["--policy", "nobody"], "allowed are backstepping"),
        (["--suite", "nothing"], "allowed are presets, paper"),
        (["--scenario", "nowhere"], "allowed are a .toml or .json file, or one of paper-circle"),
        (["--scenario", "missing.toml"], "No such file"),
        (["--scenario", "."], "unknown scenario"),
        (["--suite", "paper", "--scenario", "paper-circle"], "give one of them"),
    ],
)
def test_a_mistake_is_answered_in_one_line(call, capsys, tmp_path, arguments, says):
    assert call(*arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("evaluate.py: ")
    assert err.count("\n") == 1
    assert says in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("name = ", "is not valid TOML"),
        ("colour = 1", "colour"),
        ("steps = 0", "steps"),
        ('[path]\nfamily = "circle"\nspeed = 0.1\nturn_rate = 9.0', "infeasible"),
    ],
)
def test_a_wrong_scenario_file_is_answered_in_one_line(call, capsys, tmp_path, text, says):
    (tmp_path / "wrong.toml").write_text(text)
    assert call("--scenario", "wrong.toml") == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert says in err


def test_two_scenarios_of_one_name_are_refused(call, capsys, tmp_path, small):
    SMALL.changed(control_dt=0.2).save(tmp_path / "other.json")
    assert call("--scenario", small, "other.json") == 2
    assert "'small'; rename" in capsys.readouterr().err


def test_out_must_be_a_folder(call, capsys, tmp_path):
    (tmp_path / "file").touch()
    assert call("--out", "file") == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "--out" in err


def test_as_a_process():
    def process(*arguments):
        return subprocess.run(
            [sys.executable, str(SCRIPT), *arguments], cwd=SCRIPT.parent, capture_output=True, text=True, check=False
        )

    wrong = process("--episodes", "0")
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert wrong.stderr == "evaluate.py: --episodes is 0; it must be 1 or more\n"
    right = process("--help")
    assert (right.returncode, right.stderr) == (0, "")
    assert "--episodes" in right.stdout


def without_seconds(file):
    record = json.loads(file.read_text())
    for row in record["results"]:
        assert row.pop("seconds") > 0
    return record


def test_results_are_the_same_for_any_number_of_jobs(call, small, tmp_path, capsys):
    """Twelve episodes make three tasks, which two workers finish in any order."""
    common = ("--policy", "open-loop", "--scenario", small, "--episodes", "12", "--seed", "3")
    for jobs in ("1", "2"):
        assert call(*common, "--jobs", jobs, "--out", jobs) == 0
    one, two = (without_seconds(tmp_path / jobs / "results.json") for jobs in ("1", "2"))
    assert one == two
    for name in ("tail_error", "error_over_time", "trajectories"):
        assert (tmp_path / "1" / f"{name}.png").read_bytes() == (tmp_path / "2" / f"{name}.png").read_bytes()
    assert "open-loop" in capsys.readouterr().out


def strict_json(text):
    def refuse(name):
        raise AssertionError(f"{name} is not JSON")

    return json.loads(text, parse_constant=refuse)


def test_results_files(call, small, tmp_path, capsys):
    assert call("--scenario", small, "--policy", "backstepping", "open-loop", "--jobs", "1", "--episodes", "3") == 0
    assert "tail [m]" in capsys.readouterr().out
    folder = tmp_path / "runs" / "evaluate"
    record = strict_json((folder / "results.json").read_text())
    assert (record["suite"], record["seed"]) == (None, 0)
    assert len(record["suite_hash"]) == 64
    assert set(record["versions"]) == {"python", "numpy", "scipy", "gymnasium", "auv_gym"}
    expert, other = record["results"]
    assert (expert["policy"], other["policy"]) == ("backstepping", "open-loop")
    assert expert["effort_ratio"] == expert["smoothness_ratio"] == 1
    assert other["effort_ratio"] < 1
    for row in record["results"]:
        assert {key: type(value) for key, value in row.items()} == ROW
        low, high = row["tail_rmse_m"]["ci95"]
        assert low <= row["tail_rmse_m"]["mean"] <= high
    lines = list(csv.DictReader((folder / "results.csv").read_text().splitlines()))
    assert [float(line["tail_rmse_m"]) for line in lines] == [r["tail_rmse_m"]["mean"] for r in record["results"]]
    assert not [file for file in folder.iterdir() if file.name.startswith(".")]


def test_one_episode_has_no_interval(call, small, tmp_path):
    assert call("--scenario", small, "--jobs", "1", "--episodes", "1", "--out", "one") == 0
    (row,) = strict_json((tmp_path / "one" / "results.json").read_text())["results"]
    assert row["tail_rmse_m"]["ci95"] == [None, None]


def test_a_failing_policy_costs_its_own_row_only(call, small, tmp_path, capsys, bad_policies):
    assert (
        call("--scenario", small, "--policy", "raising", "nan", "--jobs", "1", "--episodes", "6", "--out", "bad") == 1
    )
    expert, raising, nan = strict_json((tmp_path / "bad" / "results.json").read_text())["results"]
    assert expert["error"] is None
    assert expert["episodes"] == 6
    assert raising["error"] == "seed 0: RuntimeError: no idea"
    assert "two finite numbers" in nan["error"]
    for row in (raising, nan):
        assert all(row[key] is None for key in ROW if key not in ("policy", "scenario", "error", "warnings"))
    out, err = capsys.readouterr()
    assert out.count("failed") == 2
    assert "failed: raising in small, seed 0: RuntimeError: no idea" in err
    assert len((tmp_path / "bad" / "results.csv").read_text().splitlines()) == 4


def test_results_that_cannot_be_written_are_a_failure(call, small, monkeypatch, capsys):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("baselines.evaluation.command.write_atomically", full)
    assert call("--scenario", small, "--jobs", "1", "--episodes", "1") == 1
    assert "No space left on device" in capsys.readouterr().err


def test_an_unfinished_file_leaves_no_trace(tmp_path, monkeypatch):
    file = tmp_path / "results.json"
    write_atomically(file, "old")
    monkeypatch.setattr(Path, "replace", lambda *_: (_ for _ in ()).throw(OSError("full")))
    with pytest.raises(OSError, match="full"):
        write_atomically(file, "new")
    assert file.read_text() == "old"
    assert list(tmp_path.iterdir()) == [file]


def test_interruption_is_no_traceback(monkeypatch, capsys):
    def command(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(sys, "argv", ["evaluate.py"])
    assert run(command, "evaluate.py") == 1
    assert capsys.readouterr().err == "evaluate.py: interrupted\n"


def test_default_is_every_preset_and_the_expert(tmp_path):
    request = Request.of((), None, (), 20, 0, None, tmp_path / "new" / "folder")
    assert (request.suite, request.policies) == ("presets", ("backstepping",))
    assert [scenario.name for scenario in request.scenarios] == list(PRESETS)
    assert request.jobs in (1, 2)
    assert request.out.is_dir()


def test_hash_tells_tasks_apart(tmp_path):
    hashes = {
        Request.of((), None, scenarios, episodes, seed, jobs, tmp_path).hash
        for scenarios, episodes, seed, jobs in (
            (("slow-calm",), 5, 0, 1),
            (("slow-calm", "slow-calm"), 5, 0, 2),
            (("slow-noise",), 5, 0, 1),
            (("slow-calm",), 6, 0, 1),
            (("slow-calm",), 5, 1, 1),
        )
    }
    assert len(hashes) == 4


def test_policies_meet_the_same_episodes():
    """Paired seeds: start and reference of an episode do not depend on the policy, nor on the episodes before."""
    scenario = PRESETS["slow-storm"]
    together = run_task(Task("backstepping", scenario, (4, 5), keep_track=False))
    alone, other = (run_task(Task(p, scenario, (5,), keep_track=True)) for p in ("backstepping", "open-loop"))
    np.testing.assert_array_equal(together.records[1].errors, alone.records[0].errors)
    np.testing.assert_array_equal(alone.records[0].track.position[0], other.records[0].track.position[0])
    shorter = min(len(run.records[0].track.reference) for run in (alone, other))
    a, b = (run.records[0].track.reference[:shorter] for run in (alone, other))
    np.testing.assert_array_equal(a, b)


def test_runs_come_scenario_by_scenario_with_progress():
    seen, episodes = [], []
    policies, scenarios = ("backstepping", "open-loop"), (SMALL, PRESETS["slow-calm"])
    runs = run_all(policies, scenarios, 6, 7, 1, seen.append, episodes.append)
    assert [(run.scenario.name, run.policy) for run in runs] == [(s.name, p) for s in scenarios for p in policies]
    assert seen == runs
    assert sum(episodes) == 24
    assert [record.seed for record in runs[0].records] == list(range(7, 13))


def test_an_episode_is_measured_as_the_environment_reports_it():
    record = run_episode(make_env(SMALL), baselines.make_policy("open-loop"), 3, keep_track=True)
    assert record.errors.shape == (45,)
    assert record.actions.shape == (45, 2)
    assert record.track.position.shape == record.track.reference.shape == (46, 2)
    distance = np.linalg.norm(record.track.position - record.track.reference, axis=1)
    np.testing.assert_allclose(distance[1:], record.errors, rtol=1e-12)


def test_a_lost_episode_ends():
    scenario = Scenario(name="lost", lost_distance=0.5, steps=100, start=PRESETS["paper-circle"].start)
    record = run_episode(make_env(scenario), baselines.make_policy("backstepping"), 0)
    assert record.lost
    assert len(record.errors) < 100


def test_warnings_of_a_policy_are_kept():
    part = run_task(Task("backstepping-paper", PRESETS["cruise-calm"], (0,), keep_track=False))
    assert part.error is None
    assert "stable up to" in part.warnings[0]


def record(errors, actions, lost=False, saturated=0, total=1.0):
    return EpisodeRecord(0, np.array(errors), np.array(actions), saturated, total, lost, 0.5)


def test_metrics_by_hand():
    assert metrics.rmse(np.array([3.0, 4.0])) == pytest.approx(math.sqrt(12.5))
    assert metrics.tail_rmse(np.array([9.0, 9.0, 1.0, 1.0, 1.0, 7.0])) == pytest.approx(math.sqrt(52 / 4))
    assert metrics.tail_rmse(np.array([9.0, 1.0, 1.0, 1.0, 1.0])) == 1.0  # floor(5/3) = 1 step is left out
    assert metrics.effort(np.array([[1.0, 0.0], [0.5, 0.5]])) == pytest.approx(1.5 / 4)
    assert metrics.smoothness(np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])) == pytest.approx(5 / 4)
    assert metrics.smoothness(np.array([[1.0, 1.0]])) == 0
    np.testing.assert_array_equal(metrics.padded(np.array([1.0, 2.0]), 4), [1, 2, 2, 2])
    assert metrics.ratio(3.0, 2.0) == 1.5
    assert math.isnan(metrics.ratio(3.0, 0.0))


def test_summary_by_hand():
    kept = record([6.0, 3.0, 4.0], [[0.0, 0.0], [0.0, 0.0], [0.0, 2.0]], saturated=1, total=2.0)
    lost = record([1.0, 5.0], [[1.0, 1.0], [1.0, 1.0]], lost=True, saturated=2, total=0.0)
    s = metrics.summarise([kept, lost], 3)
    tail = math.sqrt(12.5), 5.0  # the lost one is padded with its last error
    assert s.tail_rmse_m.mean == pytest.approx(np.mean(tail))
    assert s.tail_rmse_m.p95 == pytest.approx(tail[0] + 0.95 * (tail[1] - tail[0]))
    assert s.rmse_m == pytest.approx((math.sqrt(61 / 3) + math.sqrt(51 / 3)) / 2)
    assert s.effort == pytest.approx((4 / 6 + 1) / 2)
    assert s.smoothness == pytest.approx((4 / 4 + 0) / 2)
    assert (s.episodes, s.failures, s.return_mean, s.seconds) == (2, 1, 1.0, 1.0)
    assert s.saturation == pytest.approx(3 / 5)


def test_bootstrap_interval():
    values = np.random.default_rng(1).normal(5.0, 1.0, 400).tolist()
    low, high = metrics.bootstrap_interval(values)
    assert (low, high) == metrics.bootstrap_interval(values)
    assert high - low == pytest.approx(2 * 1.96 / 20, rel=0.15)
    assert low < np.mean(values) < high
    assert metrics.bootstrap_interval([2.0, 2.0, 2.0]) == (2.0, 2.0)
    assert all(math.isnan(end) for end in metrics.bootstrap_interval([2.0]))


def test_saved_scenario_is_the_one_evaluated(small, tmp_path):
    assert Request.of((), None, (small,), 1, 0, 1, tmp_path).scenarios == (SMALL,)


def test_table_fits_a_narrow_terminal(capsys):
    results = compare(run_all(("backstepping", "backstepping-normalised"), (SMALL,), 2, 0, 1, lambda _: None))
    for width, interval in ((80, False), (160, True)):
        Console(width=width).print(results_table(results, Console(width=width)))
        out = capsys.readouterr().out
        assert max(map(len, out.splitlines())) <= width
        assert "backstepping-normalised" in out
        assert "0 of 2" in out
        assert ("95 % interval" in out) is interval


def test_no_torch_is_imported():
    code = (
        "import sys, evaluate, baselines.evaluation.command, baselines.evaluation.plots\n"
        "sys.exit(not {'torch', 'pygame', 'matplotlib.pyplot'}.isdisjoint(sys.modules))"
    )
    subprocess.run([sys.executable, "-c", code], cwd=SCRIPT.parent, check=True)
