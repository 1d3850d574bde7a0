"""evaluate.py: one-line messages, numbers of other implementations, equal results for any number of workers."""

import csv
import dataclasses
import html.parser
import json
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import baselines
from auv_gym.physics.sensors import Sensors
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation import entry as evaluation
from baselines.evaluation import metrics, recorded
from baselines.evaluation.metrics import Measures
from baselines.evaluation.options import Options
from baselines.evaluation.report.numbers import compare
from baselines.evaluation.report.terminal import entries_table
from baselines.evaluation.request import Request
from baselines.evaluation.rollout import PolicyError, make_env, rollout
from baselines.evaluation.rows import RowStore
from baselines.evaluation.runner import MOST_PARALLEL, Task, drawn, run_all, runs
from baselines.tools.command_line import run
from baselines.tools.workers import Workers

SCRIPT = Path(__file__).parents[2] / "evaluate.py"
SMALL = Scenario(name="small", sensors=Sensors(position=0.05), steps=45)
ROW = {
    "policy": str, "scenario": str, "episodes": int, "rmse_m": float, "steady_rmse_m": dict, "score": type(None),
    "capped": type(None), "settling_s": float, "effort_ratio": float, "smoothness_ratio": float, "failed": int,
    "failure_rate": float, "failure_rate_bound": float, "to_best_m": dict,
    "error_ratio": type(None), "saturation": float, "return_mean": float, "seconds": float,
    "decision_ms": float, "recorded": type(None), "error": type(None), "warnings": list,
}  # fmt: skip


