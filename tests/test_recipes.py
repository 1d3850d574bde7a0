"""The changes that docs/extending-source.md shows, made in a copy: what they add works in every environment."""

import csv
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs/extending-source.md").read_text(encoding="utf-8")
IGNORED = shutil.ignore_patterns("__pycache__")


@pytest.fixture
def copy(tmp_path):
    for room in ("auv_gym", "baselines"):
        shutil.copytree(ROOT / room, tmp_path / room, ignore=IGNORED)
    shutil.copy(ROOT / "evaluate.py", tmp_path)
    return tmp_path


def apply(recipe, folder):
    """Make the changes of a recipe, whose block names files (+++) and has parts (@@), each found once in its file."""
    block = re.search(rf"^## {recipe}\n.*?^```diff\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)[1]
    for change in block.split("+++ ")[1:]:
        name, _, lines = change.partition("\n")
        file = folder / name
        text = file.read_text(encoding="utf-8")
        for part in lines.split("@@\n"):
            marked = part.splitlines(keepends=True)
            before = "".join(line[1:] for line in marked if line[0] != "+")
            assert text.count("\n" + before) == 1, (name, before)
            text = text.replace("\n" + before, "\n" + "".join(line[1:] for line in marked if line[0] != "-"))
        file.write_text(text, encoding="utf-8")


def python(folder, *arguments):
    done = subprocess.run([sys.executable, *arguments], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


TERM = """
import numpy as np
from dataclasses import replace
from auv_gym import PRESETS, decode_observation
from auv_gym.envs import make_track_vector_env
from auv_gym.physics.sensors import Sensors
from baselines import make_policy
from baselines.evaluation.rollout import make_env

scenario = replace(PRESETS["slow-calm"], sensors=Sensors(outages=20.0, outage_time=1.0))
policy = make_policy("backstepping")
env, vector_env = make_env(scenario), make_track_vector_env(2, scenario)
(observation, _), (rows, _) = env.reset(seed=0), vector_env.reset(seed=0)
assert env.observation_space.shape == (19,) and vector_env.single_observation_space.shape == (19,)
fixes = []
for _ in range(300):
    assert env.observation_space.contains(observation)
    np.testing.assert_allclose(rows[0], observation, atol=1e-9)
    fixes.append(decode_observation(observation).fix)
    assert fixes[-1] == decode_observation(rows).fix[0]
    observation, *_ = env.step(policy.predict(observation)[0])
    rows, *_ = vector_env.step(policy.predict(rows)[0])
assert set(fixes) == {0.0, 1.0}, set(fixes)
print(env.unwrapped.__doc__)
"""
CONSTANT = """
import numpy as np
from dataclasses import replace
from auv_gym import PRESETS
from auv_gym.envs import make_track_vector_env
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.rollout import make_env

plain = PRESETS["slow-calm"]
scenario = replace(plain, effort_weight=0.5)
assert Scenario.from_dict(scenario.to_dict()) == scenario and "effort_weight" not in plain.to_dict()
rewards = {}
for s in (plain, scenario):
    env, vector_env = make_env(s), make_track_vector_env(2, [plain, s])
    env.reset(seed=1), vector_env.reset(seed=[1, 1])
    rewards[s.effort_weight] = env.step(np.array((0.4, -0.2)))[1]
    row = vector_env.step(np.full((2, 2), (0.4, -0.2)))[1]
    np.testing.assert_allclose(row, (rewards[0.0], rewards[s.effort_weight]), atol=1e-12)
np.testing.assert_allclose(rewards[0.0] - rewards[0.5], 0.5 * (0.4**2 + 0.2**2), atol=1e-12)
"""
ON_TORCH = """
from auv_gym.envs.torch_sim import TorchSimulator

sim = TorchSimulator(2, "slow-calm", compiled=False)
observation, _ = sim.reset(seed=0)
assert observation.shape == (2, 19) and (observation[:, 18] == 1).all()
"""


@pytest.mark.slow
def test_a_term_of_the_observation(copy):
    apply("Add a term to the observation", copy)
    assert "| 18  | fix " in python(copy, "-c", TERM)
    pytest.importorskip("torch")
    python(copy, "-c", ON_TORCH)


def test_a_constant_of_an_episode(copy):
    apply("Add a constant of an episode", copy)
    python(copy, "-c", CONSTANT)


@pytest.mark.slow
def test_an_option_and_a_column(copy):
    apply("Add an option", copy)
    apply("Add a column to the report", copy)
    help_text = python(copy, "evaluate.py", "--help")
    assert "--brief" in help_text
    assert "Print no tables" in help_text
    words = "evaluate.py", "--scenario", "slow-calm", "--episodes", "1", "--jobs", "1"
    assert "steady [cm]" in python(copy, *words, "--out", "loud")
    assert "steady_rmse" not in python(copy, *words, "--out", "brief", "--brief")
    assert '"steady_cm": ' in (copy / "brief" / "results.json").read_text(encoding="utf-8")
    with (copy / "brief" / "results.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            assert float(row["steady_cm"]) == pytest.approx(100 * float(row["steady_rmse_m"]))
    assert "steady [cm]" in (copy / "brief" / "report.html").read_text(encoding="utf-8")
