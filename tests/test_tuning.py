"""The tuning command: its objective is the evaluation's error, its search improves, its files have a provenance."""

import json
from dataclasses import replace

import numpy as np
import pytest

import baselines
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.presets import CASES, PRESETS
from auv_gym.task import SIZE
from baselines.gains import loading as gain_files
from baselines.gains.loading import load_gains
from baselines.tools.command_line import DONE, UsageError
from baselines.tuning import search as tuning
from baselines.tuning.search import TUNABLES, TUNING_SEED, VALIDATION_SEED, Course, main, tune


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(gain_files, "FOLDER", tmp_path / "gains")
    monkeypatch.setattr(tuning, "FOLDER", tmp_path / "gains")
    monkeypatch.setattr(tuning, "VALIDATION_EPISODES", 8)
    return tmp_path / "gains"


def test_objective_is_the_capped_tail_error_of_single_episodes():
    seed, policy = TUNING_SEED + 40, baselines.make_policy("backstepping")
    result = Course("cruise", 8, seed).run(policy)
    commands = []
    for i, case in enumerate(CASES):
        scenario = PRESETS[f"cruise-{case}"]
        env = UnderactuatedAUVTrackEnv(replace(scenario, steps=scenario.steps + 1))
        observation, _ = env.reset(seed=seed + i)
        errors, actions = [], []
        for _ in range(scenario.steps):
            actions.append(policy.predict(observation)[0])
            observation, *_, info = env.step(actions[-1])
            errors.append(info["position_error"])
        tail = np.sqrt(np.mean(np.square(errors[scenario.steps // 3 :])))
        assert result.case_error_m[case] == pytest.approx(min(tail, 2.0), rel=1e-6)
        commands.append(actions)
    assert result.error_m == pytest.approx(np.mean(list(result.case_error_m.values())))
    assert result.effort == pytest.approx(np.mean(np.square(commands)), rel=1e-5)
    assert result.smoothness == pytest.approx(np.mean(np.square(np.diff(commands, axis=1))), rel=1e-5)


def test_policies_with_and_without_a_preview_run_the_same_course():
    class Looking:
        preview = (1, 20)

        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            assert observation.shape == (8, SIZE + 4)
            return law.predict(observation)

    course, law = Course("cruise", 8, TUNING_SEED), baselines.make_policy("backstepping")
    course.steps = 12
    assert course.run(Looking()) == course.run(law) == course.run(Looking())


def test_lost_episodes_count_with_the_cap():
    class Away:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return np.tile(np.array([[1.0, 1.0]], np.float32), (len(observation), 1)), None

    result = Course("slow", 8, TUNING_SEED).run(Away())
    assert (result.error_m, result.lost, result.smoothness) == (0.6, 1.0, 0.0)


def test_search_improves_within_its_evaluations_and_repeats():
    course = Course("slow", 8, TUNING_SEED)
    start = TUNABLES["backstepping"].start["slow"]
    before = course.run(TUNABLES["backstepping"].factory(dict(start))).error_m
    best = tune(TUNABLES["backstepping"], course, start, 30)
    assert list(best) == list(start)
    assert course.run(TUNABLES["backstepping"].factory(best)).error_m < before
    assert tune(TUNABLES["backstepping"], course, start, 30) == best


def test_file_holds_gains_and_provenance_and_can_be_resumed(folder, capsys):
    arguments = ["integral", "--regime", "slow", "--episodes", "8", "--evaluations", "1"]
    assert main([*arguments, "--dry"]) == DONE
    assert not folder.exists()
    with pytest.raises(UsageError, match="there are no gains"):
        main([*arguments, "--resume"])
    assert main(arguments) == DONE
    record = json.loads((folder / "integral-slow.json").read_text())
    assert record["command"] == f"python -m baselines.tuning {' '.join(arguments)}"
    assert {"date", "versions", "error_m", "episodes", "seed", "validation"} <= set(record)
    gains = load_gains("integral", "slow", list(record["gains"]))
    assert gains == pytest.approx(TUNABLES["integral"].start["slow"])
    capsys.readouterr()
    assert main([*arguments[:-1], "0", "--resume"]) == DONE
    assert json.loads(capsys.readouterr().out)["gains"] == pytest.approx(gains)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["nobody"], "unknown controller 'nobody'; allowed are backstepping, "),
        (["lqi", "--episodes", "12"], "--episodes is 12; it must be a positive multiple of 8"),
        (["lqi", "--seed", "0"], "--seed is 0; tuning episodes have 10000000 ... 19999999"),
        (["lqi", "--seed", str(VALIDATION_SEED)], "--seed is"),
        (["lqi", "--evaluations", "-1"], "--evaluations is -1"),
        (["lqi", "--price", "2"], "--price is 2"),
        (["lqi", "--regime", "fast"], "regime"),
    ],
)
def test_wrong_usage_is_answered_in_one_line(arguments, reason):
    with pytest.raises(UsageError, match=reason):
        main(arguments)