@pytest.fixture
def call(monkeypatch, tmp_path):
    """Run the script in-process in an empty folder and return its exit status."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["evaluate.py", *arguments])
        return run(evaluation.main, evaluation.PROGRAM)

    return call


@pytest.fixture
def small(tmp_path):
    file = tmp_path / "small.toml"
    SMALL.save(file)
    return str(file)


class Raising:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        raise RuntimeError("no\nresult")


class Vicious(BaseException):
    def __str__(self):
        raise RuntimeError("no text")


class RaisingMore:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        raise Vicious


class WithoutState:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros((len(observation), 2))


class NotANumber:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.full((len(observation), 2), np.nan, dtype=np.float32), state


class Slow:
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        time.sleep(0.05)
        return np.zeros((len(observation), 2)), state


@pytest.fixture
def bad_policies(monkeypatch):
    monkeypatch.setitem(baselines.POLICIES, "raising", (Raising, {}, "raises"))
    monkeypatch.setitem(baselines.POLICIES, "vicious", (RaisingMore, {}, "raises what has no text"))
    monkeypatch.setitem(baselines.POLICIES, "stateless", (WithoutState, {}, "returns no state"))
    monkeypatch.setitem(baselines.POLICIES, "nan", (NotANumber, {}, "is not a number"))
    monkeypatch.setitem(baselines.POLICIES, "slow", (Slow, {}, "is slow"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--bogus"], "--bogus"),
        (["extra"], "extra"),
        (["--episodes"], "--episodes"),
        (["--episodes", "x"], "--episodes"),
        (["--episodes", "0"], "1 or more"),
        (["--seed", "-1"], "0 or more"),
        (["--jobs", "0"], "1 or more"),
        (["--step-limit", "0"], "positive"),
        (["--policy", "nobody"], "allowed are backstepping"),
        (["--suite", "nothing"], "allowed are presets"),
        (["--scenario", "nowhere"], "allowed are a .toml or .json file, or one of paper-circle"),
        (["--scenario", "missing.toml"], "No such file"),
        (["--scenario", "."], "unknown scenario"),
        (["--suite", "presets", "--scenario", "paper-circle"], "give one of them"),
    ],
)
def test_a_wrong_argument_gives_a_message_of_one_line(call, capsys, tmp_path, arguments, message):
    assert call(*arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("evaluate.py: ")
    assert err.count("\n") == 1
    assert message in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = ", "is not valid TOML"),
        ("colour = 1", "colour"),
        ("steps = 0", "steps"),
        ('[path]\nfamily = "circle"\nspeed = 0.1\nturn_rate = 9.0', "infeasible"),
    ],
)
def test_a_wrong_scenario_file_gives_a_message_of_one_line(call, capsys, tmp_path, text, message):
    (tmp_path / "wrong.toml").write_text(text)
    assert call("--scenario", "wrong.toml") == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert message in err


def test_two_scenarios_of_one_name_are_refused(call, capsys, tmp_path, small):
    changed(SMALL, control_dt=0.2).save(tmp_path / "other.json")
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
        assert row.pop("decision_ms") > 0
    for row in record["pooled"]:
        assert row.pop("decision_ms") > 0
    return record


def test_results_are_the_same_for_any_number_of_jobs(call, small, tmp_path, capsys, monkeypatch):
    """There are four tasks, which two workers finish in any order."""
    monkeypatch.setattr("baselines.evaluation.runner.MOST_PARALLEL", 6)
    common = ("--policy", "open-loop", "--scenario", small, "--episodes", "12", "--seed", "3")
    for jobs in ("1", "2"):
        assert call(*common, "--jobs", jobs, "--out", jobs) == 0
    one, two = (without_seconds(tmp_path / jobs / "results.json") for jobs in ("1", "2"))
    assert one == two
    assert "open-loop" in capsys.readouterr().out


def strict_json(text):
    def refuse(name):
        raise AssertionError(f"{name} is not JSON")

    return json.loads(text, parse_constant=refuse)


def test_results_files(call, small, tmp_path, capsys):
    assert call("--scenario", small, "--policy", "backstepping", "open-loop", "--jobs", "1", "--episodes", "3") == 0
    assert "steady [m]" in capsys.readouterr().out
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
        best = row["to_best_m"] is None
        assert {key: type(value) for key, value in row.items()} == ROW | ({"to_best_m": type(None)} if best else {})
        low, high = row["steady_rmse_m"]["ci95"]
        assert low <= row["steady_rmse_m"]["mean"] <= high
    assert sum(row["to_best_m"] is None for row in record["results"]) == 1
    lines = list(csv.DictReader((folder / "results.csv").read_text().splitlines()))
    assert [float(line["steady_rmse_m"]) for line in lines] == [r["steady_rmse_m"]["mean"] for r in record["results"]]
    assert not [file for file in folder.iterdir() if file.name.startswith(".")]


class Page(html.parser.HTMLParser):
    """Collects the text of a page, and fails if the page needs other files or the network."""

    def __init__(self, text):
        super().__init__()
        self.text, self.open = "", []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        assert tag not in ("link", "iframe", "img", "object")
        assert "src" not in attributes
        assert not any(name.startswith("on") for name in attributes)
        assert not (attributes.get("href") or "").startswith("http")
        if tag not in ("meta", "input"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        pass

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


@pytest.fixture
def few_recorded(monkeypatch):
    """Recorded rows of two policies only."""
    load = recorded.load_recorded

    def few(suite):
        return recorded.Found(
            tuple(run for run in load(suite).runs if run.policy in ("los-pid", "oracle")), {"lqi": "old"}
        )

    monkeypatch.setattr(recorded, "load_recorded", few)


def test_report_is_one_page(call, small, tmp_path, bad_policies, few_recorded, capsys):
    assert call("--suite", "benchmark-v1", "--episodes", "2", "--policy", "open-loop", "--jobs", "1", "--out", "a") == 0
    page = Page((tmp_path / "a" / "report.html").read_text(encoding="utf-8"))
    assert page.open == []
    for text in (
        "score",
        "oracle*",
        "cruise-storm",
        "open-loop",
        "Definitions of the columns",
        "--episodes 2",
        "numpy",
    ):
        assert text in page.text
    record = strict_json((tmp_path / "a" / "results.json").read_text())
    live = {row["policy"] for row in record["results"] if row["recorded"] is None}
    assert live == {"backstepping", "open-loop"}
    (recorded_on,) = {row["recorded"]["date"] for row in record["results"] if row["policy"] == "oracle"}
    assert f"({recorded_on}, auv_gym 0.1.0)" in page.text
    out, err = capsys.readouterr()
    assert "note: the recorded rows of lqi are left out: old" in err
    assert re.search(rf"\* recorded, not run now: .*oracle \({recorded_on}, auv_gym 0.1.0\)", out)
    assert {(p["policy"], p["speed_range"]) for p in record["pooled"]} >= {("oracle", "slow"), ("open-loop", "cruise")}
    scores = {p["policy"]: p["score"]["mean"] for p in record["pooled"] if p["speed_range"] == "slow"}
    assert scores["backstepping"] == 0
    assert scores["oracle"] == 1
    assert call("--scenario", small, "--policy", "raising", "--jobs", "1", "--episodes", "1", "--out", "b") == 1
    page = Page((tmp_path / "b" / "report.html").read_text(encoding="utf-8"))
    assert "raising in small: RuntimeError: no result" in page.text


def test_one_episode_has_no_interval(call, small, tmp_path):
    assert call("--scenario", small, "--jobs", "1", "--episodes", "1", "--out", "one") == 0
    (row,) = strict_json((tmp_path / "one" / "results.json").read_text())["results"]
    assert row["steady_rmse_m"]["ci95"] == [None, None]


def test_a_failing_policy_does_not_affect_other_rows(call, small, tmp_path, capsys, bad_policies):
    common = ("--scenario", small, "--jobs", "1", "--episodes", "6", "--step-limit", "5e-3", "--out", "bad")
    assert call(*common, "--policy", "raising", "nan", "slow", "vicious", "stateless") == 1
    expert, raising, nan, slow, vicious, stateless = strict_json((tmp_path / "bad" / "results.json").read_text())[
        "results"
    ]
    assert expert["error"] is None
    assert expert["episodes"] == 6
    assert raising["error"] == "RuntimeError: no result"
    assert nan["error"].startswith("step 0, episode 0: action is [nan nan]; it must be two finite numbers")
    assert "allowed are 0.005 s" in slow["error"]
    assert vicious["error"] == "Vicious: its message cannot be printed"
    assert "it must return (action, state)" in stateless["error"]
    for row in (raising, nan, slow, vicious, stateless):
        assert all(row[key] is None for key in ROW if key not in ("policy", "scenario", "error", "warnings"))
    out, err = capsys.readouterr()
    assert out.count("failed") == 5
    assert "failed: raising in small, RuntimeError: no result" in err
    assert len((tmp_path / "bad" / "results.csv").read_text().splitlines()) == 7


def test_results_that_cannot_be_written_are_a_failure(call, small, monkeypatch, capsys):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("baselines.evaluation.command.write_atomically", full)
    assert call("--scenario", small, "--jobs", "1", "--episodes", "1") == 1
    assert "No space left on device" in capsys.readouterr().err


PUSHES = """
import numpy as np


