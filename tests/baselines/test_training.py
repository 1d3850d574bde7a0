"""train.py: mistakes in one line, the run folder, and the same agent however often a run was interrupted."""

import errno
import json
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from marks import slow_except

from auv_gym.installation import install
from auv_gym.scenarios.presets import CASES, PRESETS, SPEED_RANGES
from auv_gym.scenarios.scenario import Scenario
from baselines.agents.agent import Agent
from baselines.agents.names import AGENT_FOLDER, agent_folder
from baselines.evaluation.runner import drawn
from baselines.tools import command_line
from baselines.tools.command_line import UsageError, parse, run
from baselines.tools.seeds import TRAINING
from baselines.training import command, request
from baselines.training.config import ALGORITHMS, LARGEST_SEED, Config
from baselines.training.entry import main
from baselines.training.hyperparameters import TRAINED_ENV, changes_of, hyperparameter_words, load_hyperparameters
from baselines.training.hyperparameters import shipped as shipped_file
from baselines.training.options import PROGRAM, Options
from baselines.training.request import Request
from baselines.training.run_folder import RunFolder, locked, read_config, read_progress
from baselines.training.validation import Validation, Verdict
from research.trainings import shipped
from research.trainings.trainings import FIRST_TRAININGS, SHIPPED_TRAININGS, training

torch.set_num_threads(1)
ROOT = Path(__file__).parents[2]
SMALL = replace(PRESETS["cruise-current"], name="small", steps=15)
OFF_POLICY = {"buffer_size": 2000, "batch_size": 16, "learning_starts": 0, "train_freq": 8, "gradient_steps": 1}
SMOOTH = {"use_sde": True, "policy_kwargs": {"clip_mean": 0.0}}
TINY = {
    "apg": {"n_steps": 5, "hidden_size": 8},
    "ppo": {"n_steps": 16, "batch_size": 32, "learning_rate": "lin_0.01", "use_sde": True, "sde_sample_freq": 4},
    "ppo_lstm": {"n_steps": 16, "batch_size": 32, "use_sde": True, "policy_kwargs": {"lstm_hidden_size": 8}},
    "sac": OFF_POLICY | SMOOTH | {"callback": [{"baselines.training.sb3.callbacks.ZeroCorrection": {"std": 0.1}}]},
    "td3": OFF_POLICY | {"noise_type": "ornstein-uhlenbeck", "noise_std": 0.1},
    "tqc": OFF_POLICY | {"callback": [{"baselines.training.sb3.callbacks.FrozenActor": {"steps": 100}}]},
}
STEPS = 320


