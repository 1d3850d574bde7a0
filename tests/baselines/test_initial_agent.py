"""train.py --from and --vehicle: where a training begins, in whose units it takes place, and what contradicts it."""

import json
import re
import shlex
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w
import torch

from auv_gym.physics.units import Units
from auv_gym.physics.vehicle import PAPER_2007
from auv_gym.scenarios.fitting import Sea, changed
from auv_gym.scenarios.mixtures import MIXTURES
from auv_gym.scenarios.presets import PRESETS, SPACE_PRESETS
from auv_gym.scenarios.records import to_record
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import vehicle_model
from baselines import make_policy
from baselines.agents.agent import Agent
from baselines.agents.names import agent_folder
from baselines.evaluation.cells import drawn
from baselines.evaluation.command import main as evaluate
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.rollout import rollout
from baselines.evaluation.runner import Run
from baselines.tools.command_line import parse, run
from baselines.tools.workers import Workers
from baselines.training import comparison
from baselines.training.apg.network import weights_of
from baselines.training.apg.settings import Settings
from baselines.training.apg.trainer import ApgTrainer
from baselines.training.command import (
    BASE_AGENT,
    FINE_TUNING_METHOD,
    PROGRAM,
    Options,
    _name,
    configurations,
    main,
    read_hyperparameters,
    shipped,
)
from baselines.training.config import Config
from baselines.training.initial_agent import OF_AGENT, fitted, in_own_units
from baselines.training.run_folder import RunFolder, read_config
from baselines.tuning.search import Budget