class Push:
    def predict(self, observation, *_):
        return np.full((len(observation), 2), {}), None
"""


def test_resume_runs_a_changed_policy_again(call, small, tmp_path, capsys):
    common = ("--scenario", small, "--policy", "mine.py:Push", "--episodes", "2", "--jobs", "1", "--resume")
    steady_rmses = []
    for push, state in ((0.1, "done"), (0.1, "known"), (0.2, "done")):
        (tmp_path / "mine.py").write_text(PUSHES.format(push))
        assert call(*common) == 0
        assert f"mine.py:Push in small: {state}" in capsys.readouterr().err
        row = json.loads((tmp_path / "runs" / "evaluate" / "results.json").read_text())["results"][1]
        steady_rmses.append(row["steady_rmse_m"]["mean"])
    assert steady_rmses[0] == steady_rmses[1] != steady_rmses[2]


def test_resume_prints_the_files_that_it_checks(call, small, tmp_path, capsys):
    (tmp_path / "mine.py").write_text(PUSHES.format(0.1))
    Path("w.txt").write_text("1")
    loop = "import json, sys; print('{}', flush=True) if json.loads(input()) else 0\n"
    loop += "for line in sys.stdin:\n    n = len(json.loads(line)['starts'])\n"
    loop += "    print(json.dumps({'actions': [[0, 0]] * n}), flush=True)\n"
    Path("program.py").write_text(loop)
    program = f"cmd:{sys.executable} program.py --weights=w.txt"
    policies = ("--policy", "mine.py:Push", program, "--scenario", small, "--episodes", "1", "--jobs", "1")
    assert call(*policies) == 0
    assert "--resume checks" not in capsys.readouterr().err
    assert call(*policies, "--resume") == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "--resume checks" in line]
    assert [line.startswith("note: --resume checks the file mine.py,") for line in lines] == [True, False]
    assert "program.py, w.txt, and nothing else" in lines[1]


SLEEPS = """
import time
import numpy as np


class Push:
    def predict(self, observation, *_):
        time.sleep(0.005)
        return np.zeros((len(observation), 2)), None
