"""train.py: mistakes in one line, the run folder, and the same agent after interruptions."""

import math
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tomli_w
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from marks import slow_except

from auv_gym.installation import install
from auv_gym.scenarios.presets import CASES, PRESETS
from baselines.agents.agent import Agent
from baselines.agents.names import agent_folder
from baselines.evaluation.cells import drawn
from baselines.tools import command_line
from baselines.tools.command_line import parse, run
from baselines.tools.seeds import TRAINING
from baselines.training import command
from baselines.training.command import PROGRAM, Options, main
from baselines.training.config import ALGORITHMS, LARGEST_SEED, Config
from baselines.training.run_folder import RunFolder, read_config, read_progress
from baselines.training.train import learning_curves, train
from baselines.training.validation import Validation, Verdict

torch.set_num_threads(1)
ROOT = Path(__file__).parents[2]
SMALL = replace(PRESETS["cruise-current"], name="small", steps=15)
OFF_POLICY = {"buffer_size": 2000, "batch_size": 16, "learning_starts": 0, "train_freq": 8, "gradient_steps": 1}
TINY = {
    "apg": {"n_steps": 5, "hidden_size": 8},
    "ppo": {"n_steps": 16, "batch_size": 32, "learning_rate": 0.01, "use_sde": True, "sde_sample_freq": 4},
    "sac": OFF_POLICY | {"use_sde": True, "policy_kwargs": {"clip_mean": 0.0}, "initial_std": 0.1},
    "td3": OFF_POLICY | {"noise_std": 0.1, "frozen_steps": 100},
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
        write(f"{algo}.toml", **values)

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["train.py", *map(str, arguments)])
        return run(main, PROGRAM)

    return call


def write(file, **values):
    """Write a file of hyper-parameters."""
    Path(file).write_text(tomli_w.dumps({"n_envs": 8, **values}), encoding="utf-8")


def tiny(algo, *more):
    words = ("--algo", algo, "--scenario", "small.toml", "--hyperparameters", f"{algo}.toml", "--timesteps", STEPS)
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


