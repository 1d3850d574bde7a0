"""evaluate.py: one-line messages, numbers of other implementations, equal results for any number of workers."""

import csv
import dataclasses
import html.parser
import io
import json
import math
import re
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

import baselines
from auv_gym.effects.current import RandomCurrent
from auv_gym.effects.sensors import Sensors
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.presets import PRESETS, as_scenario
from auv_gym.scenarios.scenario import RandomPath, Scenario
from baselines.control import Registration
from baselines.evaluation import command as evaluation
from baselines.evaluation import metrics, recorded
from baselines.evaluation import request as request_module
from baselines.evaluation.cells import drawn
from baselines.evaluation.options import Options
from baselines.evaluation.report.numbers import compare
from baselines.evaluation.report.page_data import page_data
from baselines.evaluation.report.terminal import entries_table
from baselines.evaluation.request import Request
from baselines.evaluation.results import ResultFile
from baselines.evaluation.rollout import rollout
from baselines.evaluation.runner import part_of, run_all
from baselines.tools.command_line import run
from baselines.tools.workers import Workers

SCRIPT = Path(__file__).parents[2] / "evaluate.py"
SMALL = Scenario(name="small", sensors=Sensors(position=0.05), steps=45)
ROW = {
    "policy": str, "scenario": str, "episodes": int, "rmse_m": float, "steady_rmse_m": dict, "score": type(None),
    "capped": type(None), "settling_s": float, "effort_ratio": float, "smoothness_ratio": float, "failed": int,
    "failure_rate": float, "failure_rate_bound": float, "to_best_m": dict,
    "failed_within": type(None), "episodes_within": type(None),
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


class Vicious(BaseException):
    def __str__(self):
        raise RuntimeError("no text")


def raises(error):
    raise error


class Acting:
    """A policy that acts by a function of the observations."""

    def __init__(self, act):
        self.act = act

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return self.act(observation)


BAD = {
    "raising": lambda _: raises(RuntimeError("no\nresult")),
    "vicious": lambda _: raises(Vicious()),
    "stateless": lambda rows: np.zeros((len(rows), 2)),
    "single": lambda rows: (np.zeros(2), None),
    "nan": lambda rows: (np.full((len(rows), 2), np.nan, dtype=np.float32), None),
    "slow": lambda rows: time.sleep(0.05) or (np.zeros((len(rows), 2)), None),
}


@pytest.fixture
def bad_policies(monkeypatch):
    for name, act in BAD.items():
        monkeypatch.setitem(baselines.POLICIES, name, Registration(partial(Acting, act), "bad"))


@pytest.fixture
def files(tmp_path):
    """A scenario, another one of the same name, and one whose path is infeasible."""
    SMALL.save(tmp_path / "small.toml")
    changed(SMALL, control_dt=0.2).save(tmp_path / "other.json")
    (tmp_path / "turn.toml").write_text('[path]\nfamily = "circle"\nspeed = 0.1\nturn_rate = 9.0')
    return set(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--bogus"], "--bogus; see"),
        (["--resume", "--episods=3"], "--episods=3 (did you mean '--episodes'?)"),
        (["--jobs", "1.5"], "--jobs is '1.5'; it must be an integer"),
        (["--speed=fast", "--seed", "1"], "--speed is 'fast'; it must be a number"),
        (["--current", "0.1", "x"], "--current is '0.1 x'; it must be 2 numbers"),
        (["--policy", "own.py"], "policy 'own.py' names no class or factory; write own.py:NAME"),
        (
            ["--policy", "helm", "--scenario", "space-calm"],
            "agent helm is for motion in the plane; agents for motion in space: helm-3d",
        ),
        (["--policy", "ekf:gard"], "unknown policy 'ekf:gard' (did you mean 'ekf:guard'?)"),
        (["--episodes", "0"], "1 or more"),
        (["--step-limit", "0"], "positive"),
        (["--policy", "nobody"], "allowed are backstepping"),
        (["--suite", "nothing"], "allowed are presets"),
        (["--scenario", "nowhere"], "allowed are a .toml or .json file, or one of paper-circle"),
        (["--scenario", "missing.toml"], "No such file"),
        (["--scenario", "turn.toml"], "infeasible"),
        (["--scenario", "small.toml", "other.json"], "'small'; rename"),
        (["--suite", "presets", "--scenario", "paper-circle"], "give one of them"),
        (["--out", "small.toml"], "--out"),
    ],
)
def test_a_wrong_argument_gives_a_message_of_one_line(call, capsys, tmp_path, files, arguments, message):
    assert call(*arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("evaluate.py: ")
    assert err.count("\n") == 1
    assert message in err
    assert set(tmp_path.iterdir()) == files


def test_as_a_process():
    words = [sys.executable, SCRIPT, "--episodes", "0"]
    wrong = subprocess.run(words, cwd=SCRIPT.parent, capture_output=True, text=True, check=False)
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert wrong.stderr == "evaluate.py: --episodes is 0; it must be 1 or more\n"


def without_seconds(file):
    record = json.loads(file.read_text())
    for row in record["results"]:
        assert row.pop("seconds") > 0
        assert row.pop("decision_ms") > 0
    for row in record["pooled"]:
        assert row.pop("decision_ms") > 0
    return record


def test_results_are_the_same_for_any_number_of_jobs(call, small, tmp_path, capsys, monkeypatch):
    """Two tasks in one process; four tasks, of half the episodes each, which two workers finish in any order."""
    common = ("--policy", "open-loop", "--scenario", small, "--episodes", "12", "--seed", "3")
    for jobs in ("1", "2"):
        assert call(*common, "--jobs", jobs, "--out", jobs) == 0
        monkeypatch.setattr("baselines.evaluation.runner.MOST_PARALLEL", 6)
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
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        attributes = dict(attributes)
        assert tag not in ("link", "iframe", "img", "object")
        assert not any(name == "src" or name.startswith("on") for name in attributes)
        assert not (attributes.get("href") or "").startswith("http")

    def handle_data(self, data):
        self.text += data


@pytest.fixture
def few_recorded(monkeypatch):
    """Recorded rows of two policies only."""
    load = request_module.recorded_runs

    def few(suite):
        chosen = tuple(run for run in load(suite).runs if run.policy in ("los-pid", "clairvoyant"))
        return recorded.RecordedRuns(chosen, ("lqi is left out",))

    monkeypatch.setattr(request_module, "recorded_runs", few)


def test_report_is_one_page(call, small, tmp_path, bad_policies, few_recorded, capsys):
    assert call("--suite", "benchmark-v3", "--episodes", "2", "--policy", "open-loop", "--jobs", "1", "--out", "a") == 0
    page = Page((tmp_path / "a" / "report.html").read_text(encoding="utf-8"))
    for text in ("score", "clairvoyant*", "cruise-storm", "Definitions of the columns", "--episodes 2", "numpy"):
        assert text in page.text
    record = strict_json((tmp_path / "a" / "results.json").read_text())
    live = {row["policy"] for row in record["results"] if row["recorded"] is None}
    assert live == {"backstepping", "open-loop"}
    (recorded_on,) = {row["recorded"]["date"] for row in record["results"] if row["policy"] == "clairvoyant"}
    assert f"({recorded_on}, auv_gym 0.1.0)" in page.text
    out, err = capsys.readouterr()
    assert "note: lqi is left out" in err
    assert re.search(rf"\* recorded, not run now: .*clairvoyant \({recorded_on}, auv_gym 0.1.0\)", out)
    scores = {p["policy"]: p["score"]["mean"] for p in record["pooled"] if p["speed_range"] == "slow"}
    assert scores["backstepping"] == 0
    assert scores["clairvoyant"] == 1
    assert call("--scenario", small, "--policy", "raising", "--jobs", "1", "--episodes", "1", "--out", "b") == 1
    page = Page((tmp_path / "b" / "report.html").read_text(encoding="utf-8"))
    assert "raising in small: RuntimeError: no result" in page.text


def test_a_failing_policy_does_not_affect_other_rows(call, small, tmp_path, capsys, bad_policies):
    common = ("--scenario", small, "--jobs", "1", "--episodes", "6", "--step-limit", "5e-3", "--out", "bad")
    assert call(*common, "--policy", *BAD) == 1
    results = strict_json((tmp_path / "bad" / "results.json").read_text())["results"]
    expert, *failed = results
    assert (expert["error"], expert["episodes"]) == (None, 6)
    errors = {row["policy"]: row["error"] for row in failed}
    assert errors["raising"] == "RuntimeError: no result"
    assert errors["nan"].startswith("step 0, episode 0: action is [nan nan]; it must be two finite numbers")
    assert "allowed are 0.005 s" in errors["slow"]
    assert errors["vicious"] == "Vicious: its message cannot be printed"
    assert "it must return (action, state)" in errors["stateless"]
    assert "step 0: actions have shape (2,)" in errors["single"]
    for row in failed:
        assert all(row[key] is None for key in ROW if key not in ("policy", "scenario", "error", "warnings"))
    out, err = capsys.readouterr()
    assert out.count("failed") == len(BAD)
    assert "failed: raising in small, RuntimeError: no result" in err
    assert len((tmp_path / "bad" / "results.csv").read_text().splitlines()) == 2 + len(BAD)


def test_policies_that_all_fail_are_in_the_table(call, small, tmp_path, capsys):
    common = ("--scenario", small, "--jobs", "1", "--episodes", "2", "--out", "slow")
    assert call(*common, "--policy", "open-loop", "--step-limit", "1e-9") == 1
    out, err = capsys.readouterr()
    assert out.count("failed") == err.count("allowed are 1e-09 s") == 2
    assert ResultFile.read(tmp_path / "slow" / "results.npz").runs == ()


def test_names_outside_the_encoding_of_the_terminal_are_escaped(call, small, monkeypatch):
    stdout = io.TextIOWrapper(io.BytesIO(), "ascii")
    monkeypatch.setattr(sys, "stdout", stdout)
    assert call("--scenario", small, "--jobs", "1", "--episodes", "1", "--out", "été") == 0
    assert rb"results.npz to \xe9t\xe9" in stdout.buffer.getvalue()


def test_results_that_cannot_be_written_are_a_failure(call, small, monkeypatch, capsys):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("baselines.evaluation.evaluate.write_atomically", full)
    assert call("--scenario", small, "--jobs", "1", "--episodes", "1") == 1
    assert "No space left on device" in capsys.readouterr().err


PUSHES = """
import time
import numpy as np


class Push:
    def predict(self, observation, *_):
        time.sleep({seconds})
        return np.full((len(observation), 2), {push}), None
"""


def test_resume_runs_a_changed_policy_again_and_all_in_another_simulator(call, small, tmp_path, monkeypatch, capsys):
    common = ("--scenario", small, "--policy", "mine.py:Push", "--episodes", "2", "--jobs", "1", "--resume")
    steady_rmses = []
    for push, state in ((0.1, "done"), (0.1, "known"), (0.2, "done")):
        (tmp_path / "mine.py").write_text(PUSHES.format(seconds=0, push=push))
        assert call(*common) == 0
        assert f"mine.py:Push in small: {state}" in capsys.readouterr().err
        row = json.loads((tmp_path / "runs" / "evaluate" / "results.json").read_text())["results"][1]
        steady_rmses.append(row["steady_rmse_m"]["mean"])
    assert steady_rmses[0] == steady_rmses[1] != steady_rmses[2]
    monkeypatch.setattr("baselines.evaluation.runner.simulator_fingerprint", lambda *_: "another")
    for state in ("done", "known"):
        assert call(*common) == 0
        assert capsys.readouterr().err.count(f": {state}") == 2


def test_resume_applies_the_time_limit_to_finished_runs(call, small, tmp_path, capsys):
    """The limit is for wall time, since this policy sleeps. A run within the limit is not repeated."""
    (tmp_path / "mine.py").write_text(PUSHES.format(seconds=0.005, push=0.0))
    common = ("--scenario", small, "--policy", "mine.py:Push", "--episodes", "1", "--jobs", "1", "--resume")
    for limit, status, state in (("1", 0, "done"), ("2", 0, "known"), ("0.001", 1, "failed"), ("0.9", 0, "known")):
        assert call(*common, "--step-limit", limit) == status
        assert f"mine.py:Push in small: {state}" in capsys.readouterr().err
    row = json.loads((tmp_path / "runs" / "evaluate" / "results.json").read_text())["results"][1]
    assert row["decision_ms"] > 5


def test_a_policy_that_changes_while_it_runs_is_refused(tmp_path):
    file, push = tmp_path / "mine.py", PUSHES.format(seconds=0, push=0.1)
    file.write_text(push + "\nwith open(__file__, 'a') as own:\n    own.write('# changed')\n")
    (run,) = run_all((f"{file}:Push",), [drawn(SMALL, 1, 0)])
    assert (run.measures, run.error) == (None, "its files changed while it ran")
    file.write_text(push)
    assert run_all((f"{file}:Push",), [drawn(SMALL, 1, 0)])[0].error is None


def test_default_request_is_the_benchmark_with_the_expert(tmp_path):
    request = Request.of(Options(out=tmp_path / "new" / "folder"))
    assert (request.suite, request.policies) == ("benchmark-v3", ("backstepping",))
    assert {run.policy for run in request.earlier} == set(baselines.list_policies()) - {"backstepping"}
    assert request.workers in (Workers(1), Workers(2))
    assert request.options.out.is_dir()


def test_every_preset(tmp_path):
    request = Request.of(Options(suite="presets", out=tmp_path))
    assert [cell.scenario.name for cell in request.cells] == list(PRESETS)
    assert [len(cell.episodes) for _, cell in request.pairs] == [20] * len(PRESETS)


def test_different_episodes_have_different_hashes(tmp_path):
    usual = {"scenario": ("slow-calm",), "episodes": 5, "jobs": 1, "out": tmp_path}
    changes = {}, {"scenario": ("slow-calm", "slow-calm"), "jobs": 2}, {"scenario": ("slow-noise",)}, {"seed": 1}
    hashes = [Request.of(Options(**usual | change)).hash for change in changes]
    assert hashes[0] == hashes[1]
    assert len({*hashes}) == 3


def test_metrics_are_those_of_the_episodes():
    """For a controller with memory and one without, in a scenario in which some episodes fail."""
    scenario = dataclasses.replace(PRESETS["cruise-storm"], steps=90, lost_distance=1.6)
    for policy in (baselines.make_policy("backstepping"), Counting()):
        result = rollout(policy, scenario, drawn(scenario, 12, 3).episodes, 1.0)
        records = baselines.run_episodes(policy, scenario, 12, 3)
        assert result.measures.failed.any()
        assert result.measures.failed.tolist() == [record.failed for record in records]
        errors = np.array([np.pad(record.errors[1:], (0, 90 - len(record.actions)), "edge") for record in records]).T
        np.testing.assert_allclose(result.errors, errors, rtol=1e-5)
        np.testing.assert_allclose(result.measures.steady_rmse, metrics.steady_rmse(errors), rtol=1e-6)
        for i, record in enumerate(records):
            assert result.measures.steps[i] == len(record.actions)
            assert result.measures.effort[i] == pytest.approx(metrics.effort(record.actions), rel=1e-6)
            assert result.measures.smoothness[i] == pytest.approx(metrics.smoothness(record.actions), rel=1e-5)
        for track, record in zip(result.tracks, records, strict=False):
            np.testing.assert_allclose(track.position, record.positions[: len(track)], rtol=1e-9)
            np.testing.assert_allclose(track.error, record.errors[: len(track)], rtol=1e-9)


class Counting:
    """Moves the rudder periodically, by the number of steps since the start of the episode."""

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        single = observation.ndim == 1
        begun = np.atleast_1d(episode_start)
        count = np.where(begun, 0, 0 if state is None else state[0])
        action = np.stack((np.full(len(count), 0.4), 0.3 * np.sin(0.3 * count)), axis=1).astype(np.float32)
        return (action[0] if single else action), (count + 1,)


def test_an_interrupted_evaluation_can_be_resumed(call, small, tmp_path, monkeypatch, capsys):
    common = ("--scenario", small, "slow-calm", "--episodes", "2", "--jobs", "1")
    assert call(*common, "--out", "whole") == 0
    with monkeypatch.context() as patch:
        patch.setattr(ResultFile, "write", interrupted_at_second(ResultFile.write))
        assert call(*common, "--out", "part") == 1
    (file,) = (tmp_path / "part" / "finished").iterdir()
    with monkeypatch.context() as patch:
        patch.setattr("baselines.evaluation.runner.rollout", only_in("slow-calm"))
        assert call(*common, "--out", "part", "--resume") == 0
    whole, part = (without_seconds(tmp_path / name / "results.json") for name in ("whole", "part"))
    assert whole == part
    file.write_bytes(file.read_bytes()[:100])  # damaged: it runs again
    capsys.readouterr()
    assert call(*common, "--out", "part", "--resume") == 0
    err = capsys.readouterr().err
    assert (err.count(": done"), err.count(": known")) == (1, 1)


def interrupted_at_second(write):
    calls = []

    def second(content, file, single=False):
        calls.append(file)
        if len(calls) == 2:
            raise KeyboardInterrupt
        write(content, file, single)

    return second


def only_in(name):
    def checked(policy, scenario, *rest):
        assert scenario.name == name
        return rollout(policy, scenario, *rest)

    return checked


def test_warnings_of_a_policy_are_recorded():
    part = part_of("ppo-slow", PRESETS["cruise-calm"], drawn(PRESETS["cruise-calm"], 1, 0).episodes)
    assert part.error is None
    assert "was trained at reference speeds of 0 to 0.5 m/s" in part.warnings[0]


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
        "import sys, baselines.evaluation.command, baselines.evaluation.evaluate, baselines.tools.figure_style\n"
        "sys.exit(not {'torch', 'pygame', 'matplotlib'}.isdisjoint(sys.modules))"
    )
    subprocess.run([sys.executable, "-c", code], cwd=SCRIPT.parent, check=True)


