"""Records of episodes, and datasets of them: equal to the environment's episodes, and deterministic."""

import os
import re
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from auv_gym.scenarios.presets import PRESETS
from auv_gym.task.observation import SIZE
from baselines import datasets as module
from baselines import list_policies, make_policy, run_episode, run_episodes
from baselines.datasets import main
from baselines.tools.command_line import UsageError

minari = pytest.importorskip("minari")
SHORT = {**PRESETS["cruise-storm"].to_dict(), "steps": 20}
LOSING = {**PRESETS["cruise-storm"].to_dict(), "steps": 200, "lost_distance": 2.0}


@pytest.mark.parametrize(("policy", "scenario"), [("integral", SHORT), ("open-loop", LOSING), ("apg-cruise", SHORT)])
def test_a_record_equals_an_episode_of_the_environment(policy, scenario):
    record, controller = run_episode(policy, scenario, seed=3), make_policy(policy)
    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario=scenario)
    observation, info = env.reset(seed=3)
    memory, first, k, over = None, np.array([True]), 0, False
    while not over:
        here = env.unwrapped
        np.testing.assert_allclose(record.observations[k], observation, rtol=0, atol=1e-10)
        np.testing.assert_allclose(record.positions[k], here.state[:2], rtol=0, atol=1e-10)
        np.testing.assert_allclose(record.references[k], here.reference[:2], rtol=0, atol=1e-10)
        np.testing.assert_allclose((record.errors[k], record.times[k]), (info["position_error"], info["time"]))
        assert record.saturated[k] == info["saturated"]
        action, memory = controller.predict(observation, memory, first)
        np.testing.assert_allclose(record.actions[k], action, rtol=0, atol=1e-6)
        observation, reward, terminated, truncated, info = env.step(record.actions[k])
        np.testing.assert_allclose(record.rewards[k], reward, rtol=0, atol=1e-10)
        first, over, k = np.array([False]), terminated or truncated, k + 1
    np.testing.assert_allclose(record.observations[k], observation, rtol=0, atol=1e-10)
    np.testing.assert_allclose(record.positions[k], env.unwrapped.state[:2], rtol=0, atol=1e-10)
    assert (len(record.rewards), len(record.errors), record.failed) == (k, k + 1, terminated)
    assert record.total_reward == record.rewards.sum()


def test_parallel_episodes_equal_single_episodes():
    for i, record in enumerate(run_episodes("open-loop", LOSING, 4, seed=5)):
        alone = run_episode("open-loop", LOSING, seed=5 + i)
        assert record.seed == alone.seed == 5 + i
        for name in ("positions", "observations", "actions", "rewards", "errors"):
            np.testing.assert_allclose(getattr(record, name), getattr(alone, name), rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match="episodes is 0"):
        run_episodes("open-loop", SHORT, 0)


def test_records_of_the_oracle_and_of_policies_with_a_preview():
    assert run_episode("oracle", SHORT, seed=0).errors[-1] < run_episode("open-loop", SHORT, seed=0).errors[-1]
    assert run_episode("apg-preview-cruise", SHORT).observations.shape[1] > SIZE
    assert {"oracle", "apg-preview-cruise"} <= set(list_policies())


@pytest.fixture
def scenario_file(tmp_path):
    file = tmp_path / "short.toml"
    text = 'name = "short"\nsteps = 15\nlost_distance = 2.0\n\n[path]\nspeed = 1.0\nturn_rate = 0.1\n'
    file.write_text(text + "\n[start]\nx_e = [-1.5, 1.5]\n", encoding="utf-8")
    return str(file)


def made(folder, scenario_file, capsys, *words):
    arguments = ["--scenario", scenario_file, "--episodes", "3", "--out", str(folder), *words]
    assert main(arguments) == 0
    name = capsys.readouterr().out.partition(":")[0]
    card = (folder / name / "README.md").read_text(encoding="utf-8")
    return re.search(r"\| `(\w{64})` \|", card)[1]


