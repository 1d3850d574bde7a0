"""The tuning command: its objective is the error of the evaluation, its search improves gains, files are complete."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import baselines
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.scenarios.presets import CASES, PRESETS, SPEED_RANGES
from auv_gym.task.observation import SIZE
from baselines.control.backstepping import GAINS, LAW_GAINS, SETS
from baselines.control.integral import PRINTED_GAINS
from baselines.gains import loading as gain_files
from baselines.gains.loading import load_gains
from baselines.tools.command_line import DONE, UsageError
from baselines.tuning import command as tuning
from baselines.tuning.command import main
from baselines.tuning.objective import TuningEpisodes, tuning_scenarios
from baselines.tuning.search import EVALUATIONS, POPULATION, TUNING_EPISODES, TUNING_SEED, VALIDATION_SEED, Budget, tune
from baselines.tuning.tunables import TUNABLES


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(gain_files, "GAINS_FOLDER", tmp_path / "gains")
    monkeypatch.setattr(tuning, "VALIDATION_EPISODES", 16)
    shutil.copytree(Path(gain_files.__file__).parent, tmp_path / "gains", ignore=shutil.ignore_patterns("*.py", "__*"))
    return tmp_path / "gains"


def test_objective_is_the_capped_steady_state_error_of_single_episodes():
    seed, policy = TUNING_SEED + 40, baselines.make_policy("backstepping")
    result = TuningEpisodes("cruise", 8, seed).run(policy)
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
        steady_rmse = np.sqrt(np.mean(np.square(errors[scenario.steps // 3 :])))
        assert result.case_error_m[case] == pytest.approx(min(steady_rmse, 2.0), rel=1e-6)
        commands.append(actions)
    assert result.error_m == pytest.approx(np.mean(list(result.case_error_m.values())))
    assert result.effort == pytest.approx(np.mean(np.square(commands)), rel=1e-5)
    assert result.smoothness == pytest.approx(np.mean(np.square(np.diff(commands, axis=1))), rel=1e-5)


def test_policies_with_and_without_a_preview_run_the_same_episodes():
    class WithPreview:
        preview = (1, 20)

        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            assert observation.shape == (8, SIZE + 4)
            return law.predict(observation)

    episodes, law = TuningEpisodes("cruise", 8, TUNING_SEED), baselines.make_policy("backstepping")
    episodes.steps = 12
    assert episodes.run(WithPreview()) == episodes.run(law) == episodes.run(WithPreview())


def test_half_of_the_adverse_episodes_are_storms_with_faults():
    names = [scenario.name for scenario in tuning_scenarios("slow", "adverse")]
    assert names[: len(CASES)] == [scenario.name for scenario in tuning_scenarios("slow", "plain")]
    assert names[len(CASES) :] == ["slow-adverse"] * len(CASES)
    policy = baselines.make_policy("backstepping")
    result = TuningEpisodes("slow", 16, TUNING_SEED, "adverse").run(policy)
    assert list(result.case_error_m) == [*CASES, "adverse"]
    cases = [result.case_error_m[case] for case in CASES]
    assert result.error_m == pytest.approx(0.5 * np.mean(cases) + 0.5 * result.case_error_m["adverse"])
    assert cases == list(TuningEpisodes("slow", 8, TUNING_SEED).run(policy).case_error_m.values())


def test_failed_episodes_count_with_the_cap():
    class Diverging:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            return np.tile(np.array([[1.0, 1.0]], np.float32), (len(observation), 1)), None

    result = TuningEpisodes("slow", 8, TUNING_SEED).run(Diverging())
    assert (result.error_m, result.failed, result.smoothness) == (0.6, 1.0, 0.0)


def recording(record):
    def draw(episodes, seed):
        record.append((episodes, seed))
        return TuningEpisodes("slow", episodes, seed)

    return draw


@pytest.mark.slow
def test_search_improves_within_its_evaluations_and_repeats():
    law, start, asked = TUNABLES["backstepping-tuned"], {name: getattr(GAINS["paper"], name) for name in LAW_GAINS}, []
    runs = []

    def factory(gains):
        runs.append(gains)
        return law.factory(gains)

    budget = Budget(evaluations=36, episodes=16)
    best = tune(factory, recording(asked), start, budget)
    assert list(best) == list(start)
    assert len(runs) == 2 * POPULATION + 3  # each of the final comparison has four times the episodes
    assert asked == [(16, TUNING_SEED + 16 * i) for i in range(2)] + [(64, TUNING_SEED + 32)]
    assert budget.last_seed == TUNING_SEED + 32 + 64
    validation = TuningEpisodes("slow", 32, VALIDATION_SEED)
    assert validation.run(law.factory(best)).error_m < validation.run(law.factory(dict(start))).error_m
    assert tune(law.factory, recording([]), start, budget) == best


def test_all_controllers_have_the_same_budget():
    """All files of gains have the same number of evaluations, except the expert's, which state their origin."""
    spent = Budget()
    assert spent.generations * POPULATION + 12 == spent.evaluations == EVALUATIONS >= 300
    files = sorted(set(gain_files.GAINS_FOLDER.glob("*.json")) - {SETS, gain_files.EXPONENTS})
    assert sorted(file.stem for file in files) == sorted(
        f"{name}-{speed_range}" for name in TUNABLES for speed_range in SPEED_RANGES
    )
    for file in files:
        record = json.loads(file.read_text())
        assert file.stem == f"{record['policy']}-{record['speed_range']}"
        assert record["command"] == f"auv-gym tune {record['policy']} --speed-range {record['speed_range']}"
        assert (record["evaluations"], record["episodes"]) == (EVALUATIONS, TUNING_EPISODES), file
        assert record["world"] == TUNABLES[record["policy"]].world
        assert list(record["gains"]) == list(record["start"]) == list(TUNABLES[record["policy"]].names)
    assert {name: bool(part["origin"]) for name, part in json.loads(SETS.read_text()).items()} == dict.fromkeys(
        GAINS, True
    )