"""


def test_resume_applies_the_time_limit_to_finished_runs(call, small, tmp_path, capsys):
    """The limit is for wall time, since this policy sleeps. A run within the limit is not repeated."""
    (tmp_path / "mine.py").write_text(SLEEPS)
    common = ("--scenario", small, "--policy", "mine.py:Push", "--episodes", "1", "--jobs", "1", "--resume")
    for limit, status, state in (("1", 0, "done"), ("2", 0, "known"), ("0.001", 1, "failed"), ("0.9", 0, "known")):
        assert call(*common, "--step-limit", limit) == status
        assert f"mine.py:Push in small: {state}" in capsys.readouterr().err
    row = json.loads((tmp_path / "runs" / "evaluate" / "results.json").read_text())["results"][1]
    assert row["decision_ms"] > 5


def test_runs_of_another_simulator_run_again(call, small, tmp_path, monkeypatch, capsys):
    common = ("--scenario", small, "slow-calm", "--episodes", "1", "--jobs", "1", "--resume")
    note = "note: runs of another version of the simulator are run again\n"
    for module in ("runner", "command"):
        monkeypatch.setattr(f"baselines.evaluation.{module}.simulator_fingerprint", lambda: "the one")
    for state, count in (("done", 0), ("known", 0)):
        assert call(*common) == 0
        err = capsys.readouterr().err
        assert err.count(f": {state}") == 2
        assert err.count(note) == count
    for module in ("runner", "command"):
        monkeypatch.setattr(f"baselines.evaluation.{module}.simulator_fingerprint", lambda: "another")
    for state, count in (("done", 1), ("known", 0)):
        assert call(*common) == 0
        err = capsys.readouterr().err
        assert err.count(f": {state}") == 2
        assert err.count(note) == count


def test_a_policy_that_changes_while_it_runs_is_refused(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(PUSHES.format(0.1) + "\nwith open(__file__, 'a') as own:\n    own.write('# changed')\n")
    (run,) = run_all((f"{file}:Push",), [drawn(SMALL, 1, 0)])
    assert (run.measures, run.error) == (None, "its files changed while it ran")
    file.write_text(PUSHES.format(0.1))
    assert run_all((f"{file}:Push",), [drawn(SMALL, 1, 0)])[0].error is None


def test_interruption_prints_one_line(monkeypatch, capsys):
    def command(_):
        raise KeyboardInterrupt

    monkeypatch.setattr(sys, "argv", ["evaluate.py"])
    assert run(command, "evaluate.py") == 1
    assert capsys.readouterr().err == "evaluate.py: interrupted\n"


def test_default_request_is_the_benchmark_with_the_expert(tmp_path):
    request = Request.of(Options(out=tmp_path / "new" / "folder"))
    assert (request.suite, request.policies) == ("benchmark-v2", ("backstepping",))
    assert {run.policy for run in request.earlier} == set(baselines.list_policies()) - {"backstepping"}
    assert request.workers in (Workers(1), Workers(2))
    assert request.options.out.is_dir()


def test_every_preset(tmp_path):
    request = Request.of(Options(suite="presets", out=tmp_path))
    assert [cell.scenario.name for cell in request.cells] == list(PRESETS)
    assert [len(cell.episodes) for _, cell in request.pairs] == [20] * len(PRESETS)


def test_different_episodes_have_different_hashes(tmp_path):
    hashes = {
        Request.of(Options(scenario=scenarios, episodes=episodes, seed=seed, jobs=jobs, out=tmp_path)).hash
        for scenarios, episodes, seed, jobs in (
            (("slow-calm",), 5, 0, 1),
            (("slow-calm", "slow-calm"), 5, 0, 2),
            (("slow-noise",), 5, 0, 1),
            (("slow-calm",), 6, 0, 1),
            (("slow-calm",), 5, 1, 1),
        )
    }
    assert len(hashes) == 4


def test_all_policies_run_in_the_same_episodes():
    """Start and reference of an episode are those of an environment's reset, for every policy."""
    scenario = PRESETS["slow-storm"]
    cell = drawn(scenario, 2, 4)
    one, other = (Task(p, scenario, cell.episodes).run()[1].rollout.tracks[0] for p in ("backstepping", "open-loop"))
    shorter = min(len(one.reference), len(other.reference))
    np.testing.assert_array_equal(one.position[0], other.position[0])
    np.testing.assert_array_equal(one.reference[:shorter], other.reference[:shorter])
    env = make_env(scenario)
    env.reset(seed=4)
    np.testing.assert_allclose(one.position[0], env.unwrapped.state[:2], rtol=1e-12)


