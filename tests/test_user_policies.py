"""Policies from users' own files: the documented examples, and mistakes in one line."""

import json
import re
import zipfile
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import evaluate
from auv_gym.presets import PRESETS
from auv_gym.vehicle import Vehicle
from baselines import common_vehicle, make_policy, make_residual_vector_env
from baselines.agents.agent import Agent
from baselines.agents.features import FEATURES
from baselines.agents.networks import Gru
from baselines.evaluation.rollout import rollout
from baselines.evaluation.runner import drawn, run_all
from baselines.tools.command_line import UsageError
from baselines.training.config import Config

PAGE = (Path(__file__).parents[1] / "docs" / "metrics.md").read_text(encoding="utf-8")
COMMON = ("--scenario", "cruise-calm", "--episodes", "2", "--jobs", "1", "--out", "out")


@pytest.fixture
def example(tmp_path, monkeypatch):
    """The module of the documentation, in the working directory."""
    monkeypatch.chdir(tmp_path)
    text = re.search(r"^```python\n(# my_policy.py\n.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)[1]
    (tmp_path / "my_policy.py").write_text(text)
    return re.search(r"--policy (my_policy.py:\w+) --scenario cruise-calm", PAGE)[1]


def test_documented_module(example, tmp_path):
    assert evaluate.main(["--policy", example, *COMMON]) == 0
    rows = json.loads((tmp_path / "out" / "results.json").read_text())["results"]
    assert [row["policy"] for row in rows] == ["backstepping", example]
    assert rows[1]["tail_rmse_m"]["mean"] < 0.5


def test_factory_takes_options(example):
    assert make_policy("my_policy.py:LineOfSight", ahead=7.0).ahead == 7.0


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("missing.py:f", "cannot read missing.py"),
        ("missing.zip", "cannot read missing.zip"),
        ("my_policy.py:nothing", "no function or class 'nothing'"),
        ("my_policy.py:np", "no function or class 'np'"),
        ("broken.py:f", "broken.py cannot be imported: SyntaxError"),
        ("other.py:fails", "fails of other.py fails: KeyError"),
        ("other.py:number", "has no method predict"),
        ("text.zip", "is no model of Stable-Baselines3"),
        ("unknown.zip", "known are those of"),
    ],
)
def test_mistakes(example, name, says, tmp_path, capsys):
    Path("broken.py").write_text("def f(:")
    Path("other.py").write_text("def fails():\n    {}['x']\n\n\ndef number():\n    return 3\n")
    Path("text.zip").write_text("no zip")
    with zipfile.ZipFile("unknown.zip", "w") as archive:
        archive.writestr("data", json.dumps({"policy_class": {"__module__": "mine"}}))
    with pytest.raises(UsageError, match=re.escape(says)):
        evaluate.main(["--policy", name, *COMMON])
    assert not Path("out").exists()


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """Untrained models of Stable-Baselines3 by the name of their file."""
    sb3 = pytest.importorskip("stable_baselines3")
    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario="cruise-calm")
    folder = tmp_path_factory.mktemp("models")
    for algorithm in ("PPO", "SAC", "TD3"):
        getattr(sb3, algorithm)("MlpPolicy", env, device="cpu").save(folder / f"{algorithm}.zip")
    other = gym.make("auv_gym:UnderactuatedAUVTrackResidual-v0")
    sb3.PPO("MlpPolicy", other, device="cpu").save(folder / "residual.zip")
    return folder


def test_documented_zip(models, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert evaluate.main(["--policy", str(models / "PPO.zip"), *COMMON]) == 0
    assert "can run any code" in capsys.readouterr().err
    assert json.loads(Path("out/results.json").read_text())["results"][1]["error"] is None


@pytest.mark.parametrize("algorithm", ["PPO", "SAC", "TD3"])
def test_zip_acts_as_its_model(models, algorithm):
    action, _ = make_policy(str(models / f"{algorithm}.zip")).predict(np.zeros((3, 18)), deterministic=True)
    assert action.shape == (3, 2)


def test_zip_of_another_task(models):
    with pytest.raises(ValueError, match=r"takes observations \(20,\)"):
        make_policy(str(models / "residual.zip"))


BELIEVING = """
from baselines.control.backstepping import Backstepping


class Law(Backstepping):
    def __init__(self, vehicle="paper"):
        super().__init__(vehicle=vehicle)


def make_open_loop():
    from baselines import make_policy

    return make_policy("open-loop")
"""


def test_policies_are_told_the_vehicle_that_the_scenario_knows(tmp_path, monkeypatch):
    """By name, as an agent's expert and from a file, the law knows the heavy vehicle of a scenario."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(BELIEVING)
    heavy = Vehicle(m11=600.0, m22=840.0, m33=300.0, d11=160.0, d22=320.0, d33=180.0, X_uu=40.0)
    scenario = PRESETS["cruise-calm"].changed(vehicle=heavy)
    network = Gru(len(FEATURES), 2, 2, 2)
    zeros = {name: np.zeros(shape, np.float32) for name, shape in network.shapes.items()}
    Agent(network, zeros, "backstepping", (0.5, 0.5)).save("agent")
    cell = drawn(scenario, 2, 0)
    told = rollout(make_policy("backstepping", vehicle=heavy), scenario, cell.episodes, 1.0).measures.tail
    wrong = rollout(make_policy("backstepping"), scenario, cell.episodes, 1.0).measures.tail
    runs = run_all(("backstepping", "./agent", "mine.py:Law", "mine.py:make_open_loop"), [cell])
    for run in runs[:3]:
        np.testing.assert_array_equal(run.measures.tail, told)
    assert runs[3].error is None
    assert told.mean() < 0.5 * wrong.mean()
    assert Config(scenarios=((scenario, 1.0),)).make_expert().vehicle == heavy
    assert make_policy("ekf", heavy).controller.slow.vehicle == heavy
    assert make_policy("open-loop", heavy)
    residual = gym.make("auv_gym:UnderactuatedAUVTrackResidual-v0", scenario=scenario)
    assert residual.unwrapped.scenario.vehicle == residual.get_wrapper_attr("expert").vehicle == heavy


def test_an_expert_by_name_is_told_the_vehicle_that_all_know():
    heavy = Vehicle(m11=600.0, m22=840.0, m33=300.0, d11=160.0, d22=320.0, d33=180.0, X_uu=40.0)
    one, other = PRESETS["cruise-calm"], PRESETS["cruise-calm"].changed(vehicle=heavy)
    assert (common_vehicle([one, one]), common_vehicle([one, other])) == (one.vehicle, None)
    for scenario, known in ((other, heavy), ([one, other], one.vehicle)):
        assert make_residual_vector_env(2, scenario).expert.vehicle == known
