"""Policies from users' own files: the documented examples, and mistakes in one line."""

import json
import re
import zipfile
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import evaluate
from baselines import make_policy
from baselines.tools.command_line import UsageError

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