def test_datasets_are_deterministic_and_can_be_replayed(tmp_path, scenario_file, monkeypatch, capsys):
    words = (
        "--policy",
        "backstepping",
        "open-loop",
        "apg-preview-cruise",
        "--noise",
        "0",
        "0.3",
        "--id",
        "auv/test-v0",
    )
    first, again = (made(tmp_path / name, scenario_file, capsys, *words) for name in "ab")
    assert first == again
    assert made(tmp_path / "c", scenario_file, capsys, *words, "--seed", "1") != first
    card = (tmp_path / "a" / "auv" / "test-v0" / "README.md").read_text(encoding="utf-8")
    assert first in card
    assert card.count("| `open-loop` |") == 2
    assert "auv-gym dataset --scenario" in card
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "a"))
    dataset = minari.load_dataset("auv/test-v0")
    assert dataset.total_episodes == 3 * 3 * 2
    assert dataset.observation_space.shape == (SIZE,)
    env, seeds = dataset.recover_environment(), set()
    for i, episode in enumerate(dataset.iterate_episodes()):
        observation, info = env.reset(seed=i)
        assert (observation == episode.observations[0]).all()
        for k, action in enumerate(episode.actions):
            observation, reward, terminated, truncated, info = env.step(action)
            assert (terminated, truncated) == (episode.terminations[k], episode.truncations[k])
            assert reward == pytest.approx(episode.rewards[k], abs=1e-10)
            np.testing.assert_allclose(observation, episode.observations[k + 1], rtol=0, atol=1e-10)
            assert info["position_error"] == pytest.approx(episode.infos["position_error"][k + 1], abs=1e-10)
        assert terminated or truncated
        seeds.add(tuple(episode.observations[0]))
    assert len(seeds) == 18


def test_noise_has_the_given_deviation(scenario_file):
    plain, noisy = (module.collect(["open-loop"], PRESETS["cruise-calm"], 2, [noise], 0)[0] for noise in (0.0, 0.2))
    difference = np.concatenate([a.actions - b.actions for a, b in zip(noisy.records, plain.records, strict=True)])
    assert difference.std() == pytest.approx(0.2, rel=0.1)
    assert np.abs(difference.mean()) < 0.02


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--episodes", "0"], "--episodes is 0"),
        (["--noise", "2"], "--noise is 2.0"),
        (["--seed", "-1"], "--seed is -1"),
        (["--policy", "nobody"], "unknown policy 'nobody'"),
        (["--scenario", "nowhere"], "unknown scenario 'nowhere'"),
        *((["--id", name], f"--id is {name!r}") for name in ("a b", "noversion", "../../x-v0", "/tmp/x-v0")),
        (["--policy"], "--policy and --noise need one value or more"),
        (["--noise"], "--policy and --noise need one value or more"),
    ],
)
def test_wrong_arguments_raise_usage_errors(words, message, tmp_path):
    with pytest.raises(UsageError, match=re.escape(message)):
        main([*words, "--out", str(tmp_path)])


def test_messages_for_an_existing_dataset_and_a_missing_library(tmp_path, scenario_file, capsys, monkeypatch):
    made(tmp_path, scenario_file, capsys, "--id", "auv/once-v0")
    with pytest.raises(UsageError, match="exists; choose another --id"):
        main(["--scenario", scenario_file, "--episodes", "3", "--out", str(tmp_path), "--id", "auv/once-v0"])
    monkeypatch.setattr(module, "find_spec", lambda _: None)
    with pytest.raises(UsageError, match=r"pip install .*\[data\]"):
        main(["--out", str(tmp_path / "new")])


LIMITED = """
import resource, sys
from baselines.datasets import PROGRAM, main
from baselines.tools.command_line import run
if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
    sys.exit(run(main, PROGRAM))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="it has no limits of file sizes")
def test_a_write_that_fails_is_one_line(tmp_path):
    """As on a disk that another process fills meanwhile, where HDF5 prints tracebacks and crashes."""
    (tmp_path / "limited.py").write_text(LIMITED, encoding="utf-8")
    words = [sys.executable, "limited.py", "--policy", "open-loop", "--scenario", "slow-calm", "--out", "data"]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr == "auv-gym dataset: cannot continue: [Errno 5] Input/output error: 'data'\n"
    assert list((tmp_path / "data").iterdir()) == []