def test_file_holds_gains_and_provenance_and_is_a_start(folder, capsys, monkeypatch):
    monkeypatch.setattr(TuningEpisodes, "run", brief)
    file, names = folder / "integral-slow.json", PRINTED_GAINS
    before = json.loads(file.read_text())
    arguments = ["integral", "--speed-range", "slow", "--episodes", "16", "--evaluations", "24"]
    assert main([*arguments, "--dry-run"]) == DONE
    assert json.loads(file.read_text()) == before
    assert main(arguments) == DONE
    record = json.loads(file.read_text())
    assert record["command"] == f"auv-gym tune {' '.join(arguments)}"
    assert {"date", "versions", "evaluations", "episodes", "world", "validation"} <= set(record)
    assert record["start"] == pytest.approx(before["start"])
    file.write_text(json.dumps({"start": before["start"], "gains": before["gains"]}))
    capsys.readouterr()
    assert main([*arguments[:-1], "0", "--start", str(file)]) == DONE
    assert load_gains("integral", "slow", names) == pytest.approx(before["gains"])
    file.unlink()
    with pytest.raises(
        UsageError, match=r'the file of gains .* does not exist; write initial gains, {"gains": ...}, then'
    ):
        main(arguments)


@pytest.mark.parametrize("speed_range", SPEED_RANGES)
@pytest.mark.parametrize("name", TUNABLES)
def test_every_controller_can_be_searched(folder, name, speed_range, monkeypatch):
    monkeypatch.setattr(TuningEpisodes, "run", brief)
    assert main([name, "--speed-range", speed_range, "--episodes", "16", "--evaluations", "0"]) == DONE
    record = json.loads((folder / f"{name}-{speed_range}.json").read_text())
    assert record["gains"] == record["start"]
    assert list(record["gains"]) == list(record["start"]) == list(TUNABLES[name].names)


def brief(episodes, policy, run=TuningEpisodes.run):
    """Return the results of the first three steps."""
    episodes.steps = 3
    return run(episodes, policy)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["unknown"], "unknown controller 'unknown'; allowed are backstepping-tuned, "),
        (["lqi", "--episodes", "24"], "--episodes is 24; it must be a positive multiple of 16"),
        (["lqi", "--evaluations", "-1"], "--evaluations is -1"),
        (["lqi", "--episodes", "1600000"], "need seeds up to .* seeds of tuning episodes must be below 20000000"),
        (["lqi", "--speed-range", "fast"], "speed-range"),
        (["lqi", "--vehicle", "ferry"], "unknown vehicle 'ferry'; allowed are "),
        (["lqi", "--start", "none.json"], "--start none.json has no gains"),
    ],
)
def test_wrong_usage_is_answered_in_one_line(arguments, reason):
    with pytest.raises(UsageError, match=reason):
        main(arguments)