def test_episodes_that_need_more_than_the_limits_are_said_before_and_counted_apart(call, tmp_path, capsys):
    """On lines linear drag decides: beyond 1.2 m/s through water it exceeds 84 N."""
    path, flow = RandomPath((0.5, 1.1), 0.1, ("line",)), RandomCurrent(0.4, relative=False)
    act = dataclasses.replace(PRESETS["cruise-calm"].actuators, F_u_max=84.0)
    scenario = dataclasses.replace(
        PRESETS["cruise-calm"], name="weak", path=path, current=flow, actuators=act, lost_distance=3.0
    )
    cell, lines = drawn(scenario, 8, 0), []
    for episode in cell.episodes:
        (x, y), (V_x, V_y) = episode.path.derivatives(np.zeros(1))[1, :, 0], (episode.current.V_x, episode.current.V_y)
        lines.append(70.0 * math.hypot(x - V_x, y - V_y) > 84.0)
    assert cell.beyond.tolist() == lines
    assert 0 < sum(lines) < 8
    scenario.save(tmp_path / "weak.toml")
    words = "--scenario", "weak.toml", "--policy", "los-pid", "--episodes", "8", "--jobs", "1", "--out", "out"
    assert call(*words) == 0
    said = f"{sum(lines)} of 8 episodes of weak need more than the limits in their current"
    assert f"note: {said}" in capsys.readouterr().err
    assert said in Path("out/report.html").read_text(encoding="utf-8")
    rows = json.loads(Path("out/results.json").read_text(encoding="utf-8"))["results"]
    for row, one in zip(rows, ResultFile.read(Path("out/results.npz")).runs, strict=True):
        assert row["policy"] == one.policy
        assert row["episodes_within"] == 8 - sum(lines)
        assert row["failed_within"] == int((one.measures.failed & ~cell.beyond).sum())
        assert row["failed"] == int(one.measures.failed.sum())