torch.set_num_threads(1)
pytestmark = pytest.mark.slow  # nearly all use agents that are trained for them
SMALL = replace(PRESETS["cruise-current"], name="cruise-small", steps=15)
SLOW = replace(PRESETS["slow-current"], name="slow-small", steps=15)
TINY = {"n_envs": 8, "n_steps": 5, "hidden_size": 8, "effort_weight": 0.25, "validations": 2}
STEPS = 160
ROOT = Path(__file__).parents[2]
BEGUN = ("--from", "runs/train/apg-small-slow", "--vehicle", "otter", "--timesteps", STEPS, "--no-compare")
FOUND = Path("runs/train/apg-small-slow-otter")
"""The folder of that training."""


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Return a folder with a small agent of both speed ranges, trained for the paper's vehicle."""
    folder = tmp_path_factory.mktemp("trained")
    SMALL.save(folder / "small.toml")
    SLOW.save(folder / "slow.toml")
    for name, values in (("apg", TINY), (FINE_TUNING_METHOD, {"learning_rate": 1e-3})):
        (folder / f"{name}.toml").write_text(tomli_w.dumps({"timesteps": STEPS, **values}), encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        called = caller(folder, patch)
        assert called("--scenario", "small.toml", "slow.toml") == 0
        assert called(*BEGUN) == 0
    return folder


def caller(folder, patch):
    patch.chdir(folder)
    patch.setattr("baselines.training.validation.VALIDATED_EPISODES", 3)
    patch.setattr("baselines.training.apg.trainer.LOGS", 5)
    patch.setattr("baselines.training.command.shipped", lambda name: Path(f"{name}.toml"))

    def call(*arguments):
        patch.setattr(sys, "argv", ["train.py", *map(str, arguments)])
        return run(main, PROGRAM)

    return call


@pytest.fixture
def call(trained, tmp_path, monkeypatch):
    shutil.copytree(trained, tmp_path, dirs_exist_ok=True)
    return caller(tmp_path, monkeypatch)


def weights(folder):
    return dict(Agent.load(folder).weights)


def at_the_end(folder):
    """Return the weights at the end of a run; its agent has those that did best, perhaps those of its beginning."""
    return {
        k: w.numpy() for k, w in RunFolder(read_config(folder), folder).load_checkpoint()["modules"]["network"].items()
    }


def same(a, b):
    return a.keys() == b.keys() and all(np.array_equal(a[name], b[name]) for name in a)


def test_training_from_an_agent_for_a_vehicle(call):
    config, agent = read_config(FOUND), Agent.load(FOUND / "agent")
    begun = ApgTrainer(RunFolder(config, Path("new")))
    assert same(weights_of(begun.network), weights("runs/train/apg-small-slow/agent"))
    assert same(weights_of(begun.averaged.module), weights("runs/train/apg-small-slow/agent"))
    assert not same(weights_of(begun.network), at_the_end(FOUND))
    assert config.origin.agent == "runs/train/apg-small-slow"
    assert config.steers == vehicle_model("otter").vehicle
    assert config.names == agent.scenarios == ("cruise-small@otter", "slow-small@otter")
    assert Units.of(config.vehicle) == Units()
    assert config.vehicle.m22 / config.vehicle.m11 == pytest.approx(config.steers.m22 / config.steers.m11)
    assert config.hyperparameters["hidden_size"] == 8
    assert config.hyperparameters["effort_weight"] == 0.25
    assert agent.training["config"]["steers"]["m11"] == config.steers.m11


def test_validation_in_vehicle_units_equals_evaluation_in_metres(call):
    """The similarity from end to end: an evaluation in SI units knows nothing of how an agent was trained."""
    folder, config = FOUND, read_config(FOUND)
    here = config.scenarios[0][0]
    there = replace(changed(SMALL, "otter"), substeps=here.substeps)
    length = Units.of(there.vehicle).length
    policies = make_policy(str(folder), there.vehicle), Agent.load(folder / "agent").policy(vehicle=config.vehicle)
    steady_rmses = [
        rollout(policy, scenario, drawn(scenario, 3, 7).episodes).measures.steady_rmse
        for policy, scenario in zip(policies, (there, here), strict=True)
    ]
    np.testing.assert_allclose(steady_rmses[0] / length, steady_rmses[1], rtol=1e-4)
    assert steady_rmses[1].min() > 1e-3


def test_an_initial_agent_that_has_changed_is_refused(call, capsys):
    agent = Agent.load("runs/train/apg-small-slow/agent")
    replace(agent, weights={k: 2 * w for k, w in agent.weights.items()}).save("runs/train/apg-small-slow/agent")
    assert call(*BEGUN, "--resume") == 2
    assert "a run with other origin" in capsys.readouterr().err


def test_an_agent_for_a_vehicle_can_be_trained_further(call, capsys):
    again = ("--from", FOUND, "--timesteps", 40, "--out", "again")
    assert call(*again) == 0
    assert read_config(Path("again")).scenarios == read_config(FOUND).scenarios
    assert read_config(Path("again")).steers == vehicle_model("otter").vehicle
    capsys.readouterr()
    assert call(*again, "--vehicle", "lauv") == 2
    assert "has its own vehicle, so it cannot be adapted to another one" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--from", "helmm"), "unknown agent 'helmm' (did you mean 'helm'?); allowed are the folder of an agent, "),
        (("--from", "ppo-cruise"), "'ppo-cruise' was trained by ppo; a training can start only from an agent of apg"),
        (("--algo", "ppo"), "--from requires the algorithm apg, not ppo; leave out --algo"),
        (("--expert", "lqi"), "corrects backstepping; leave out --expert lqi"),
        (("--set", "hidden_size=64"), "was trained with hidden_size 8; leave out hidden_size=64"),
        (("--set", "fine=true"), "has another network, or other inputs, than the settings"),
        (("--vehicle", "lauv", "--scenario", "slow-calm"), "fins of this vehicle need at least 0.25 m/s"),
        (("--scenario", "paper-circle"), "has a fixed path, which cannot be converted to the units of its vehicle"),
    ],
)
def test_wrong_options_give_one_line_and_create_no_files(arguments, message, call, capsys):
    before = set(Path().rglob("*"))
    assert call(*BEGUN, "--out", "out", *arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err.splitlines()[-1]
    assert set(Path().rglob("*")) == before


@pytest.fixture
def brief(call, monkeypatch):
    """Make storms and searches short, and return the words of a training with a comparison at its end."""
    for name in (name for name in PRESETS if name.startswith("cruise-")):
        monkeypatch.setitem(PRESETS, name, replace(PRESETS[name], steps=20))
    monkeypatch.setattr(comparison, "CONTROLLERS", {"los-pid": Budget(1, 8), "nmpc": Budget(0, 8)})
    monkeypatch.setattr(comparison, "CHECKED", 8)
    monkeypatch.setattr(comparison, "EPISODES", 3)
    return "--from", "runs/train/apg-small-slow", "--vehicle", "lauv", "--timesteps", 40, "--jobs", 1, "--out", "out"


def test_the_comparison_at_the_end(brief, call, capsys):
    """An evaluation of the same episodes finds the same errors; the sea is that of the training."""
    assert call(*brief, "--scenario", "small.toml", "--current", 0.1, 0.2, "--waves", 0) == 0
    printed, record = capsys.readouterr().out, json.loads(Path("out/comparison.json").read_text(encoding="utf-8"))
    assert Path("out/comparison.md").read_text(encoding="utf-8") in printed
    scenario = Scenario.load("out/storm.toml")
    assert (scenario.name, scenario.waves, scenario.known) == ("cruise-storm-sea@lauv", None, vehicle_model("lauv"))
    assert scenario.current.speed == (0.1, 0.2)
    found = {row["policy"]: row for row in record["rows"]}
    guarded = [name for name in found if name.startswith("agent:guard=gains/")]
    controllers = {"gains/los-pid.json", "gains/nmpc.json", "backstepping", "clairvoyant"}
    assert {*found} == {"agent", *guarded, "runs/train/apg-small-slow"} | controllers
    assert run(evaluate, "evaluate", [*shlex.split(record["evaluate"])[2:], "--out", "again"]) == 0
    for result in json.loads(Path("again/results.json").read_text(encoding="utf-8"))["results"]:
        row = found[result["policy"].replace("out/", "")]
        assert row["error_m"] == pytest.approx(result["steady_rmse_m"]["mean"])
        assert row["failed"] == row["avoidable"] == 0
    errors = {
        name: json.loads(Path(f"out/gains/{name}.json").read_text())["validation"] for name in ("los-pid", "nmpc")
    }
    assert guarded == [f"agent:guard=gains/{min(errors, key=lambda name: errors[name]['error_m'])}.json"]


def test_the_comparison_in_space(brief, tmp_path, monkeypatch):
    """There is no guard in space; storms and searches are those in space."""
    for name, preset in [*SPACE_PRESETS.items()]:
        monkeypatch.setitem(SPACE_PRESETS, name, replace(preset, steps=20))
    agent, lauv = str(agent_folder("helm-3d")), comparison.Comparison(vehicle_model("lauv"), Sea(), "helm-3d", True)
    comparison.compare(lauv, [Path(agent)], tmp_path / "out", Workers(1))
    record = json.loads((tmp_path / "out" / "comparison.json").read_text(encoding="utf-8"))
    assert record["scenario"] == "space-storm@lauv"
    found = {row["policy"]: row["error_m"] for row in record["rows"]}
    own = {agent, "helm-3d", "gains/los-pid.json", "gains/nmpc.json"}
    assert {*found} == {*own, "backstepping", "clairvoyant"}
    assert found["helm-3d"] == found[agent]


def test_an_interrupted_comparison_is_continued(brief, call, capsys, monkeypatch):
    def interrupted(_):
        raise KeyboardInterrupt

    words = *brief, "--scenario", "small.toml"
    with monkeypatch.context() as patch:
        patch.setattr("baselines.evaluation.evaluate.run_request", interrupted)
        assert call(*words) == 1
    assert "repeat the command with --resume" in capsys.readouterr().err
    files = [Path("out/agent/agent.json"), Path("out/gains/nmpc.json"), Path("out/gains/los-pid.json")]
    before = [file.stat().st_mtime_ns for file in files]
    assert not Path("out/comparison.json").exists()
    assert call(*words) == 2
    assert "unfinished; add --resume" in capsys.readouterr().err
    assert call(*words, "--resume") == 0
    assert Path("out/comparison.json").exists()
    assert call(*words) == 2
    assert "finished; choose another folder" in capsys.readouterr().err
    with monkeypatch.context() as patch:
        patch.setattr("baselines.evaluation.evaluate.run_request", interrupted)
        assert call(*words, "--resume") == 0  # there is nothing left to do
    assert [file.stat().st_mtime_ns for file in files] == before


def test_a_failure_is_avoidable_if_another_policy_does_not_fail():
    scenario = replace(PRESETS["cruise-storm"], steps=3)
    cell = drawn(scenario, 4, 0)
    measures = rollout(make_policy("open-loop"), scenario, cell.episodes).measures
    ended = {
        "a": [True, True, False, True],
        "b": [False, True, False, False],
        "clairvoyant": [False, True, False, True],
    }
    steady = np.array([0.5, 0.5, 0.5, 9.0])
    runs = [
        Run(f"out/{name}", scenario, "", replace(measures, steady_rmse=steady / 10, failed=np.array(failed)))
        for name, failed in ended.items()
    ]
    record = comparison.results(runs, Path("out"))
    rows = {row["policy"]: (row["failed"], row["avoidable"]) for row in record["rows"]}
    assert rows == {"a": (3, 2), "b": (1, 0), "clairvoyant": (2, 1)}
    assert [row["policy"] for row in record["rows"]] == ["b", "clairvoyant", "a"]
    assert record["rows"][-1]["error_m"] == pytest.approx((3 * record["cap_m"] + 0.05) / 4)
    assert "| a | 1.51 (" in comparison.table(record)


def test_training_for_a_vehicle_without_an_agent(call):
    words = "--from", "none", "--vehicle", "otter", "--scenario", "small.toml", "--timesteps", 40, "--no-compare"
    assert call(*words) == 0
    config = read_config(Path("runs/train/apg-small-otter"))
    assert (config.origin, config.steers) == (None, vehicle_model("otter").vehicle)
    assert (config.expert, config.whole_model) == ("los-pid", True)


@pytest.mark.parametrize(("vehicle", "ranges"), [("eca-a9", {"cruise"}), ("otter", {"cruise", "slow"})])
def test_a_vehicle_alone_is_enough(vehicle, ranges):
    """Fine-tuning of the agent for all vehicles, in the speed ranges in which the vehicle can steer."""
    [config] = configurations(Options(vehicle=vehicle))
    assert config.origin.agent == BASE_AGENT
    assert {name.partition("-")[0] for name in config.names} == ranges
    assert config.hyperparameters["n_envs"] == read_hyperparameters(shipped(FINE_TUNING_METHOD))["n_envs"]
    assert configurations(Options(vehicle=vehicle, expert="ilos"))[0].origin is None
    assert configurations(Options(vehicle=vehicle, from_="helm"))[0].origin.agent == "helm"


def test_the_sea_of_a_training_is_that_of_the_user():
    """In m/s, although the scenarios are in the units of the vehicle."""
    [config] = configurations(Options(vehicle="lauv", current=(0.1, 0.3), waves=0.5))
    [usual] = configurations(Options(vehicle="lauv"))
    speed = Units.of(vehicle_model("lauv").vehicle).factor(length=1, time=-1)
    found = []
    for (own, _), (before, _) in zip(config.scenarios, usual.scenarios, strict=True):
        assert own.name == before.name.replace("@", "-sea@")
        episode, waves = own.draw(np.random.default_rng(1)), before.draw(np.random.default_rng(1)).waves
        found.append(np.hypot(episode.current.V_x, episode.current.V_y) * speed)
        assert (episode.waves and episode.waves.yaw) == (waves and pytest.approx(0.5 * waves.yaw))
    assert 0.1 <= min(found) < 0.2 < max(found) <= 0.3
    assert _name(Options(vehicle="lauv", current=(0.1, 0.3), waves=0.5)) == "helm-any-lauv-current-0.1-0.3-waves-0.5"
    with pytest.raises(ValueError, match="name it with --vehicle"):
        configurations(Options(waves=0.0))
    with pytest.raises(ValueError, match="current speed is"):
        configurations(Options(vehicle="lauv", current=(0.3, 0.1)))


@pytest.mark.parametrize("expert", ["los-pid", "nmpc", "backstepping"])
def test_the_expert_of_a_run_for_a_vehicle_is_the_controller_of_the_evaluation(expert, call, tmp_path):
    """Limits and lag of the vehicle file decide its gains: in training, validation, saved agent and evaluation."""
    lauv = vehicle_model("lauv")
    model = replace(lauv, name="own", lag=0.9, vehicle=replace(lauv.vehicle, d33=lauv.vehicle.d33 * 1.01))
    Path("own.toml").write_text(tomli_w.dumps(to_record(model)), encoding="utf-8")
    words = ("--from", "none", "--vehicle", "own.toml", "--scenario", "small.toml", "--expert", expert)
    options = parse(Options, [*words, "--set", "n_envs=2", "groups=1"], PROGRAM)
    [config] = configurations(options)
    assert config == Config.from_dict(config.to_dict())
    assert Config.from_dict(config.to_dict()).known == config.known == model.in_paper_units
    run = RunFolder(config, tmp_path / "run")
    trainer = ApgTrainer(run)
    agent = replace(trainer.agent(trainer.weights), training={"config": config.to_dict()})
    named = make_policy(expert, model)
    agent.save("agent")
    assert Agent.load("agent").whole_model
    scenario = changed(SMALL, model)
    episodes = drawn(scenario, 2, 5).episodes
    errors = [rollout(p, scenario, episodes).errors for p in (named, make_policy("agent", model))]
    np.testing.assert_array_equal(*errors)
    own = config.scenarios[0][0]
    episodes = drawn(own, 2, 5).episodes
    experts = agent.policy(config.known), make_policy(expert, config.known), trainer.groups._mine[0].expert
    errors = [rollout(p, own, episodes).errors for p in experts]
    np.testing.assert_array_equal(errors[0], errors[1])
    np.testing.assert_array_equal(errors[0], errors[2])
    replace(agent, whole_model=False).save("earlier")  # as those of earlier versions: for the parameters only
    assert fingerprint("earlier") != fingerprint("agent")
    earlier = rollout(make_policy("earlier", model), scenario, drawn(scenario, 2, 5).episodes).errors
    bare = rollout(make_policy(expert, model.vehicle), scenario, drawn(scenario, 2, 5).episodes).errors
    np.testing.assert_array_equal(earlier, bare)
    [config] = configurations(replace(options, from_="agent", expert=None))
    assert config.whole_model
    [config] = configurations(replace(options, from_="earlier", expert=None))
    assert not config.whole_model


def test_scenarios_too_slow_for_the_fins_are_left_out():
    mixture, reasons = fitted(MIXTURES["helm"], vehicle_model("lauv"))
    assert len(mixture) + len(reasons) == len(MIXTURES["helm"])
    assert {scenario.name.partition("-")[0] for scenario, _ in mixture} == {"cruise"}
    own, steers = in_own_units(mixture)
    assert steers == vehicle_model("lauv").vehicle
    assert len({scenario.substeps for scenario, _ in own}) == 1
    assert [weight for _, weight in own] == [weight for _, weight in mixture]
    assert in_own_units(MIXTURES["cruise"]) == (MIXTURES["cruise"], None)  # those of the paper's vehicle


def test_a_vehicle_without_known_actuators_is_trained_for_as_well():
    mixture, reasons = fitted(MIXTURES["cruise"], "paper-2007")
    assert {scenario.vehicle for scenario, _ in mixture} == {PAPER_2007}
    assert len(mixture) + len(reasons) == len(MIXTURES["cruise"])


def test_rates_rise_and_fall():
    shares = [Settings(warm_up=0.25, final_share=0.1).share_at(x) for x in np.linspace(0, 1, 101)]
    assert shares[0] == 0.0
    assert np.argmax(shares) == 25
    assert shares[25:] == [Settings(final_share=0.1).share_at(x) for x in np.linspace(0, 1, 101)[25:]]
    with pytest.raises(ValueError, match="warm_up is 2"):
        Settings(warm_up=2)


def test_rates_begin_again_at_half():
    once, again = (Settings(restart=x, final_share=0.1) for x in (0.0, 0.6))
    for x in np.linspace(0, 0.99, 34):
        assert again.share_at(0.6 * x) == pytest.approx(once.share_at(x))
        if x >= 0.1:
            assert again.share_at(0.6 + 0.4 * x) == pytest.approx(0.5 * once.share_at(x))
    assert again.share_at(0.6) == pytest.approx(0.0, abs=1e-9)


def test_fine_tuning_keeps_agent_and_objective():
    """Only rates, length, windows and number of vehicles are other."""
    values = read_hyperparameters(shipped(FINE_TUNING_METHOD))
    assert not {*values} & {*OF_AGENT, "effort_weight", "rate_weight", "derivative_bound", "expert", "authority"}
    assert values["timesteps"] < read_hyperparameters(shipped("apg"))["timesteps"]


@pytest.mark.parametrize("page", ["fine-tuning", "tutorials/log-to-agent"])
def test_documented_commands_run(page, call, monkeypatch):
    """In their order, with a small agent in the place of the one that ships; vehicle.toml is that of the tutorial."""
    monkeypatch.setattr(
        "baselines.training.initial_agent.agent_folder", lambda _: Path("runs/train/apg-small-slow/agent")
    )
    monkeypatch.setattr("baselines.training.run_folder.validation_cell", lambda s, _: drawn(replace(s, steps=15), 1, 0))
    tutorial = (ROOT / "docs" / "tutorials" / "log-to-agent.md").read_text(encoding="utf-8")
    Path("vehicle.toml").write_text(
        re.search(r"^```toml\n(.*?)^```$", tutorial, re.MULTILINE | re.DOTALL)[1], encoding="utf-8"
    )
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    lines = re.findall(r"^(?:python train.py|auv-gym train) ([^#\n]*--vehicle[^#\n]*)", text, re.MULTILINE)
    assert lines
    for line in lines:
        scenario = () if "--scenario" in line else ("--scenario", "small.toml")
        assert call(*line.split(), *scenario, "--timesteps", 40, "--no-compare") == 0, line