@dataclasses.dataclass
class EpisodeRecord:
    """One episode of n control steps, fewer than the scenario's if it failed."""

    errors: np.ndarray  # [m] shape (n,)
    actions: np.ndarray  # shape (n, 2)
    failed: bool
    positions: np.ndarray  # x, y [m] at the start and after each step, shape (n + 1, 2)
    references: np.ndarray  # x, y [m] of the reference, shape (n + 1, 2)


def run_episode(env, policy, seed):
    """Return one episode of a policy in a scalar environment, for comparison with the loop of the evaluation."""
    observation, _ = env.reset(seed=seed)
    memory, first, over = None, np.array([True]), False
    errors, actions, rows = [], [], [(*env.unwrapped.state[:2], *env.unwrapped.reference[:2])]
    while not over:
        action, memory = policy.predict(observation, memory, first)
        observation, _, failed, truncated, info = env.step(action)
        errors.append(info["position_error"])
        actions.append(np.clip(np.asarray(action, dtype=np.float64), -1.0, 1.0))
        rows.append((*env.unwrapped.state[:2], *env.unwrapped.reference[:2]))
        first, over = np.array([False]), failed or truncated
    table = np.array(rows)
    return EpisodeRecord(np.array(errors), np.array(actions), failed, table[:, :2], table[:, 2:])


def test_parallel_episodes_equal_single_episodes():
    """For a controller with memory and one without, in a scenario in which some episodes fail."""
    scenario = dataclasses.replace(PRESETS["cruise-storm"], steps=90, lost_distance=1.6)
    episodes = drawn(scenario, 12, 3).episodes
    for policy in (baselines.make_policy("backstepping"), Counting()):
        result = rollout(policy, scenario, episodes, 1.0)
        records = [run_episode(make_env(scenario), policy, 3 + i) for i in range(12)]
        assert result.measures.failed.any()
        assert result.measures.failed.tolist() == [record.failed for record in records]
        errors = np.array([np.pad(record.errors, (0, 90 - len(record.errors)), "edge") for record in records]).T
        np.testing.assert_allclose(result.errors, errors, rtol=1e-5)
        np.testing.assert_allclose(result.measures.steady_rmse, metrics.steady_rmse(errors), rtol=1e-6)
        for i, record in enumerate(records):
            assert result.measures.steps[i] == len(record.errors)
            assert result.measures.effort[i] == pytest.approx(metrics.effort(record.actions), rel=1e-6)
            assert result.measures.smoothness[i] == pytest.approx(metrics.smoothness(record.actions), rel=1e-5)