def test_scenarios_in_space_are_evaluated_and_their_depths_are_in_the_report(call, tmp_path, capsys):
    words = "--scenario", "space-storm", "slow-calm", "--episodes", "2", "--jobs", "1", "--out"
    assert call("--policy", "los-pid", *words, str(tmp_path / "out")) == 0
    assert "in their current" not in capsys.readouterr().err  # reserves are those of the plane
    cells = [drawn(as_scenario(name), 2, 0) for name in ("space-storm", "slow-calm")]
    runs = run_all(("backstepping", "los-pid"), cells)
    deep, flat = (scenario["episodes"][0] for scenario in page_data(compare(runs), ())["scenarios"])
    track = runs[1].tracks[0]
    np.testing.assert_array_equal(deep["reference"]["depth"], np.round(-100 * track.height[::4, 1]))
    np.testing.assert_array_equal(deep["vehicles"][1]["depth"], np.round(-100 * track.height[::4, 0]))
    assert "depth" not in flat["reference"]
    for policy, message in (
        ("oracle", "there is no policy 'oracle' in space"),
        ("cmd:cat", "policy 'cmd:cat' is for motion in the plane"),
        ("lqi:guard", "there is no guard in space"),
    ):
        assert call("--policy", policy, *words, str(tmp_path / "out")) == 2
        assert message in capsys.readouterr().err