def test_folder_of_a_run_is_not_overwritten(call, capsys):
    assert call(*tiny("ppo")) == 0
    before = {file: file.stat().st_mtime_ns for file in Path("out").rglob("*")}
    capsys.readouterr()
    for more, message in (
        ((), "finished; choose another folder, or delete it"),
        (("--seed", 1), "a run with other seed: 0 instead of 1"),
        (("--scenario", "small.toml:2", "--resume"), "a run with other scenarios; choose"),
    ):
        assert call(*tiny("ppo"), *more) == 2
        err = capsys.readouterr().err
        assert message in err
        assert err.count("\n") == 1
    assert call(*tiny("ppo"), "--resume") == 0
    assert "holds the finished agent" in capsys.readouterr().out
    assert before == {file: file.stat().st_mtime_ns for file in Path("out").rglob("*")}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--algo", "dqn"), "unknown algorithm 'dqn'; allowed are apg, ppo"),
        (("--algo", "pppo"), "unknown algorithm 'pppo' (did you mean 'ppo'?); allowed are apg, ppo"),
        (
            ("--scenario", "cruse"),
            "unknown scenario 'cruse' (did you mean 'cruise'?); allowed are a .toml or .json file",
        ),
        (("--scenario", "none.toml"), "cannot read none.toml: No such file"),
        (("--scenario", "cruise:much"), "'cruise:much' has weight 'much'; it must be a positive number"),
        (("--scenario", "cruise", "cruise-calm"), "scenario 'cruise-calm' is given twice"),
        (("--expert", "pid"), "unknown expert 'pid'; allowed are none, backstepping"),
        (("--expert", "oracle"), "expert 'oracle' needs full information"),
        (("--authority", "3"), "authority is (3.0, 3.0); it must be a number in (0, 2]"),
        (("--seed", str(LARGEST_SEED), "--seeds", "2"), "seed is 10001; it must be an integer in [0, 10000]"),
        (("--jobs", "0"), "--jobs is 0; it must be 1 or more"),
        (("--timesteps", "0"), "timesteps is 0; it must be an integer"),
        (("--timesteps", "many"), "see train.py --help"),
        (("--hyperparameters", "list.json"), "list.json has no table of hyper-parameters"),
        (("--hyperparameters", "broken.toml"), "broken.toml is not valid TOML"),
        (("--scenario", "small.toml", "--hyperparameters", "sac.toml"), "'buffer_size' of ppo; allowed are batch_size"),
        (("--set", "gamma"), "--set is 'gamma'; it must be NAME=VALUE"),
        (("--set", "gama=0.9"), "unknown hyper-parameter 'gama' of ppo; allowed are batch_size"),
        (("--set", "n_envs=2"), "2 vehicles are too few for 8 scenarios"),
        (("--set", "frozen_steps=1"), "noise_std and frozen_steps are hyper-parameters of sac and td3 only"),
        (("--set", "batch_size=1000000"), "hyper-parameters of ppo: You have specified a mini-batch size of 1000000"),
        (("--algo", "sac", "--set", "use_sde=true", "policy_kwargs={}"), "set clip_mean to 0 in policy_kwargs"),
        (("--out", "small.toml/run"), "is not a folder that can be written to"),
        (("--out", "full"), "--out full is not empty and holds no run"),
    ],
)
def test_wrong_options_give_one_line_and_create_no_files(arguments, message, call, capsys):
    Path("broken.toml").write_text("a = [", encoding="utf-8")
    Path("list.json").write_text("[1]", encoding="utf-8")
    Path("full").mkdir()
    Path("full/file").touch()
    before = set(Path().rglob("*"))
    assert call("--algo", "ppo", "--out", "out", *arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert err.count("\n") == 1
    assert set(Path().rglob("*")) == before


def test_an_agent_may_be_the_expert():
    [config] = command.configurations(Options("apg", ("cruise-storm",), expert="helm-small"))
    assert config.expert == "helm-small"


@pytest.mark.parametrize("algo", ["ppo", "td3"])
def test_divergence_is_one_line(algo, call, capsys):
    write(f"{algo}.toml", **(TINY[algo] | {"learning_rate": 1e30}))
    assert call(*tiny(algo)) == 1
    err = capsys.readouterr().err
    assert err.splitlines()[-1].startswith("training diverged after ")
    assert "Traceback" not in err


def test_a_damaged_checkpoint_is_one_line(call, capsys):
    assert call(*tiny("apg")) == 0
    shutil.rmtree("out/agent")
    Path("out/.checkpoint.pt.1.tmp").write_bytes(b"half")  # of a run that was killed during a write
    Path("out/checkpoint.pt").write_bytes(Path("out/checkpoint.pt").read_bytes()[:1000])
    capsys.readouterr()
    assert call(*tiny("apg"), "--resume") == 1
    err = capsys.readouterr().err
    assert err.startswith("cannot resume from out/checkpoint.pt: ")
    assert err.count("\n") == 1
    assert not list(Path("out").glob(".*.tmp"))


@pytest.mark.slow
def test_seeds_differ_and_each_has_a_folder(call, capsys):
    assert call(*tiny("ppo"), "--seed", 3, "--seeds", 2, "--jobs", 1) == 0
    assert "seed-3: 100%" in capsys.readouterr().err
    assert {file.name for file in Path("out").iterdir()} == {"seed-3", "seed-4", "learning_curve.png"}
    both = learning_curves({"both": Path("out"), "one": Path("out/seed-3")})
    assert both.startswith(b"\x89PNG")
    assert both != learning_curves({"both": Path("out")})
    assert both == learning_curves({"both": "out", "one": "out/seed-3"})
    with pytest.raises(ValueError, match="it must be a dict of folders"):
        learning_curves({})
    with pytest.raises(ValueError, match="elsewhere holds no run that was validated"):
        learning_curves({"none": Path("elsewhere")})
    assert not same(weights("out/seed-3/agent"), weights("out/seed-4/agent"))
    assert [read_config(Path(f"out/seed-{i}")).seed for i in (3, 4)] == [3, 4]
    assert call(*tiny("ppo"), "--seed", 3, "--out", "one") == 0
    assert same(weights("out/seed-3/agent"), weights("one/agent"))


@pytest.mark.parametrize("missing", ["torch", "stable_baselines3"])
def test_the_message_without_a_library(missing):
    code = f"import sys; sys.modules[{missing!r}] = None; sys.argv = ['train.py', '--algo', 'ppo']; import runpy\n"
    code += f"runpy.run_path({str(ROOT / 'train.py')!r}, run_name='__main__')"
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert (process.returncode, process.stdout) == (2, "")
    assert process.stderr == f"train.py needs {missing}: {install('train')}\n"


def test_options_and_words_of_a_command_line_are_the_same():
    more = {"expert": "lqi", "authority": (0.2, 0.4), "from_": "runs/a b", "vehicle": "a b.toml", "seed": 3, "jobs": 2}
    more |= {"timesteps": 9, "hyperparameters": Path("h.toml"), "out": Path("runs/a b"), "resume": True}
    whole = Options("sac", ("slow-storm:2", "a b.toml"), set=("gamma=0.5", "preview=[5, 10]"), **more)
    for options in (Options(), Options(authority=(0.1,)), whole):
        assert parse(Options, command_line.words_of(options, Options()), "train.py") == options


def test_agent_records_its_training(call):
    assert call(*tiny("ppo"), "--authority", 0.2, 0.4, "--expert", "none") == 0
    agent = Agent.load("out/agent")
    assert (agent.expert, agent.authority, agent.scenarios) == ("none", (0.2, 0.4), ("small",))
    assert Config.from_dict(agent.training["config"]) == read_config(Path("out"))
    assert agent.training["command"].startswith("python train.py --algo ppo")
    scores = [row["score"] for row in read_progress(Path("out")) if "score" in row]
    assert agent.training["validation"]["score"] == max(scores)
    assert same(dict(train(read_config(Path("out")), Path("function")).weights), dict(agent.weights))
    assert same(weights("function/agent"), dict(agent.weights))


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
        run.validation = SimpleNamespace(run=lambda policy, score=score: Verdict(score, 1.0, 0.0))
        run.log(10 * k, loss=1.0)
        mine = replace(agent, weights=dict(agent.weights))
        run.validate(mine, 10 * k)
        kept.append(run.weights is mine.weights)
    assert kept == expected
    assert run.validated["timesteps"] == 50


def configuration(**changes):
    return Config(**{"scenarios": ((SMALL, 1.0),), "algo": "ppo"} | changes)


LEAF = st.none() | st.booleans() | st.integers(-3, 200) | st.integers() | st.floats() | st.text()
FLAT = LEAF | st.lists(LEAF, max_size=4) | st.dictionaries(st.text() | st.just("kind"), LEAF, max_size=4)
JSON = FLAT | st.lists(FLAT, max_size=3) | st.dictionaries(st.text() | st.just("kind"), FLAT, max_size=3)


@settings(deadline=None, max_examples=60)
@given(st.sampled_from(list(ALGORITHMS)), st.data())
def test_every_wrong_hyperparameter_raises_value_error(algo, data):
    """One of the shipped ones, or another, is anything."""
    values = {**shipped_values(algo), "n_envs": 8}
    name = data.draw(st.sampled_from([*values, "policy_kwargs", "preview", "noise_std", "more"]))
    value = data.draw(JSON.filter(lambda x: not isinstance(x, int) or abs(x) < 10**4 or 10**15 < abs(x) < 10**300))
    try:
        command.check(configuration(algo=algo, hyperparameters={**values, name: value}))
    except ValueError as error:
        assert "\n" not in str(error)  # noqa: PT017, some values are fine


def shipped_values(algo):
    """Return the shipped hyper-parameters without the values of options."""
    return {
        name: value
        for name, value in command.read_hyperparameters(command.shipped(algo)).items()
        if name not in command.DEFAULTS
    }


def test_vehicles_are_shared_out_by_weight():
    config = configuration(scenarios=command.resolved(["cruise:0.5"]))
    counts = [config.env_scenarios(120).count(PRESETS[f"cruise-{case}"]) for case in CASES]
    assert counts == [10, 20, 10, 10, 10, 10, 20, 30]
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
    for weight, count in zip(weights, counts, strict=True):
        assert all(count >= n - (weight == other) for other, n in zip(weights, counts, strict=True) if weight >= other)
        assert count <= max(1, len(each) * weight / sum(weights) + 1)


def test_runs_draw_from_seeds_of_their_own():
    assert TRAINING.holds(configuration().episode_seed)
    assert TRAINING.holds(configuration(seed=LARGEST_SEED).episode_seed)
    assert configuration(seed=1).episode_seed - configuration().episode_seed >= 2**20


@pytest.mark.parametrize("algo", ALGORITHMS)
def test_shipped_hyperparameters_are_used_as_they_are(algo):
    values = command.read_hyperparameters(command.shipped(algo))
    for speed_range in ("slow", "cruise"):
        [config] = command.configurations(Options(algo, (speed_range,)))
        assert config.hyperparameters == shipped_values(algo)
        assert config.timesteps == values["timesteps"] >= 100_000
        assert config.authority == tuple(values["authority"])


def test_hyperparameters_are_set_one_by_one():
    changes = command.changes_of(["a=3e-4", "b=auto", "c=[5,10]", "d=true", 'e={"net":{"pi":[8]}}'])
    assert changes == {"a": 3e-4, "b": "auto", "c": [5, 10], "d": True, "e": {"net": {"pi": [8]}}}
    assert command.changes_of(command.hyperparameter_words(changes)) == changes
    [config] = command.configurations(Options("ppo", ("cruise-storm",), set=("gamma=0.5",)))
    assert config.hyperparameters == {**shipped_values("ppo"), "gamma": 0.5}


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", ["install", "training", "training-options", "tutorials/first-agent", "tutorials/vehicle"]
)
def test_documented_commands_run(page, call, monkeypatch):
    """In their order, in one folder, with small networks for a moment; hyper-parameter files are those of the page."""
    monkeypatch.setattr("baselines.training.run_folder.validation_cell", lambda s, _: drawn(replace(s, steps=15), 1, 0))
    monkeypatch.setattr(command, "shipped", lambda algo: Path(f"{algo}.toml"))
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    for name, content in re.findall(r"^```toml\n# (\S+)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        Path(name).write_text(content, encoding="utf-8")
    found = re.findall(r"^(?:python train.py|auv-gym train) ?([^#\n]*)", text, re.MULTILINE)
    others = ("--from", "--vehicle")  # test_initial_agent.py
    lines = [line for line in found if not any(option in line for option in others)]
    assert lines
    for line in lines:
        assert call(*line.split(), "--timesteps", STEPS, "--jobs", 1) == 0, line