@pytest.fixture
def call(monkeypatch, tmp_path):
    """Run the script in-process in an empty folder and return its exit status."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("baselines.training.validation.VALIDATED_EPISODES", 4)
    for name in ("sb3.trainer.VALIDATIONS", "apg.trainer.LOGS"):
        monkeypatch.setattr(f"baselines.training.{name}", 5)
    SMALL.save("small.toml")
    for algo, values in TINY.items():
        Path(f"{algo}.yml").write_text(yaml.safe_dump({TRAINED_ENV: {"n_envs": 8, **values}}), encoding="utf-8")

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["train.py", *map(str, arguments)])
        return run(main, PROGRAM)

    return call


def tiny(algo, *more):
    words = ("--algo", algo, "--scenario", "small.toml", "--hyperparameters", f"{algo}.yml", "--timesteps", STEPS)
    return (*words, "--out", "out", *more)


def weights(folder):
    return dict(Agent.load(folder).weights)


def same(a, b):
    return a.keys() == b.keys() and all(np.array_equal(a[name], b[name]) for name in a)


@pytest.mark.parametrize("algo", slow_except(["apg"], ALGORITHMS))
def test_every_algorithm_gives_the_same_agent_after_an_interruption(algo, call, capsys, monkeypatch):
    assert call(*tiny(algo)) == 0
    out, err = capsys.readouterr()
    assert out.count("\n") == 1
    assert "agent: out/agent" in out
    assert err.splitlines()[-1].startswith("100%")
    assert {"agent", "checkpoint.pt", "config.json", "learning_curve.png", "progress.csv", "tensorboard"} < {
        file.name for file in Path("out").iterdir()
    }
    assert any(Path("out/tensorboard").iterdir())
    rows = read_progress(Path("out"))
    assert [row["timesteps"] for row in rows] == sorted({row["timesteps"] for row in rows})
    assert rows[-1]["timesteps"] >= STEPS

    keep = RunFolder.save_checkpoint

    def interrupted(self, state):
        keep(self, state)
        if state["timesteps"] > STEPS / 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(RunFolder, "save_checkpoint", interrupted)
    assert call(*tiny(algo), "--out", "other") == 1
    assert "--resume to continue" in capsys.readouterr().err
    assert not Path("other/agent").exists()
    assert call(*tiny(algo), "--out", "other") == 2
    assert "unfinished; add --resume" in capsys.readouterr().err
    monkeypatch.setattr(RunFolder, "save_checkpoint", keep)
    assert call(*tiny(algo), "--out", "other", "--resume") == 0
    assert same(weights("other/agent"), weights("out/agent"))
    again = read_progress(Path("other"))
    for row in (*rows, *again):
        del row["seconds"]
    assert again == rows


def test_a_note_says_that_there_is_nothing_to_resume(call, capsys):
    options = Options(scenario=("slow-calm",), timesteps=STEPS, out=Path("typo"), resume=True)
    assert len(Request.of(options).folders) == 1
    assert capsys.readouterr().err == "note: --out typo holds no run yet, so --resume begins one\n"


def test_folder_of_a_run_is_not_overwritten(call, capsys):
    assert call(*tiny("ppo")) == 0
    before = {file: file.stat().st_mtime_ns for file in Path("out").rglob("*")}
    capsys.readouterr()
    for more, message in (
        ((), "finished; choose another folder, or delete it"),
        (("--seed", 1), "a run with other seed: 0 instead of 1"),
        (("--seed", 1, "--resume"), "a run with other seed: 0 instead of 1"),
        (("--authority", 0.1), "a run with other authority: [0.5, 0.5] instead of [0.1, 0.1]"),
        (("--scenario", "small.toml:2"), "a run with other scenarios; choose"),
    ):
        assert call(*tiny("ppo"), *more) == 2
        err = capsys.readouterr().err
        assert message in err
        assert err.count("\n") == 1
    assert call(*tiny("ppo"), "--resume") == 0
    captured = capsys.readouterr()
    assert "holds the finished agent" in captured.out
    assert "note:" not in captured.err
    assert before == {file: file.stat().st_mtime_ns for file in Path("out").rglob("*")}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--algo", "dqn"), "unknown algorithm 'dqn'; allowed are apg, ppo"),
        (
            ("--scenario", "cruse"),
            "unknown scenario 'cruse'; allowed are a .toml or .json file, or one of helm, slow-slew",
        ),
        (("--scenario", "none.toml"), "cannot read none.toml: No such file"),
        (("--scenario", "cruise:much"), "'cruise:much' has weight 'much'; it must be a positive number"),
        (("--scenario", "cruise", "cruise-calm"), "scenario 'cruise-calm' is given twice"),
        (("--expert", "pid"), "unknown policy 'pid'; allowed are backstepping"),
        (("--expert", "oracle"), "expert 'oracle' needs full information"),
        (("--expert", "mine.py:Mine"), "must be a policy's name"),
        (("--authority", "3"), "authority is (3.0, 3.0); it must be a number in (0, 2]"),
        (("--authority", "0"), "authority is (0.0, 0.0)"),
        (("--authority", "1", "1", "1"), "authority is (1.0, 1.0, 1.0)"),
        (("--seed", "-1"), "seed is -1; it must be an integer in [0, 10000]"),
        (("--seeds", "0"), "--seeds is 0; it must be 1 or more"),
        (("--seed", str(LARGEST_SEED), "--seeds", "2"), "seed is 10001"),
        (("--jobs", "0"), "--jobs is 0"),
        (("--timesteps", "0"), "timesteps is 0; it must be an integer"),
        (("--timesteps", "many"), "see train.py --help"),
        (("--hyperparameters", "none.yml"), "cannot read none.yml"),
        (("--hyperparameters", "small.toml"), "small.toml has no table of hyper-parameters"),
        (("--hyperparameters", "broken.yml"), "broken.yml is not valid YAML"),
        (("--scenario", "small.toml", "--hyperparameters", "sac.yml"), "'buffer_size' of ppo; allowed are batch_size"),
        (("--set", "gamma"), "--set is 'gamma'; it must be NAME=VALUE"),
        (("--set", "=1"), "--set is '=1'"),
        (("--set", "gamma=["), "--set is 'gamma=['"),
        (("--set", "gama=0.9"), "unknown hyper-parameter 'gama' of ppo; allowed are batch_size"),
        (("--out", "small.toml/run"), "is not a folder that can be written to"),
        (("--out", "full"), "--out full is not empty and holds no run"),
        (("--speed", "1"), "see train.py --help"),
    ],
)
def test_wrong_options_give_one_line_and_create_no_files(arguments, message, call, capsys):
    Path("broken.yml").write_text("a: [", encoding="utf-8")
    Path("full").mkdir()
    Path("full/file").touch()
    before = set(Path().rglob("*"))
    assert call("--algo", "ppo", "--out", "out", *arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert err.count("\n") == 1
    assert set(Path().rglob("*")) == before


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"n_envs": 0}, "n_envs is 0"),
        ({"n_envs": 2}, "2 vehicles are too few for 8 scenarios"),
        ({"n_envs": 8, "policy": "CnnPolicy"}, "it must be MlpPolicy"),
        ({"n_envs": 8, "vec_env_wrapper": "os.system"}, "unknown vec_env_wrapper 'os.system'; allowed are"),
        ({"n_envs": 8, "callback": "os.system"}, "unknown callback 'os.system'; allowed are"),
        ({"n_envs": 8, "callback": [{"baselines.training.sb3.callbacks.FrozenActor": {"step": 1}}]}, "it takes steps"),
        ({"n_envs": 8, "learning_rate": "3e-4"}, "a number, or lin_NUMBER falling to zero"),
        ({"n_envs": 8, "batch_size": 1000}, "hyper-parameters of ppo: You have specified a mini-batch size of 1000"),
        ({"n_envs": 8, "policy_kwargs": {"net": 1}}, "hyper-parameters of ppo: "),
        ({"n_envs": 8, "env_kwargs": 1}, "env_kwargs is 1; it must be a table"),
        ({"n_envs": 8, "env_kwargs": {"expert": 3}}, "expert is 3; an agent's expert must be a policy's name"),
        ({"n_envs": 8, "env_kwargs": {"foo": 1}}, "env_kwargs has 'foo'; allowed are authority, expert, scenario"),
        ({"n_envs": 8, "env_kwargs": {"authority": "all"}}, "authority is 'all'"),
        ({"n_envs": 8, "n_timesteps": "1e6"}, "timesteps is '1e6'; it must be an integer"),
        ({"n_envs": 8, "noise_type": "pink"}, "noise is 'pink'"),
        ({"n_envs": 8, "use_sde": True, "buffer_size": 100}, "set clip_mean to 0 in policy_kwargs"),  # of sac
    ],
)
def test_impossible_hyperparameters_are_one_line(values, message, call, capsys):
    Path("h.yml").write_text(yaml.safe_dump({TRAINED_ENV: values}), encoding="utf-8")
    algo = "sac" if "buffer_size" in values else "ppo"
    assert call("--algo", algo, "--hyperparameters", "h.yml", "--out", "out") == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1
    assert not Path("out").exists()


@pytest.mark.parametrize("algo", ["ppo", "td3"])
def test_divergence_is_one_line(algo, call, capsys):
    values = TINY[algo] | {"learning_rate": 1e30, "n_envs": 8}
    Path(f"{algo}.yml").write_text(yaml.safe_dump({TRAINED_ENV: values}), encoding="utf-8")
    assert call(*tiny(algo)) == 1
    err = capsys.readouterr().err
    assert err.splitlines()[-1].startswith("training diverged after ")
    assert "Traceback" not in err


@pytest.mark.slow
def test_full_disk_is_one_line_and_leaves_the_last_checkpoint_whole(call, capsys, monkeypatch):
    replace_file, count = Path.replace, 0

    def full(self, target):
        nonlocal count
        count += target.name == "checkpoint.pt"
        if count == 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        return replace_file(self, target)

    monkeypatch.setattr(Path, "replace", full)
    assert call(*tiny("ppo")) == 1
    assert capsys.readouterr().err.splitlines()[-1] == "cannot write to out: No space left on device"
    monkeypatch.setattr(Path, "replace", replace_file)
    assert call(*tiny("ppo"), "--resume") == 0
    assert call(*tiny("ppo"), "--out", "other") == 0
    assert same(weights("out/agent"), weights("other/agent"))


@pytest.mark.slow
def test_a_run_resumes_after_a_kill_during_a_write(call, capsys):
    assert call(*tiny("ppo")) == 0
    (Path("out/agent")).rename("agent")
    Path("out/.checkpoint.pt.1.tmp").write_bytes(b"half")
    assert call(*tiny("ppo"), "--resume") == 0
    assert not list(Path("out").glob(".*.tmp"))
    assert same(weights("out/agent"), weights("agent"))
    Path("out/agent").rename("again")
    Path("out/checkpoint.pt").write_bytes(Path("out/checkpoint.pt").read_bytes()[:1000])
    capsys.readouterr()
    assert call(*tiny("ppo"), "--resume") == 1
    assert "cannot resume from out/checkpoint.pt" in capsys.readouterr().err


@pytest.mark.slow
def test_seeds_differ_and_each_has_a_folder(call, capsys):
    assert call(*tiny("ppo"), "--seed", 3, "--seeds", 2, "--jobs", 1) == 0
    assert "seed-3: 100%" in capsys.readouterr().err
    assert {file.name for file in Path("out").iterdir()} == {"seed-3", "seed-4", "learning_curve.png"}
    assert not same(weights("out/seed-3/agent"), weights("out/seed-4/agent"))
    assert [read_config(Path(f"out/seed-{i}")).seed for i in (3, 4)] == [3, 4]
    assert call(*tiny("ppo"), "--seed", 3, "--out", "one") == 0
    assert same(weights("out/seed-3/agent"), weights("one/agent"))


def test_a_folder_in_use_is_rejected(call, capsys):
    with locked(Path("out")):
        assert call(*tiny("ppo")) == 2
        assert capsys.readouterr().err == "another training writes to out; wait for it, or choose another folder\n"
        assert [file.name for file in Path("out").iterdir()] == [".lock"]
    assert call(*tiny("ppo")) == 0


@pytest.mark.slow
@pytest.mark.parametrize("damage", [b"\xff", b"timesteps\n1,2"])
def test_damaged_progress_is_one_line(damage, call, capsys):
    assert call(*tiny("ppo"), "--seeds", 2, "--jobs", 1) == 0
    Path("out/seed-1/progress.csv").write_bytes(damage)
    capsys.readouterr()
    assert call(*tiny("ppo"), "--seeds", 2, "--jobs", 1, "--resume") == 2
    assert re.fullmatch(r"train\.py: out/seed-1/progress\.csv .*\n", capsys.readouterr().err)
    shutil.rmtree("out/seed-1/agent")
    assert call(*tiny("ppo"), "--seeds", 2, "--jobs", 1, "--resume") == 1
    err = capsys.readouterr().err
    assert err.startswith("seed-1: cannot resume from out/seed-1/checkpoint.pt: out/seed-1/progress.csv")
    assert err.count("\n") == 1


@pytest.mark.parametrize("missing", slow_except(["yaml"], ["yaml", "filelock", "stable_baselines3"]))
def test_the_message_without_a_library(missing):
    code = f"import sys; sys.modules[{missing!r}] = None; sys.argv = ['train.py', '--algo', 'ppo']; import runpy\n"
    code += f"runpy.run_path({str(ROOT / 'train.py')!r}, run_name='__main__')"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert (process.returncode, process.stdout) == (2, "")
    assert process.stderr == f"train.py needs {missing}: {install('train')}\n"


@settings(deadline=None, max_examples=50)
@given(
    st.builds(
        Options,
        algo=st.sampled_from(list(ALGORITHMS)),
        scenario=st.lists(st.sampled_from(["cruise", "slow-storm:2", "a b.toml"]), min_size=1).map(tuple),
        expert=st.none() | st.sampled_from(["none", "lqi"]),
        authority=st.lists(st.floats(0.1, 2.0), min_size=1, max_size=2).map(tuple) | st.just(()),
        from_=st.none() | st.sampled_from(["helm", "runs/a b"]),
        vehicle=st.none() | st.sampled_from(["lauv", "a b.toml"]),
        seed=st.integers(0, LARGEST_SEED),
        jobs=st.none() | st.integers(1, 9),
        timesteps=st.none() | st.integers(1, 10**9),
        hyperparameters=st.none() | st.just(Path("h.yml")),
        set=st.lists(st.sampled_from(["gamma=0.5", "preview=[5, 10]", "e={net: {pi: [8]}}"])).map(tuple),
        out=st.none() | st.just(Path("runs/a b")),
        resume=st.booleans(),
    )
)
def test_options_and_words_of_a_command_line_are_the_same(options):
    assert parse(Options, command_line.words_of(options, Options()), "train.py") == options


def test_an_interruption_ends_all_seeds(call, capsys, monkeypatch):
    def interrupted(self, state):
        raise KeyboardInterrupt

    monkeypatch.setattr(RunFolder, "save_checkpoint", interrupted)
    assert call(*tiny("ppo"), "--seeds", 2, "--jobs", 1) == 1
    assert capsys.readouterr().err.splitlines()[-1] == "interrupted; repeat the command with --resume to continue"
    assert not any(Path("out/seed-1").iterdir())


def test_agent_records_its_training(call):
    assert call(*tiny("ppo"), "--authority", 0.2, 0.4, "--expert", "none") == 0
    agent = Agent.load("out/agent")
    assert (agent.expert, agent.authority, agent.scenarios) == ("none", (0.2, 0.4), ("small",))
    assert Config.from_dict(agent.training["config"]) == read_config(Path("out"))
    assert agent.training["command"].startswith("python train.py --algo ppo")
    scores = [row["score"] for row in read_progress(Path("out")) if "score" in row]
    assert agent.training["validation"]["score"] == max(scores)


@pytest.mark.parametrize("drawn_share", slow_except([0.5], [0.0, 0.5]))
def test_an_agent_and_its_score_are_of_one_validation(call, monkeypatch, drawn_share):
    """The best one; where vehicles are drawn, which are not validated, the last one."""
    monkeypatch.setattr("baselines.training.vehicle_models.SEVERAL", 1)
    measured, scores = Validation.run, iter(np.linspace(0.9, 0.1, 17))
    monkeypatch.setattr(Validation, "run", lambda *given: replace(measured(*given), score=float(next(scores))))
    assert call(*tiny("apg"), "--set", "nominal_vehicle=true", f"drawn_share={drawn_share}", "validations=2") == 0
    first, *_, last = (row for row in read_progress(Path("out")) if "score" in row)
    kept = Agent.load("out/agent").training
    assert kept["validation"] == {name: (last if drawn_share else first)[name] for name in kept["validation"]}
    assert kept["scores"] == {"validation episodes": round(kept["validation"]["score"], 3)}
    assert bool(weights("out/agent")["head.weight"].any()) == bool(drawn_share)  # the first network corrects nothing


@pytest.mark.parametrize(("keeps_last", "expected"), [(False, [1, 0, 1, 0, 0, 1]), (True, [1] * 6)])
def test_the_first_best_agent_is_selected_or_the_last(tmp_path, keeps_last, expected):
    run, kept = RunFolder(configuration(), tmp_path), []
    run.keeps_last = keeps_last
    agent = Agent.load(agent_folder("ppo-cruise"))
    for k, score in enumerate([0.5, 0.2, 0.7, math.nan, 0.7, 0.9]):
        run.validation = SimpleNamespace(run=lambda policy, score=score: Verdict(score, 1.0, 0.0, ()))
        run.log(10 * k, loss=1.0)
        mine = replace(agent, weights=dict(agent.weights))
        run.validate(mine, 10 * k)
        kept.append(run.weights is mine.weights)
    assert kept == expected
    assert run.validated["timesteps"] == 50


def configuration(**changes):
    return Config(**{"scenarios": ((SMALL, 1.0),), "algo": "ppo"} | changes)


def test_configuration_survives_json():
    config = configuration(
        scenarios=((SMALL, 2.0), (Scenario("other", steps=100), 0.5)),
        expert="lqi",
        authority=(0.3, 2.0),
        seed=7,
        timesteps=12345,
        hyperparameters={"gamma": 0.9, "net": {"pi": [3, 4]}, "lr": "lin_0.1"},
    )
    assert Config.from_dict(json.loads(json.dumps(config.to_dict()))) == config


@pytest.mark.parametrize(
    ("record", "message"),
    [
        ({"scenarios": []}, "no scenario to train on"),
        ({"scenarios": [{"scenario": {"name": "a"}}]}, "a list of scenario and weight"),
        ({"scenarios": [{"scenario": {"name": "a"}, "weight": 0}]}, "weight of scenario a is 0"),
        ({"scenarios": 3}, "a list of scenario and weight"),
        ({"speed": 3}, "no entry 'speed'"),
        ({"hyperparameters": {"a": float("nan")}}, "must be numbers, strings, lists and tables"),
        ({"seed": True}, "seed is True"),
    ],
)
def test_damaged_configuration_is_refused(record, message):
    with pytest.raises(ValueError, match=message):
        Config.from_dict(configuration().to_dict() | record)


LEAF = st.none() | st.booleans() | st.integers(-3, 200) | st.integers() | st.just(10**309) | st.floats() | st.text()
FLAT = LEAF | st.lists(LEAF, max_size=4) | st.dictionaries(st.text() | st.just("kind"), LEAF, max_size=4)
JSON = FLAT | st.lists(FLAT, max_size=3) | st.dictionaries(st.text() | st.just("kind"), FLAT, max_size=3)


@settings(deadline=None, max_examples=300)
@given(st.data())
def test_every_wrong_configuration_raises_value_error(tmp_path_factory, data):
    """One entry of config.json is any JSON."""
    file = tmp_path_factory.getbasetemp() / "config.json"
    record = configuration(hyperparameters={"n_envs": 8}).to_dict()
    (entry,) = record["scenarios"]
    table = data.draw(st.sampled_from([record, entry, entry["scenario"]]))
    table[data.draw(st.sampled_from([*table, "more"]))] = data.draw(JSON)
    file.write_text(json.dumps(record))
    try:
        read_config(file.parent)
    except ValueError as error:
        assert str(file) in str(error)  # noqa: PT017, some values are fine
        assert "\n" not in str(error)  # noqa: PT017


@settings(deadline=None, max_examples=60)
@given(st.sampled_from(list(ALGORITHMS)), st.data())
def test_every_wrong_hyperparameter_raises_value_error(algo, data):
    """One of the shipped ones, or another, is anything."""
    values = {**load_hyperparameters(shipped_file(algo)).values, "n_envs": 8}
    name = data.draw(st.sampled_from([*values, "policy_kwargs", "preview", "noise_std", "more"]))
    value = data.draw(JSON.filter(lambda x: not isinstance(x, int) or abs(x) < 10**4 or 10**15 < abs(x) < 10**300))
    try:
        request.check(configuration(algo=algo, hyperparameters={**values, name: value}))
    except ValueError as error:
        assert "\n" not in str(error)  # noqa: PT017, some values are fine


def test_vehicles_are_shared_out_by_weight():
    speed_range = request.resolved(["cruise:0.5"])
    config = configuration(scenarios=speed_range)
    counts = [config.env_scenarios(120).count(PRESETS[f"cruise-{case}"]) for case in CASES]
    assert counts == [10, 20, 10, 10, 10, 10, 20, 30]
    assert sum(weight for _, weight in speed_range) == 6.0
    assert {s.name for s in config.env_scenarios(8)} == {f"cruise-{case}" for case in CASES}
    with pytest.raises(ValueError, match="7 vehicles are too few for 8 scenarios"):
        config.env_scenarios(7)


@given(st.lists(st.integers(1, 1000), min_size=1, max_size=8), st.integers(0, 200))
def test_numbers_of_vehicles_increase_with_the_weights(weights, more):
    scenarios = tuple((replace(SMALL, name=f"s{i}"), weight) for i, weight in enumerate(weights))
    each = configuration(scenarios=scenarios).env_scenarios(len(weights) + more)
    counts = [each.count(scenario) for scenario, _ in scenarios]
    assert sum(counts) == len(each) == len(weights) + more
    assert min(counts) >= 1
    assert each == sorted(each, key=lambda s: s.name)
    for (_, a), m in zip(scenarios, counts, strict=True):
        for (_, b), n in zip(scenarios, counts, strict=True):
            assert m >= n - (a == b) or a < b
        share = len(each) * a / sum(weights)
        assert m <= max(1, share + 1)


@given(st.sampled_from(["cruise", "slow", "cruise-calm", "slow-adverse"]), st.floats(0.001, 1000.0))
def test_weights_of_scenarios_and_mixtures(name, weight):
    plain, heavy = request.resolved([name]), request.resolved([f"{name}:{weight!r}"])
    assert [s for s, _ in plain] == [s for s, _ in heavy]
    assert [w * weight for _, w in plain] == pytest.approx([w for _, w in heavy])


@given(st.text(max_size=12))
def test_unknown_scenarios_are_rejected(word):
    if word.rpartition(":")[0] in (*PRESETS, "cruise", "slow") or word in PRESETS:
        return
    with pytest.raises(UsageError):
        request.resolved([f"no-{word}"])


def test_runs_draw_from_seeds_of_their_own():
    assert TRAINING.holds(configuration().episode_seed)
    assert TRAINING.holds(configuration(seed=LARGEST_SEED).episode_seed)
    assert configuration(seed=1).episode_seed - configuration().episode_seed >= 2**20


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_shipped_hyperparameters_are_used_as_they_are(algo):
    found = load_hyperparameters(shipped_file(algo))
    assert found.timesteps >= 100_000
    for speed_range in ("slow", "cruise"):
        scenarios = request.resolved([speed_range])
        config = Config(algo, scenarios, authority=found.authority, hyperparameters=found.values)
        request.check(config)


def test_hyperparameters_are_set_one_by_one(tmp_path):
    words = ["a=3e-4", "b=lin_0.1", "c=[5,10]", "d=true", "e={net: {pi: [8]}}"]
    changes = changes_of(words)
    assert changes == {"a": 3e-4, "b": "lin_0.1", "c": [5, 10], "d": True, "e": {"net": {"pi": [8]}}}
    assert changes_of(hyperparameter_words(changes)) == changes
    given = request.Request.of(Options("ppo", ("cruise-storm",), set=("gamma=0.5",), out=tmp_path / "run"))
    plain = load_hyperparameters(shipped_file("ppo")).values
    assert given.configs[0].hyperparameters == {**plain, "gamma": 0.5}


@pytest.mark.parametrize("name", SHIPPED_TRAININGS)
def test_shipped_agents_can_be_trained_again(name, call, monkeypatch, tmp_path):
    made = []

    def begun(r):
        made.append(r)
        if r.out.name not in FIRST_TRAININGS:
            return 1
        shutil.copytree(agent_folder(name), r.out / AGENT_FOLDER)
        return 0

    monkeypatch.setattr(shipped, "train", begun)
    assert shipped.main([name, "--timesteps", "100", "--out", "out"]) == 1
    [config] = made[-1].configs
    speed_ranges = {scenario.name.split("-")[0] for scenario, _ in config.scenarios}
    if name.startswith("helm"):
        assert (config.algo, speed_ranges) == ("apg", set(SPEED_RANGES))
    else:
        family, speed_range = name.rsplit("-", 1)
        assert family.startswith(config.algo.replace("_", "-"))
        assert {speed_range} == speed_ranges
    if (agent_folder(name) / "agent.json").exists():  # the one in the package came from just this
        record = json.loads((agent_folder(name) / "agent.json").read_text(encoding="utf-8"))
        theirs = Config.from_dict(record["training"]["config"])
        first = len(made) > 1  # the agent that it starts from
        assert theirs == replace(config, timesteps=theirs.timesteps, origin=theirs.origin if first else config.origin)
    monkeypatch.setattr(command, "train", lambda r: made.append(r) or 0)
    assert call(*shlex.split(made[-1].command)[2:], "--out", tmp_path / "again") == 0
    assert made[-1].configs == (config,)


def test_shipped_agents_are_installed_and_unknown_ones_refused(call, monkeypatch, tmp_path):
    monkeypatch.setattr(shipped, "SHIPPED_FOLDER", tmp_path / "agents")
    monkeypatch.setattr(shipped, "SHIPPED_TRAININGS", {"ppo-small": training("ppo", "small.toml")})
    monkeypatch.setattr(request, "shipped", lambda algo: tmp_path / f"{algo}.yml")
    assert shipped.main(["--timesteps", "64", "--install"]) == 0
    assert same(weights("agents/ppo-small"), weights("runs/shipped/ppo-small/agent"))
    with pytest.raises(UsageError, match="unknown agent 'dqn-small'; allowed are ppo-small"):
        shipped.main(["dqn-small"])


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", ["install", "training", "training-options", "tutorials/first-agent", "tutorials/vehicle"]
)
def test_documented_commands_run(page, call, monkeypatch):
    """In their order, in one folder, with small networks for a moment; hyper-parameter files are those of the page."""
    monkeypatch.setattr("baselines.training.run_folder.validation_cell", lambda s, _: drawn(replace(s, steps=15), 1, 0))
    monkeypatch.setattr(request, "shipped", lambda algo: Path(f"{algo}.yml"))
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    for name, content in re.findall(r"^```(?:toml|yaml)\n# (\S+)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        Path(name).write_text(content, encoding="utf-8")
    found = re.findall(r"^(?:python train.py|auv-gym train) ?([^#\n]*)", text, re.MULTILINE)
    others = ("--from", "--vehicle")  # test_initial_agent.py
    lines = [line for line in found if not any(option in line for option in others)]
    assert lines
    for line in lines:
        assert call(*line.split(), "--timesteps", STEPS, "--jobs", 1) == 0, line