def test_a_mission_is_evaluated_and_leaves_its_reference(call, capsys):
    Path("square.csv").write_text("x,y,speed\n0,0,0.8\n40,0,0.6\n40,30,0.8\n0,30,1\n", encoding="utf-8")
    words = "--mission", "square.csv", "--radius", "4", "--current", "0.1", "0.05", "--policy", "ilos", "--jobs", "1"
    assert call(*words, "--out", "out") == 0
    rows = [*csv.DictReader(Path("out/reference.csv").read_text(encoding="utf-8").splitlines())]
    assert list(rows[0]) == ["t", "x", "y", "psi", "u", "v", "r", "F_u", "F_r"]
    assert [float(rows[0][name]) for name in "xyu"] == pytest.approx([0.0, 0.0, 0.8])
    assert float(rows[-1]["y"]) == pytest.approx(30.0, abs=1e-6)
    results = json.loads(Path("out/results.json").read_text(encoding="utf-8"))["results"]
    assert {row["episodes"] for row in results} == {1}
    Path("steep.csv").write_text("x,y,depth\n0,0,0\n20,0,100\n80,0,0\n", encoding="utf-8")
    Path("fast.csv").write_text("x,y\n0,0\n100,0\n", encoding="utf-8")
    for wrong, message in (
        (("--mission", "square.csv", "--suite", "presets"), "--suite and --mission exclude each other"),
        (("--vehicle", "lauv"), "--vehicle is for a mission; a scenario file has its own"),
        (("--mission", "no.csv"), "cannot read no.csv: No such file or directory"),
        (("--mission", "square.csv", "--radius", "40"), "a radius of"),
        (("--mission", "steep.csv"), "leg 0, the steepest, has 100 m of depth on 20 m"),
        (("--mission", "fast.csv", "--speed", "9"), "a smaller speed or a larger --radius may help"),
    ):
        capsys.readouterr()
        assert call(*wrong) == 2
        assert message in capsys.readouterr().err
