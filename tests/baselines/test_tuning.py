"""The tuning command: its objective is the error of the evaluation, its search improves gains, files are complete."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import baselines
from auv_gym.envs.track_env import UnderactuatedAUVTrackEnv
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.presets import CASES, PRESETS, SPEED_RANGES, as_scenario
from baselines.evaluation.cells import drawn
from baselines.evaluation.fingerprints import changed_parts, fingerprint
from baselines.evaluation.rollout import rollout
from baselines.gains import loading as gain_files
from baselines.gains.loading import load_gains, recorded_gains
from baselines.policies import make_policy
from baselines.tools.command_line import DONE, FAILED, UsageError
from baselines.tuning import command as tuning
from baselines.tuning import search
from baselines.tuning.command import main
from baselines.tuning.objective import RATE_PRICE, SPACE_TUNABLES, TUNABLES, TuningEpisodes, tuning_scenarios
from baselines.tuning.search import EVALUATIONS, POPULATION, TUNING_EPISODES, TUNING_SEED, VALIDATION_SEED, Budget, tune


@pytest.fixture
def file(tmp_path, monkeypatch):
    """A copy of the file of gains, to which results are written."""
    copy = tmp_path / "gains.json"
    shutil.copy(gain_files.GAINS_FILE, copy)
    monkeypatch.setattr(gain_files, "GAINS_FILE", copy)
    monkeypatch.setattr(tuning, "VALIDATION_EPISODES", 16)
    gain_files.recorded_gains.cache_clear()
    yield copy
    gain_files.recorded_gains.cache_clear()


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


def test_the_rate_of_the_command_has_the_price_of_the_loss_of_helm():
    """Of each channel, in units of the error scale: `RATE_PRICE` times the mean squared rate."""
    policy, scenario = baselines.make_policy("los-pid"), PRESETS["cruise-calm"]
    priced, free = (TuningEpisodes("cruise", 8, TUNING_SEED, priced=p).run(policy) for p in (True, False))
    rate = 2 * priced.smoothness / scenario.control_dt**2
    assert priced.cost_m - priced.error_m == pytest.approx(scenario.error_scale * RATE_PRICE["cruise"] * rate)
    assert free.cost_m == free.error_m == priced.error_m


def test_a_search_that_gains_nothing_keeps_its_start(monkeypatch):
    law, start = TUNABLES["los-pid"], load_gains("los-pid", "slow", TUNABLES["los-pid"].names)
    worse = {**start, "heading": start["heading"] / 100}
    monkeypatch.setattr(search, "tune", lambda *_: worse)
    record = search.search_record(law, recording([]), start, Budget(), PAPER_VEHICLE, 16)
    assert record["gains"] == record["start"] == start
    assert record["validation"]["cost_m"] == record["validation"]["start_cost_m"]
    record = search.search_record(law, recording([]), worse, Budget(0), PAPER_VEHICLE, 16)
    assert record["gains"] == worse


def test_half_of_the_adverse_episodes_are_storms_with_faults():
    plain = [scenario.name for scenario in tuning_scenarios("slow", "plain")]
    names = [scenario.name for scenario in tuning_scenarios("slow", "adverse")]
    assert names == [*plain, *["slow-adverse"] * len(plain)]
    policy = baselines.make_policy("backstepping")
    result = TuningEpisodes("slow", 2 * len(plain), TUNING_SEED, "adverse").run(policy)
    assert list(result.case_error_m) == [*CASES, "adverse"]
    cases = [result.case_error_m[case] for case in CASES]
    mean = np.average(cases, weights=[plain.count(f"slow-{case}") for case in CASES])
    assert result.error_m == pytest.approx(0.5 * mean + 0.5 * result.case_error_m["adverse"])
    assert cases == list(TuningEpisodes("slow", len(plain), TUNING_SEED).run(policy).case_error_m.values())


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
    law, asked = TUNABLES["los-pid"], []
    start = load_gains("los-pid", "slow", law.names, "start")
    start["heading"] /= 5
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
    """All tuned gains have the same number of evaluations; the sets of the law state their origin."""
    spent, record = Budget(), gain_files.recorded_gains()
    assert spent.generations * POPULATION + 12 == spent.evaluations == EVALUATIONS >= 300
    assert sorted(record["tuned"]) == sorted(TUNABLES)
    for name, ranges in record["tuned"].items():
        assert set(ranges) == {*SPEED_RANGES, *(["space"] if name in SPACE_TUNABLES else [])}
        for speed_range, own in ranges.items():
            assert own["command"].removesuffix(" --ship") == f"auv-gym tune {name} --speed-range {speed_range}"
            assert (own["evaluations"], own["episodes"]) == (EVALUATIONS, TUNING_EPISODES), name
            assert own["world"] == TUNABLES[name].world
            assert list(own["gains"]) == list(own["start"]) == list(TUNABLES[name].names)
    assert all(part["origin"] for part in record["sets"].values())


def test_the_file_holds_gains_and_provenance(file, tmp_path, monkeypatch):
    monkeypatch.setattr(TuningEpisodes, "run", brief)
    name, before = "integral-normalised", json.loads(file.read_text())
    arguments = [name, "--speed-range", "slow", "--episodes", "32", "--evaluations", "24"]
    assert main([*arguments, "--dry-run"]) == DONE
    assert json.loads(file.read_text()) == before
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == DONE
    assert json.loads(file.read_text()) == before
    assert json.loads(Path(f"runs/tune/{name}-slow@paper.json").read_text())["gains"]
    arguments.append("--ship")
    assert main(arguments) == DONE
    after = json.loads(file.read_text())
    record = after["tuned"][name].pop("slow")
    assert record["command"] == f"auv-gym tune {' '.join(arguments)}"
    assert {"date", "versions", "evaluations", "episodes", "world", "validation"} <= set(record)
    earlier = before["tuned"][name].pop("slow")
    assert record["start"] == pytest.approx(earlier["start"])
    assert after == before
    own = tmp_path / "own.json"
    own.write_text(json.dumps({"gains": earlier["gains"]}))
    assert main([*arguments[:-2], "0", "--ship", "--start", str(own)]) == DONE
    assert load_gains(name, "slow", TUNABLES[name].names) == pytest.approx(earlier["gains"])


@pytest.mark.parametrize("name", TUNABLES)
def test_every_controller_can_be_searched(file, name, monkeypatch):
    monkeypatch.setattr(TuningEpisodes, "run", brief)
    assert main([name, "--speed-range", "slow", "--episodes", "32", "--evaluations", "0", "--ship"]) == DONE
    record = json.loads(file.read_text())["tuned"][name]["slow"]
    assert list(record["gains"]) == list(record["start"]) == list(TUNABLES[name].names)


def test_a_controller_of_a_file_is_tuned(tmp_path, monkeypatch, capsys):
    """The gains are keyword arguments of its factory; nothing of the package is written."""
    monkeypatch.chdir(tmp_path)
    Path("hand.py").write_text(
        "import numpy as np\nfrom auv_gym import decode_observation\n\n\nclass HandPoint:\n"
        "    def __init__(self, k=60.0, d=150.0):\n        self.k, self.d = k, d\n\n"
        "    def predict(self, observation, *_, **__):\n        o = decode_observation(observation)\n"
        "        F_u, F_r = o.F_uR - self.k * o.e_x, o.F_rR - 200 * o.psi_e - self.d * o.r_e\n"
        "        action = np.stack((F_u / o.F_u_max, F_r / o.F_r_max), axis=-1)\n"
        "        return np.clip(action, -1, 1), None\n"
    )
    Path("start.json").write_text('{"k": 60, "d": 150}')
    monkeypatch.setattr(TuningEpisodes, "run", brief)
    before = recorded_gains()
    arguments = ["hand.py:HandPoint", "--start", "start.json", "--episodes", "32", "--evaluations", "24"]
    assert main(arguments) == DONE
    record = json.loads(Path("runs/tune/hand-HandPoint-cruise@paper.json").read_text())
    assert list(record["gains"]) == ["k", "d"]
    assert record["start"] == {"k": 60, "d": 150}
    assert record["gains"] != record["start"]
    assert recorded_gains() == before
    Path("other").mkdir()
    Path("other/hand.py").write_text(Path("hand.py").read_text())
    with pytest.raises(UsageError, match="is the result of another controller of this name; rename one of the two"):
        main(["other/hand.py:HandPoint", *arguments[1:]])
    assert make_policy("hand.py:HandPoint", **record["gains"]).k == record["gains"]["k"]
    Path("start.json").write_text('{"gains": {"K": 60}}')
    with pytest.raises(UsageError, match=r"HandPoint of hand.py fails: .*unexpected keyword argument 'K'"):
        main(arguments)
    Path("start.json").write_text("{}")
    with pytest.raises(UsageError, match=r"start.json has the gains ; they must be numbers by name, as \{.k.: 1.5\}"):
        main(arguments)
    with pytest.raises(UsageError, match=r"hand.py:HandPoint needs --start FILE.json, the initial gains by name"):
        main(["hand.py:HandPoint"])
    with pytest.raises(UsageError, match=r"gains of hand.py:HandPoint have no known units"):
        main([*arguments, "--vehicle", "lauv"])


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ("1 / 0", "ZeroDivisionError: division by zero (bad.py, line 6)"),
        ("np.full((len(observation), 2), np.nan)", "step 0, episode 0: action is [nan nan]; it must be two finite"),
        ("np.zeros(2)", "step 0: actions have shape (2,) and type float64; for 32 observations they must be"),
    ],
)
def test_a_controller_of_a_file_that_fails_is_one_line(action, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("bad.py").write_text(
        "import numpy as np\n\n\nclass Bad:\n    def __init__(self, k): ...\n"
        f"    def predict(self, observation, *_): return {action}, None\n"
    )
    Path("start.json").write_text('{"k": 1}')
    arguments = ["bad.py:Bad", "--start", "start.json", "--episodes", "32", "--evaluations", "24"]
    assert main(arguments) == FAILED
    assert capsys.readouterr().err.startswith(f"auv-gym tune: {message}")
    assert not Path("runs").exists()


def brief(episodes, policy, run=TuningEpisodes.run):
    """Return the results of the first three steps."""
    episodes.steps = 3
    return run(episodes, policy)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["unknown"], "unknown controller 'unknown'; allowed are integral-normalised, .*, FILE.py:FACTORY"),
        (["lqi", "--episodes", "48"], "--episodes is 48; it must be a positive multiple of 32"),
        (["lqi", "--evaluations", "-1"], "--evaluations is -1"),
        (["lqi", "--episodes", "1600000"], "need seeds up to .* seeds of tuning episodes must be below 20000000"),
        (["lqi", "--error-only", "--ship"], "--ship is for controllers of the package, .* and the whole objective"),
        (["lqi", "--vehicle", "ferry"], "unknown vehicle 'ferry'; allowed are "),
        (["lqi", "--vehicle", "paper-2007"], "the limits and the lag of paper-2007 are not known; take paper"),
        (
            ["lqi", "--vehicle", "lauv", "--speed-range", "slow"],
            "has speeds from 0.056 m/s, but the fins of",
        ),
    ],
)
def test_wrong_usage_is_answered_in_one_line(arguments, reason):
    with pytest.raises(UsageError, match=reason):
        main(arguments)


@pytest.mark.parametrize("name", ["los-pid", "nmpc"])
def test_a_file_of_gains_is_a_policy(name, tmp_path):
    """That of the same gains, also as the fallback of a guard; its fingerprint follows the file."""
    gains = {key: 1.1 * gain for key, gain in load_gains(name, "cruise", TUNABLES[name].names).items()}
    file = tmp_path / "mine.json"
    file.write_text(json.dumps({"controller": name, "gains": gains}), encoding="utf-8")
    scenario = replace(as_scenario("cruise-storm@lauv"), steps=20)
    cell = drawn(scenario, 2, 0)
    policies = make_policy(str(file), scenario.known), make_policy(name, scenario.known, gains=gains)
    errors = [rollout(policy, scenario, cell.episodes).errors for policy in policies]
    np.testing.assert_array_equal(*errors)
    guarded = make_policy(f"backstepping:guard={file}", scenario.known)
    assert guarded.policy.fallback.controller.__class__ is policies[1].policy.controller.__class__
    before = fingerprint(str(file), [scenario])
    assert len(changed_parts(before, fingerprint(f"backstepping:guard={file}", [scenario]))) > 0
    file.write_text(json.dumps({"controller": name, "gains": gains | {next(iter(gains)): 2.0}}), encoding="utf-8")
    assert changed_parts(before, fingerprint(str(file), [scenario])) == ["data"]
    for wrong in ({}, [], {"controller": "backstepping", "gains": {}}, {"controller": name, "gains": {"k": 1}}):
        file.write_text(json.dumps(wrong), encoding="utf-8")
        with pytest.raises(ValueError, match="holds no gains of a controller of the package"):
            make_policy(str(file))