class Counting:
    """Moves the rudder periodically, by the number of steps since the start of the episode."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        single = observation.ndim == 1
        begun = np.atleast_1d(episode_start)
        count = np.where(begun, 0, 0 if state is None else state[0])
        action = np.stack((np.full(len(count), 0.4), 0.3 * np.sin(0.3 * count)), axis=1).astype(np.float32)
        return (action[0] if single else action), (count + 1,)


def test_a_policy_must_act_for_every_episode():
    class One:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return np.zeros(2), state

    cell = drawn(SMALL, 3, 0)
    with pytest.raises(PolicyError, match=r"step 0: actions have shape \(2,\) .* of shape \(3, 2\)"):
        rollout(One(), SMALL, cell.episodes, 1.0)


def test_runs_are_ordered_by_cell():
    policies, cells = ("backstepping", "open-loop"), [drawn(s, 6, 7) for s in (SMALL, PRESETS["slow-calm"])]
    found = list(runs([(p, cell) for cell in cells for p in policies]))
    assert [(run.scenario.name, run.policy) for run in found] == [(c.scenario.name, p) for c in cells for p in policies]


def test_more_episodes_than_run_in_parallel():
    short = dataclasses.replace(SMALL, steps=3)
    many = run_all(("backstepping",), [drawn(short, MOST_PARALLEL + 1, 0)])[0].measures
    few = run_all(("backstepping",), [drawn(short, 2, MOST_PARALLEL - 1)])[0].measures
    np.testing.assert_allclose(many.steady_rmse[-2:], few.steady_rmse, rtol=1e-12)


def test_an_interrupted_evaluation_can_be_resumed(call, small, tmp_path, monkeypatch, capsys):
    common = ("--scenario", small, "slow-calm", "--episodes", "2", "--jobs", "1")
    assert call(*common, "--out", "whole") == 0
    with monkeypatch.context() as patch:
        patch.setattr("baselines.evaluation.rows.RowStore.save", interrupted_at_second(RowStore.save))
        assert call(*common, "--out", "part") == 1
    assert len(list((tmp_path / "part" / "rows").iterdir())) == 1
    with monkeypatch.context() as patch:
        patch.setattr("baselines.evaluation.runner.rollout", only_in("slow-calm"))
        assert call(*common, "--out", "part", "--resume") == 0
    whole, part = (without_seconds(tmp_path / name / "results.json") for name in ("whole", "part"))
    assert whole == part


def interrupted_at_second(save):
    calls = []

    def second(store, run):
        calls.append(run)
        if len(calls) == 2:
            raise KeyboardInterrupt
        save(store, run)

    return second


def only_in(name):
    def checked(policy, scenario, *rest):
        assert scenario.name == name
        return rollout(policy, scenario, *rest)

    return checked


def test_damaged_rows_run_again(tmp_path):
    run = run_all(("backstepping",), [drawn(SMALL, 2, 0)])[0]
    store = RowStore(tmp_path / "rows")
    store.save(run)
    again = store.load(run.key)
    for field in dataclasses.fields(Measures):
        np.testing.assert_array_equal(getattr(run.measures, field.name), getattr(again.measures, field.name))
    assert len(again.tracks) == 2
    for one, other in zip(run.tracks, again.tracks, strict=True):
        for field in dataclasses.fields(one):
            np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))
    (file,) = (tmp_path / "rows").iterdir()
    file.write_bytes(file.read_bytes()[:100])
    assert store.load(run.key) is None


def test_errors_equal_those_of_the_environment():
    record = run_episode(make_env(SMALL), baselines.make_policy("open-loop"), 3)
    assert record.errors.shape == (45,)
    assert record.actions.shape == (45, 2)
    distance = np.linalg.norm(record.positions - record.references, axis=1)
    np.testing.assert_allclose(distance[1:], record.errors, rtol=1e-12)
    track = rollout(baselines.make_policy("open-loop"), SMALL, drawn(SMALL, 1, 3).episodes, 1.0).tracks[0]
    assert track.position.shape == track.reference.shape == (45, 2)
    np.testing.assert_allclose(track.position, record.positions[:-1], rtol=1e-9)
    np.testing.assert_allclose(track.error[1:], record.errors[:-1], rtol=1e-9)


def test_an_episode_ends_beyond_the_lost_distance():
    scenario = Scenario(name="failed", lost_distance=0.5, steps=100, start=PRESETS["paper-circle"].start)
    record = run_episode(make_env(scenario), baselines.make_policy("backstepping"), 0)
    assert record.failed
    assert len(record.errors) < 100


def test_warnings_of_a_policy_are_recorded():
    _, part = Task("backstepping-paper", PRESETS["cruise-calm"], drawn(PRESETS["cruise-calm"], 1, 0).episodes).run()
    assert part.error is None
    assert "stable up to" in part.warnings[0]


def test_saved_scenario_is_the_one_evaluated(small, tmp_path):
    (cell,) = Request.of(Options(scenario=(small,), episodes=1, out=tmp_path)).cells
    assert cell.scenario == SMALL


def test_table_fits_a_narrow_terminal(capsys):
    entries = [r.entry for r in compare(run_all(("backstepping", "backstepping-normalised"), [drawn(SMALL, 2, 0)]))]
    for width, interval in ((70, False), (160, True)):
        Console(width=width).print(entries_table("A title", "scenario", entries, Console(width=width)))
        out = capsys.readouterr().out
        assert max(map(len, out.splitlines())) <= width
        assert "backstepping-normalised" in out
        assert "0 of 2 (<= 78 %)" in out
        assert ("95 % interval" in out) is interval


def test_no_torch_is_imported():
    code = (
        "import sys, baselines.evaluation.entry, baselines.evaluation.command, baselines.tools.figure_style\n"
        "sys.exit(not {'torch', 'pygame', 'matplotlib', 'vl_convert'}.isdisjoint(sys.modules))"
    )
    subprocess.run([sys.executable, "-c", code], cwd=SCRIPT.parent, check=True)
