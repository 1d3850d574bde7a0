"""The tuning command: its objective is the evaluation's error, its search improves, its files have a provenance."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import baselines
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.presets import CASES, PRESETS, REGIMES
from auv_gym.task import SIZE
from baselines.control.backstepping import GAINS, LAW_GAINS
from baselines.control.integral import PRINTED_GAINS
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
    shutil.copytree(Path(gain_files.__file__).parent, tmp_path / "gains", ignore=shutil.ignore_patterns("*.py", "__*"))
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
    start = {name: getattr(GAINS["paper"], name) for name in LAW_GAINS}
    before = course.run(TUNABLES["backstepping"].factory(dict(start))).error_m
    best = tune(TUNABLES["backstepping"], course, start, 30)
    assert list(best) == list(start)
    assert course.run(TUNABLES["backstepping"].factory(best)).error_m < before
    assert tune(TUNABLES["backstepping"], course, start, 30) == best


def test_file_holds_gains_and_provenance_and_can_be_resumed(folder, capsys):
    file, names = folder / "integral-slow.json", PRINTED_GAINS
    before = json.loads(file.read_text())
    arguments = ["integral", "--regime", "slow", "--episodes", "8", "--evaluations", "1"]
    assert main([*arguments, "--dry"]) == DONE
    assert json.loads(file.read_text()) == before
    assert main(arguments) == DONE
    record = json.loads(file.read_text())
    assert record["command"] == f"python -m baselines.tuning {' '.join(arguments)}"
    assert {"date", "versions", "error_m", "episodes", "seed", "validation"} <= set(record)
    gains = load_gains("integral", "slow", names)
    assert gains == pytest.approx(before["start"])  # one evaluation is spent on where the search began
    file.write_text(json.dumps({"start": before["start"], "gains": before["gains"]}))
    capsys.readouterr()
    assert main([*arguments[:-1], "0", "--resume"]) == DONE
    assert json.loads(capsys.readouterr().out)["gains"] == pytest.approx(before["gains"])
    file.unlink()
    with pytest.raises(UsageError, match=r'there are no gains in .*; write some to begin at, {"gains": ...}, then'):
        main(arguments)


@pytest.mark.parametrize("regime", REGIMES)
@pytest.mark.parametrize("name", TUNABLES)
def test_every_controller_can_be_searched(folder, name, regime, monkeypatch):
    monkeypatch.setattr(Course, "run", brief)
    assert main([name, "--regime", regime, "--episodes", "8", "--evaluations", "2"]) == DONE
    record = json.loads((folder / f"{name}-{regime}.json").read_text())
    assert record["evaluations"] == 2
    assert "origin" not in record
    assert list(record["gains"]) == list(record["start"]) == list(TUNABLES[name].names)


def brief(course, policy, run=Course.run):
    """Return what a policy does in the first three steps of a course."""
    course.steps = 3
    return run(course, policy)


def test_what_no_search_has_found_says_so():
    for file in sorted(gain_files.FOLDER.glob("*.json")):
        record = json.loads(file.read_text())
        assert record["command"].startswith(
            f"python -m baselines.tuning {record['policy']} --regime {record['regime']}"
        )
        by_hand = record.get("origin", "").startswith("set by hand")
        assert by_hand == (record["evaluations"] == 0)
        assert by_hand != ("start" in record)


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
