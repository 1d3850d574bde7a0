"""Effects of a user in evaluations, in trainings and in the residual environment."""

import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from auv_gym.scenarios.presets import PRESETS
from baselines import make_policy
from baselines.evaluation import command as evaluation
from baselines.evaluation.cells import drawn
from baselines.evaluation.fingerprints import simulator_fingerprint
from baselines.evaluation.rollout import rollout
from baselines.residual_envs import make_residual_env, make_residual_vector_env
from baselines.tools.command_line import run
from baselines.training import command as training
from examples.effects import DeadZone, DriftingCompass, TowedBody, Wall

ROOT = Path(__file__).parents[2]
MINE = replace(
    PRESETS["cruise-storm"], name="mine", steps=60, effects=(DeadZone(0.1), DriftingCompass(), TowedBody(), Wall())
)


@pytest.fixture
def call(monkeypatch, tmp_path):
    """Run a command in-process in a folder with a scenario and the file of its effects, and return its exit status."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    shutil.copy(ROOT / "examples" / "effects.py", "own_effects.py")
    MINE.save("mine.toml")
    yield lambda module, *words: run(module.main, module.PROGRAM, [str(word) for word in words])
    sys.modules.pop("own_effects", None)


def test_an_evaluation_has_them_in_its_worker_processes(call):
    words = "--scenario", "mine.toml", "--policy", "los-pid", "--effects", "own_effects.py", "--episodes", 4
    for jobs in (1, 2):
        assert call(evaluation, *words, "--jobs", jobs, "--out", jobs) == 0
    one, two = (json.loads((Path(name) / "results.json").read_text(encoding="utf-8")) for name in "12")
    times = ("seconds", "decision_ms")
    rows, others = ([{k: v for k, v in row.items() if k not in times} for row in r["results"]] for r in (one, two))
    assert rows == others
    (mine,) = (row["rmse_m"] for row in rows if row["policy"] == "los-pid")
    expected = rollout(make_policy("los-pid"), MINE, drawn(MINE, 4, 0).episodes).measures
    assert mine == pytest.approx(expected.rmse.mean(), rel=1e-9)


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("missing.py", None, "cannot read missing.py: No such file or directory"),
        ("own.txt", "", "own.txt must be a Python file whose name is not that of another module: rename it"),
        ("json.py", "", "json.py must be a Python file whose name is not that of another module: rename it"),
        ("broken.py", "1 / 0", "broken.py cannot be imported: ZeroDivisionError: division by zero"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(call, capsys, file, content, message):
    if content is not None:
        Path(file).write_text(content, encoding="utf-8")
    assert call(evaluation, "--scenario", "mine.toml", "--effects", file) == 2
    assert capsys.readouterr().err == f"evaluate.py: {message}\n"


def test_full_information_does_not_include_them(call, capsys):
    words = "--scenario", "mine.toml", "--policy", "clairvoyant", "oracle", "--effects", "own_effects.py"
    assert call(evaluation, *words, "--episodes", 2, "--jobs", 1) == 1
    says = " ".join(capsys.readouterr().err.split())
    for name in ("clairvoyant", "oracle"):
        assert f"{name} in mine, ValueError: full information does not include the effect 'dead_zone'" in says


@pytest.mark.parametrize("algo", ["apg", "ppo"])
def test_agents_are_trained_with_them(call, algo):
    settings = ("n_steps=5", "hidden_size=8") if algo == "apg" else ("n_steps=16", "batch_size=32", "n_envs=8")
    words = "--algo", algo, "--scenario", "mine.toml", "--effects", "own_effects.py", "--timesteps", 320
    assert call(training, *words, "--jobs", 1, "--set", *settings, "--out", "run") == 0
    assert (Path("run") / "agent" / "agent.json").exists()


def test_a_zero_correction_is_the_expert_for_one_vehicle_and_for_many():
    one, many = make_residual_env(MINE), make_residual_vector_env(3, MINE)
    alone, together = one.reset(seed=4)[0], many.reset(seed=4)[0][0]
    expected = rollout(make_policy("backstepping"), MINE, drawn(MINE, 1, 4).episodes).measures
    total = 0.0
    for _ in range(MINE.steps):
        np.testing.assert_array_equal(alone, together)
        alone, reward, *_ = one.step(np.zeros(2))
        together = many.step(np.zeros((3, 2)))[0][0]
        total += reward
    assert total == pytest.approx(expected.total_reward[0], rel=1e-9)


def test_the_fingerprint_of_the_simulator_has_their_source():
    plain, mine = (simulator_fingerprint([s]) for s in (PRESETS["cruise-storm"], MINE))
    assert plain != mine
    assert simulator_fingerprint([replace(MINE, effects=MINE.effects[:1])]) not in (plain, mine)
