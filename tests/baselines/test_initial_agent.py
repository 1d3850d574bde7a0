"""train.py --from and --vehicle: where a training begins, in whose units it takes place, and what contradicts it."""

import json
import re
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from auv_gym.physics.units import Units
from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.mixtures import MIXTURES
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import vehicle_model
from baselines import make_policy
from baselines.agents.agent import Agent
from baselines.evaluation.rollout import rollout
from baselines.evaluation.runner import drawn
from baselines.tools.command_line import run
from baselines.training.apg.groups import Groups
from baselines.training.apg.settings import Settings, check
from baselines.training.apg.torch_network import weights_of
from baselines.training.apg.trainer import ApgTrainer
from baselines.training.entry import main
from baselines.training.hyperparameters import FINE_TUNING_FILE_NAME, TRAINED_ENV, load_hyperparameters, shipped
from baselines.training.initial_agent import OF_AGENT, fitted, in_own_units
from baselines.training.options import PROGRAM
from baselines.training.run_folder import RunFolder, read_config, read_progress
from research.trainings import fine_tuning

torch.set_num_threads(1)
pytestmark = pytest.mark.slow  # nearly all use agents that are trained for them
SMALL = replace(PRESETS["cruise-current"], name="cruise-small", steps=15)
SLOW = replace(PRESETS["slow-current"], name="slow-small", steps=15)
TINY = {"n_envs": 8, "n_steps": 5, "hidden_size": 8, "effort_weight": 0.25, "validations": 2}
STEPS = 160
ROOT = Path(__file__).parents[2]
BEGUN = ("--from", "runs/train/apg-small-slow", "--vehicle", "otter", "--timesteps", STEPS)
FOUND = Path("runs/train/apg-small-slow-otter")
"""The folder of that training."""


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Return a folder with a small agent of both speed ranges, trained for the paper's vehicle."""
    folder = tmp_path_factory.mktemp("trained")
    SMALL.save(folder / "small.toml")
    SLOW.save(folder / "slow.toml")
    tables = {
        TRAINED_ENV: {**TINY, "n_timesteps": STEPS},
        FINE_TUNING_FILE_NAME: {"n_timesteps": STEPS, "learning_rate": 1e-3},
    }
    (folder / "apg.yml").write_text(yaml.safe_dump(tables), encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        called = caller(folder, patch)
        assert called("--scenario", "small.toml", "slow.toml") == 0
        assert called(*BEGUN) == 0
    return folder


def caller(folder, patch):
    patch.chdir(folder)
    patch.setattr("baselines.training.validation.VALIDATED_EPISODES", 3)
    patch.setattr("baselines.training.apg.trainer.LOGS", 5)
    patch.setattr("baselines.training.request.shipped", lambda algo: Path(f"{algo}.yml"))

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
    begun = ApgTrainer(RunFolder(config, Path("new")), Groups(config, check(config)))
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


def test_an_interrupted_training_gives_the_same_agent(call, monkeypatch, capsys):
    keep = RunFolder.save_checkpoint

    def interrupted(self, state):
        keep(self, state)
        if state["timesteps"] >= STEPS / 2:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(RunFolder, "save_checkpoint", interrupted)
        assert call(*BEGUN, "--out", "out") == 1
    assert call(*BEGUN, "--out", "out", "--resume") == 0
    assert same(weights("out/agent"), weights(FOUND / "agent"))
    assert same(at_the_end(Path("out")), at_the_end(FOUND))
    assert len(read_progress(Path("out"))) == len(read_progress(FOUND))
    capsys.readouterr()
    agent = Agent.load("runs/train/apg-small-slow/agent")
    replace(agent, weights={k: 2 * w for k, w in agent.weights.items()}).save("runs/train/apg-small-slow/agent")
    assert call(*BEGUN, "--out", "out", "--resume") == 2
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
        (("--from", "unknown"), "unknown agent 'unknown'; allowed are the folder of an agent, or apg-"),
        (("--from", "ppo-cruise"), "'ppo-cruise' was trained by ppo; a training can start only from an agent of apg"),
        (("--algo", "ppo"), "--from requires the algorithm apg, not ppo; leave out --algo"),
        (("--expert", "lqi"), "corrects backstepping; leave out --expert lqi"),
        (("--authority", "0.1"), "has the authority (0.5, 0.5); leave out --authority"),
        (("--set", "hidden_size=64"), "was trained with hidden_size 8; leave out hidden_size=64"),
        (("--set", "fine=true"), "has another network, or other inputs, than the settings"),
        (("--vehicle", "submarine"), "unknown vehicle 'submarine'; allowed are a Vehicle, a dict, a .toml file"),
        (("--vehicle", "none.toml"), "cannot read none.toml"),
        (("--vehicle", "lauv", "--scenario", "slow-calm"), "fins of this vehicle need at least 0.25 m/s"),
        (("--scenario", "paper-circle"), "has a fixed path, which cannot be converted to the units of its vehicle"),
        (("--hyperparameters", "other.yml"), "other.yml has no table of hyper-parameters under fine-tuning"),
    ],
)
def test_wrong_options_give_one_line_and_create_no_files(arguments, message, call, capsys):
    Path("other.yml").write_text(yaml.safe_dump({TRAINED_ENV: TINY}), encoding="utf-8")
    before = set(Path().rglob("*"))
    assert call(*BEGUN, "--out", "out", *arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err.splitlines()[-1]
    assert set(Path().rglob("*")) == before


def test_training_for_a_vehicle_without_an_agent(call):
    assert call("--vehicle", "otter", "--scenario", "small.toml", "--timesteps", 40) == 0
    config = read_config(Path("runs/train/apg-small-otter"))
    assert (config.origin, config.steers) == (None, vehicle_model("otter").vehicle)


def test_scenarios_too_slow_for_the_fins_are_left_out():
    mixture, reasons = fitted(MIXTURES["helm"], vehicle_model("lauv"))
    assert len(mixture) + len(reasons) == len(MIXTURES["helm"])
    assert {scenario.name.partition("-")[0] for scenario, _ in mixture} == {"cruise"}
    own, steers = in_own_units(mixture)
    assert steers == vehicle_model("lauv").vehicle
    assert len({scenario.substeps for scenario, _ in own}) == 1
    assert [weight for _, weight in own] == [weight for _, weight in mixture]


def test_scenarios_of_the_papers_vehicle_do_not_change():
    mixture = MIXTURES["cruise"]
    assert in_own_units(mixture) == (mixture, None)
    twice = ((Scenario("a"), 1.0), (Scenario("b", vehicle=replace(PAPER_VEHICLE, m22=300.0)), 1.0))
    assert in_own_units(twice) == (twice, None)


def test_rates_rise_and_fall():
    shares = [Settings(warm_up=0.25, final_share=0.1).share_at(x) for x in np.linspace(0, 1, 101)]
    assert shares[0] == 0.0
    assert np.argmax(shares) == 25
    assert shares[25:] == [Settings(final_share=0.1).share_at(x) for x in np.linspace(0, 1, 101)[25:]]
    with pytest.raises(ValueError, match="warm_up is 2"):
        Settings(warm_up=2)


def test_fine_tuning_keeps_agent_and_objective():
    """Of the residual environment's table, only rates, length, windows and number of vehicles are other."""
    values = load_hyperparameters(shipped("apg"), FINE_TUNING_FILE_NAME)
    assert not {*values.values} & {*OF_AGENT, "effort_weight", "rate_weight", "derivative_bound"}
    assert values.timesteps < load_hyperparameters(shipped("apg")).timesteps
    json.dumps(dict(values.values))


@pytest.mark.slow
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
    lines = [
        line
        for line in re.findall(r"^(?:python train.py|auv-gym train) ([^#\n]*)", text, re.MULTILINE)
        if "--vehicle" in line
    ]
    assert lines
    for line in lines:
        scenario = () if "--scenario" in line else ("--scenario", "small.toml")
        assert call(*line.split(), *scenario, "--timesteps", 40) == 0, line


def test_the_study_of_fine_tuning(tmp_path, monkeypatch, capsys):
    """A quick form of the command, whose agents have learned nothing."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(fine_tuning, "_DISTURBED", ("waves", "noise"))
    words = ["--vehicle", "otter", "--episodes", "2", "--out", "new.json", "--policy", "backstepping", "helm"]
    assert run(fine_tuning.main, fine_tuning.PROGRAM, words) == 0
    record = json.loads(Path("new.json").read_text(encoding="utf-8"))
    own = record["vehicles"]["otter"]
    assert [len(case) for case in own["helm"]["steady_rmses"]] == [2, 2]
    for name, factor, rate in (("nmpc", 0.5, 4.0), ("tuned", 0.4, 1.0)):
        errors = [[factor * x for x in case] for case in own["helm"]["steady_rmses"]]
        own[name] = {"steady_rmses": errors, "failed": 1, "command_rate": rate}
    assert fine_tuning.ratio(own, "tuned", "helm") == (pytest.approx(0.4), pytest.approx((0.4, 0.4)))
    own["nmpc"]["seconds"], own["tuned"]["seconds"] = 7.0, 61.4
    best = fine_tuning.best_controller(own)
    assert best == min(("nmpc", "backstepping"), key=lambda name: fine_tuning.ratio(own, name, "helm")[0])
    shown = fine_tuning._row("otter", {**own, "backstepping": own["helm"]}, "helm")
    assert shown[:2] == ["`otter`", "`nmpc`"]
    assert shown[2:5] == ["2.00 (2.00 ... 2.00)", "0.80 (0.80 ... 0.80)", "0.40 (0.40 ... 0.40)"]
    assert shown[5:] == [f"1, 1, {own['helm']['failed']}, 1", "0.25", "61"]
    capsys.readouterr()
    assert run(fine_tuning.main, fine_tuning.PROGRAM, words) == 0
    assert capsys.readouterr().out == ""  # all is there


def test_rows_of_changed_policies_are_ignored(tmp_path, monkeypatch):
    prints = {"helm": "of helm", "backstepping": "of the law"}
    monkeypatch.setattr(fine_tuning, "fingerprint", prints.get)
    rows = {
        name: {"steady_rmses": [[1.0]], "failed": 0, "fingerprint": fine_tuning.row_fingerprint(name, "helm")}
        for name in ("helm", "backstepping", "tuned")
    }
    rows["tuned"]["set"] = fine_tuning.recipe()
    options = replace(fine_tuning.Options(), agent="helm", episodes=1, out=tmp_path / "kept.json")
    record = {"agent": "helm", "episodes": 1, "vehicles": {"otter": rows}}
    options.out.write_text(json.dumps(record), encoding="utf-8")

    def valid(options):
        return set(fine_tuning.still_valid(options)["vehicles"].get("otter", ()))

    assert fine_tuning.still_valid(options) == record
    assert valid(replace(options, timesteps=40)) == {"helm", "backstepping"}
    assert valid(replace(options, episodes=2)) == set()
    prints["helm"] = "new"
    assert valid(options) == {"backstepping"}
    prints["backstepping"] = "new"
    assert valid(options) == set()


def test_the_page_shows_the_present_policies():
    """The agents are tuned as the hyper-parameters say."""
    kept = json.loads(fine_tuning.FINE_TUNING_FILE.read_text(encoding="utf-8"))
    assert {tuple(found["tuned"]["set"]) for found in kept["vehicles"].values()} == {tuple(fine_tuning.recipe())}
    for name, row in ((name, row) for found in kept["vehicles"].values() for name, row in found.items()):
        assert row["fingerprint"] == fine_tuning.row_fingerprint(name, kept["agent"]), "run research fine-tuning"


def test_the_readme_compares_tuned_agents_with_the_best_controllers():
    vehicles = json.loads(fine_tuning.FINE_TUNING_FILE.read_text(encoding="utf-8"))["vehicles"]
    ratios = [fine_tuning.ratio(own, "tuned", fine_tuning.best_controller(own))[0] for own in vehicles.values()]
    readme = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert f"the error is then {min(ratios):.2f} to {max(ratios):.2f} times that of the best controller" in readme
    seconds = [own["tuned"]["seconds"] for own in vehicles.values()]
    assert (round(min(seconds) / 60), round(max(seconds) / 60)) == (2, 3)
    assert "[Training for one vehicle](docs/fine-tuning.md) takes two to three minutes" in readme
