"""Policies from users' own files: the documented examples, and mistakes in one line."""

import json
import re
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.units import in_paper_units
from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.fitting import changed
from auv_gym.scenarios.presets import PRESETS, as_scenario
from auv_gym.scenarios.scenario import Scenario, Start
from auv_gym.scenarios.vehicles import VEHICLES_FOLDER
from baselines import check_policy, make_policy, make_residual_policy, make_residual_vector_env, run_episode
from baselines.agents.agent import Agent
from baselines.agents.features import FEATURES
from baselines.agents.loading import caution
from baselines.agents.names import SHIPPED_FOLDER
from baselines.agents.networks import Gru
from baselines.control.backstepping import Backstepping
from baselines.evaluation import command as evaluation
from baselines.evaluation.cells import drawn
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.options import Options
from baselines.evaluation.request import Request
from baselines.evaluation.rollout import PolicyError, rollout
from baselines.evaluation.runner import run_all
from baselines.policies import common_vehicle
from baselines.tools.command_line import UsageError
from baselines.training.config import Config
from baselines.video import command as video

PAGE = (Path(__file__).parents[2] / "docs" / "tutorials" / "controller.md").read_text(encoding="utf-8")
COMMON = ("--scenario", "cruise-calm", "--episodes", "2", "--jobs", "1", "--out", "out")


@pytest.fixture
def example(tmp_path, monkeypatch):
    """The module of the documentation, in the working directory."""
    monkeypatch.chdir(tmp_path)
    text = re.search(r"^```python\n(# line_of_sight.py\n.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)[1]
    (tmp_path / "line_of_sight.py").write_text(text)
    return re.search(r"--policy (line_of_sight.py:\w+) --scenario", PAGE)[1]


def test_documented_module(example, tmp_path):
    assert evaluation.main(["--policy", example, *COMMON]) == 0
    rows = json.loads((tmp_path / "out" / "results.json").read_text())["results"]
    assert [row["policy"] for row in rows] == ["backstepping", example]
    assert rows[1]["steady_rmse_m"]["mean"] < 0.5


def test_a_file_runs_as_if_imported(tmp_path, monkeypatch):
    """Annotations are types, not texts; the module is found by dataclasses; and nothing is written beside it."""
    text = "import dataclasses\nfrom pathlib import Path\n\n@dataclasses.dataclass\nclass Still:\n"
    text += (
        "    limit: float = 2.0\n    def predict(self, observation, *_):\n        return Path(__file__).name, None\n"
    )
    (tmp_path / "mine.py").write_text(text)
    monkeypatch.chdir(tmp_path)
    policy = make_policy("mine.py:Still")
    assert type(policy).__annotations__ == {"limit": float}
    assert policy.predict(None) == ("mine.py", None)
    assert [file.name for file in tmp_path.iterdir()] == ["mine.py"]


@pytest.mark.parametrize("expert", ["backstepping", "nmpc"])
@pytest.mark.parametrize("memory", [False, True])
def test_a_network_of_ones_own_corrects_as_in_the_residual_environment(expert, memory):
    """Up to single precision of the actions, with the memories of expert and network, over several episodes."""
    weights = np.random.default_rng(1).normal(scale=0.3, size=(200, 2))

    class Remembers:
        def predict(self, observation, state=None, episode_start=None, deterministic=True):
            (past,) = state or (np.zeros((len(observation), 2)),)
            past = np.where(np.reshape(episode_start, (-1, 1)), 0.0, past) * 0.9 + observation @ weights[:columns]
            return np.tanh(past), (past,)

    def function(observation):
        return np.tanh(observation @ weights[:columns])

    network, authority, short = (
        Remembers() if memory else function,
        (0.3, 0.5),
        replace(PRESETS["cruise-storm"], steps=15),
    )
    residual = make_residual_vector_env(3, short, expert=expert, authority=authority)
    policy = make_residual_policy(network, expert, authority)
    columns = residual.single_observation_space.shape[0]
    plain = UnderactuatedAUVTrackVectorEnv(3, short, preview=policy.preview)
    (seen, _), (shown, _) = residual.reset(seed=5), plain.reset(seed=5)
    state, kept, first = None, None, np.ones(3, dtype=bool)
    for _ in range(40):
        np.testing.assert_allclose(seen[:, :-2], shown, rtol=1e-4, atol=1e-5)
        correction, kept = network.predict(seen, kept, first) if memory else (network(seen), None)
        action, state = policy.predict(shown, state, first)
        (seen, _, done, over, _), (shown, *_) = residual.step(correction), plain.step(action)
        first = done | over
    with pytest.raises(ValueError, match=r"actions have shape \(2,\)"):
        make_residual_policy(lambda _: np.zeros(2)).predict(np.zeros((3, 18)) + 0.5)


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("missing.py:f", "cannot read missing.py"),
        ("line_of_sight.py:nothing", "no function or class 'nothing'"),
        ("broken.py:f", "broken.py cannot be imported: SyntaxError"),
        ("other.py:fails", "fails of other.py fails: KeyError"),
        ("other.py:number", "has no method predict"),
        ("text.zip", "is not a model of Stable-Baselines3"),
        ("unknown.zip", "allowed are those of"),
    ],
)
def test_mistakes(example, name, says, tmp_path, capsys):
    Path("broken.py").write_text("def f(:")
    Path("other.py").write_text("def fails():\n    {}['x']\n\n\ndef number():\n    return 3\n")
    Path("text.zip").write_text("no zip")
    with zipfile.ZipFile("unknown.zip", "w") as archive:
        archive.writestr("data", json.dumps({"policy_class": {"__module__": "mine"}}))
    with pytest.raises(UsageError, match=re.escape(says)):
        evaluation.main(["--policy", name, *COMMON])
    assert not Path("out").exists()


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """Untrained models of Stable-Baselines3 by the name of their file."""
    sb3 = pytest.importorskip("stable_baselines3")
    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario="cruise-calm")
    folder = tmp_path_factory.mktemp("models")
    contrib = pytest.importorskip("sb3_contrib")
    for algorithm in MODELS:
        package = contrib if hasattr(contrib, algorithm) else sb3
        kind = "MlpLstmPolicy" if algorithm == "RecurrentPPO" else "MlpPolicy"
        getattr(package, algorithm)(kind, env, device="cpu").save(folder / f"{algorithm}.zip")
    other = gym.make("auv_gym:UnderactuatedAUVTrackResidual-v0", scenario="cruise-calm")
    sb3.PPO("MlpPolicy", other, device="cpu").save(folder / "residual.zip")
    sb3.PPO("MlpPolicy", gym.make("Pendulum-v1"), device="cpu").save(folder / "pendulum.zip")
    return folder


MODELS = ("PPO", "RecurrentPPO", "SAC", "TD3", "CrossQ", "ARS")


def test_documented_zip(models, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert evaluation.main(["--policy", *(str(models / f"{name}.zip") for name in MODELS), *COMMON]) == 0
    assert "can run any code" in capsys.readouterr().err
    rows = json.loads(Path("out/results.json").read_text())["results"]
    assert [row["error"] for row in rows] == [None] * (1 + len(MODELS))


def test_zip_with_memory_remembers_what_its_model_does(models):
    """Step after step, with an episode that begins in between."""
    contrib = pytest.importorskip("sb3_contrib")
    policy, model = make_policy(str(models / "RecurrentPPO.zip")), contrib.RecurrentPPO.load(models / "RecurrentPPO")
    rng, mine, theirs = np.random.default_rng(0), None, None
    for k in range(6):
        row, first = rng.uniform(0.1, 0.5, (3, 18)).astype(np.float32), np.array([k == 0, k in (0, 3), k == 0])
        action, mine = policy.predict(row, mine, first)
        expected, theirs = model.predict(row, theirs, first, deterministic=True)
        np.testing.assert_array_equal(action, expected)
    assert not np.array_equal(policy.predict(row)[0], action)


def test_zip_of_another_task(models):
    with pytest.raises(ValueError, match=r"takes observations \(3,\) and returns actions \(1,\)"):
        make_policy(str(models / "pendulum.zip"))


def test_zip_of_the_residual_environment_corrects_the_expert(models):
    """It does in the tracking environment what it does in its own."""
    sb3 = pytest.importorskip("stable_baselines3")
    policy, model = make_policy(str(models / "residual.zip")), sb3.PPO.load(models / "residual.zip", device="cpu")
    own = gym.make("auv_gym:UnderactuatedAUVTrackResidual-v0", scenario="cruise-calm")
    track = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario="cruise-calm")
    seen, observed = own.reset(seed=3)[0], track.reset(seed=3)[0]
    for _ in range(20):
        seen = own.step(model.predict(seen, deterministic=True)[0])[0]
        observed = track.step(policy.predict(observed)[0])[0]
        np.testing.assert_allclose(seen[:18], observed, rtol=1e-6, atol=1e-9)
    action = policy.predict(np.tile(observed, (3, 1)))[0]
    assert action.shape == (3, 2)
    weak = make_policy(str(models / "residual.zip"), authority=0.01).predict(observed)[0]
    np.testing.assert_allclose(weak, make_policy("backstepping").predict(observed)[0], atol=0.02)


@pytest.mark.parametrize(
    ("model", "statistics"),
    [
        ("best_model.zip", "vecnormalize.pkl"),
        ("best_model.zip", "best_model/vecnormalize.pkl"),
        ("ppo_v2_1000_steps.zip", "ppo_v2_vecnormalize_1000_steps.pkl"),  # CheckpointCallback of Stable-Baselines3
    ],
)
def test_zip_sees_what_it_saw_in_training(models, tmp_path, model, statistics):
    """The statistics of VecNormalize of a model are used, and are part of what makes its numbers; others are not."""
    vec_env = pytest.importorskip("stable_baselines3.common.vec_env")
    file = tmp_path / model
    shutil.copy(models / "PPO.zip", file)
    observation = np.linspace(-1.0, 1.0, 18)
    plain, before = make_policy(str(file)).predict(observation)[0], fingerprint(str(file))
    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario="cruise-calm")
    normalised = vec_env.VecNormalize(vec_env.DummyVecEnv([lambda: env]))
    normalised.obs_rms.mean[:], normalised.obs_rms.var[:] = 0.3, 4.0
    for name in ("another_run/vecnormalize.pkl", statistics):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        assert "normalised by" not in caution(str(file))
        np.testing.assert_array_equal(make_policy(str(file)).predict(observation)[0], plain)
        normalised.save(str(tmp_path / name))
    seen = (observation - 0.3) / np.sqrt(4.0 + normalised.epsilon)
    expected = make_policy(str(models / "PPO.zip")).predict(seen)[0]
    np.testing.assert_allclose(make_policy(str(file)).predict(observation)[0], expected, rtol=1e-5)
    assert not np.allclose(expected, plain)
    assert fingerprint(str(file)) != before
    assert f"normalised by {tmp_path / statistics}" in caution(str(file))


def test_a_policy_file_may_import_files_beside_it(tmp_path):
    """They count for its fingerprint, directly or not."""
    (tmp_path / "gains_of_mine.py").write_text("from deeper_gains import GAIN\n")
    (tmp_path / "deeper_gains.py").write_text("GAIN = 0.25\n")
    file = tmp_path / "own.py"
    file.write_text(
        "import numpy as np\nfrom gains_of_mine import GAIN\n\n\nclass Law:\n"
        "    def predict(self, observation, *_, **__):\n        return np.full((len(observation), 2), GAIN), None\n"
    )
    name = f"{file}:Law"
    action, _ = make_policy(name).predict(np.zeros((3, 18)))
    np.testing.assert_array_equal(action, np.full((3, 2), 0.25))
    before = fingerprint(name)
    (tmp_path / "deeper_gains.py").write_text("GAIN = 0.5\n")
    assert fingerprint(name) != before


class Summing:
    """A law with an integral, as it should be or with one of the usual mistakes."""

    def __init__(self, mistake=""):
        self.mistake, self.sum = mistake, 0.0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        rows = np.atleast_2d(observation)
        (total,) = state or (np.zeros(len(rows)),)
        if self.mistake != "never forgets":
            total = np.where(episode_start, 0.0, total)
        total = total + rows[:, 0]
        if self.mistake == "keeps its memory in itself":
            self.sum = total = self.sum + rows[:, 0].mean()
        action = np.tanh(0.01 * np.column_stack((total + 0 * rows[:, 0], rows[:, 1])))
        if self.mistake == "depends on the others":
            action = action - action.mean(axis=0)
        if self.mistake == "is too large":
            action = 1000 * action
        return (action if observation.ndim == 2 or self.mistake == "is always a batch" else action[0]), (total,)


def test_the_check_of_a_policy():
    for name in ("backstepping", "ekf", "nmpc", "helm"):
        check_policy(make_policy(name))
    check_policy(Summing())
    check_policy(make_policy("lqi", as_scenario("space-storm").known), "space-storm")
    for mistake, says in {
        "never forgets": "after episode_start its action is another one than at first",
        "keeps its memory in itself": "it must forget its memory",
        "depends on the others": "the action for it alone is another one than among 3",
        "is too large": r"finite and in \[-1, 1\]",
        "is always a batch": r"observation of shape \(18,\) the action is .* it must have the shape \(2,\)",
    }.items():
        with pytest.raises(PolicyError, match=says):
            check_policy(Summing(mistake))
    with pytest.raises(PolicyError, match="a dict has no method predict"):
        check_policy({})
    with pytest.raises(PolicyError, match=r"Summing is a class; give an object, Summing\(\)"):
        check_policy(Summing)
    with pytest.raises(PolicyError, match="a dict has no method predict"):
        run_episode({}, "cruise-calm")
    with pytest.raises(PolicyError, match="uses more than the observation; only others can be checked"):
        check_policy(make_policy("oracle"))


def test_all_seeds_of_a_training_are_evaluated_together(tmp_path, monkeypatch, capsys):
    """Their mean is that of the table, by hand."""
    monkeypatch.chdir(tmp_path)
    agents = "helm-any", "ppo-cruise", "helm"
    for seed, name in zip((2, 10, 3), agents, strict=True):
        shutil.copytree(SHIPPED_FOLDER / name, Path("runs/x", f"seed-{seed}", "agent"))
    arguments = ["--policy", "runs/x", "--scenario", "cruise-calm", "cruise-current", "--episodes", "3"]
    assert evaluation.main([*arguments, "--jobs", "1", "--out", "out"]) == 0
    content = json.loads(Path("out/results.json").read_text(encoding="utf-8"))
    (training,) = content["trainings"]
    assert training["policies"] == [f"runs/x/seed-{seed}" for seed in (2, 3, 10)]
    errors = {(r["policy"], r["scenario"]): r["steady_rmse_m"]["mean"] for r in content["results"]}
    cases = "cruise-calm", "cruise-current"
    ratios = np.array([[errors[p, c] / errors["backstepping", c] for c in cases] for p in training["policies"]])
    assert training["to_expert"]["mean"] == pytest.approx(np.exp(np.log(ratios.mean(axis=0)).mean()), rel=1e-6)
    assert training["middle"] == pytest.approx(np.exp(np.log(ratios).mean(axis=1)).mean(), rel=1e-6)  # of three: all
    low, high = training["to_expert"]["ci95"]
    assert low < training["to_expert"]["mean"] < high
    out = capsys.readouterr().out
    assert f"runs/x, 3 seeds, cruise: {training['to_expert']['mean']:.3f} (" in out


def test_an_exception_of_a_policy_has_its_place(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("law.py").write_text(
        "import numpy as np\n\n\nclass Law:\n    def predict(self, observation, *_):\n"
        "        if observation[0, 0] != 7:\n            np.clip(observation, 'a', 'b')\n"
    )
    place = "UFuncTypeError: .* \\(law.py, line 7\\)\n"
    assert evaluation.main(["--policy", "law.py:Law", *COMMON]) == 1
    assert re.search(f"failed: law.py:Law in cruise-calm, {place}", capsys.readouterr().err)
    assert video.main(["--policy", "law.py:Law", "--seconds", "0.1"]) == 1
    assert re.fullmatch(f"auv-gym video: {place}", capsys.readouterr().err)


def test_an_exit_is_a_failure_of_the_policy(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("early.py").write_text("import sys\n\nsys.exit(0)\n")
    Path("late.py").write_text("import sys\n\n\nclass Law:\n    def predict(self, *_):\n        sys.exit('\\x1b[2J')\n")
    with pytest.raises(UsageError, match=r"early\.py cannot be imported: SystemExit"):
        evaluation.main(["--policy", "early.py:Law", *COMMON])
    assert evaluation.main(["--policy", "late.py:Law", *COMMON]) == 1
    out, err = capsys.readouterr()
    assert "failed: late.py:Law in cruise-calm, SystemExit" in err
    assert "\x1b[2J" not in out + err + Path("out/results.json").read_text()


def test_names_that_cannot_be_printed_are_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for word in ("\x1b[31m", "a\udc80b", "a\nb"):
        with pytest.raises(UsageError, match="cannot be printed"):
            evaluation.main(["--policy", word])
    Path("a.json").write_text(json.dumps({"name": "\x1b[31m", "steps": 5}))
    with pytest.raises(UsageError, match="printable characters"):
        evaluation.main(["--scenario", "a.json"])


def test_no_cell_of_a_spreadsheet_is_a_formula(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("a.json").write_text(json.dumps({"name": "=1+1", "steps": 5}))
    assert evaluation.main(["--scenario", "a.json", "--episodes", "1", "--jobs", "1", "--out", "out"]) == 0
    assert "backstepping,'=1+1,1," in Path("out/results.csv").read_text()


def agent_of(scenarios, expert="backstepping"):
    network = Gru(len(FEATURES), 2, 2, 2)
    zeros = {name: np.zeros(shape, np.float32) for name, shape in network.shapes.items()}
    return Agent(network, zeros, expert, (0.5, 0.5), scenarios)


def test_the_folder_of_a_training_is_a_policy(tmp_path, monkeypatch, capsys):
    """An agent runs where it was not trained too, but not without a word."""
    monkeypatch.chdir(tmp_path)
    agent_of(("slow-calm", "slow-storm")).save("runs/mine/agent")
    assert evaluation.main(["--policy", "runs/mine", *COMMON]) == 0
    rows = json.loads((tmp_path / "out" / "results.json").read_text())["results"]
    assert [row["policy"] for row in rows] == ["backstepping", "runs/mine"]
    assert rows[0]["steady_rmse_m"] == rows[1]["steady_rmse_m"]
    note = "runs/mine was trained for slow scenarios, not for cruise-calm"
    assert note in capsys.readouterr().err
    assert note in Path("out/report.html").read_text()
    assert fingerprint("runs/mine") == fingerprint("runs/mine/agent") != ""


def test_in_a_frozen_suite_an_agent_runs_in_its_speed_range(tmp_path):
    request = Request.of(Options(policy=("ppo-slow",), suite="benchmark-v3", episodes=2, out=tmp_path))
    ran = {cell.scenario.name.split("-")[0] for policy, cell in request.pairs if policy == "ppo-slow"}
    assert ran == {"slow"}
    assert len([policy for policy, _ in request.pairs if policy == "backstepping"]) == 24
    assert "ppo-slow was trained for slow scenarios and runs in those only" in request.notes
    assert {len(cell.episodes) for _, cell in request.pairs} == {2}


HEAVY = Vehicle(m11=600.0, m22=840.0, m33=300.0, d11=160.0, d22=320.0, d33=180.0, X_uu=40.0)
BELIEVING = """
from baselines.control.backstepping import Backstepping


class Law(Backstepping):
    def __init__(self, vehicle="paper"):
        super().__init__(vehicle=vehicle)


def make_open_loop():
    from baselines import make_policy

    return make_policy("open-loop")
"""


def test_policies_get_the_nominal_vehicle_of_the_scenario(tmp_path, monkeypatch):
    """By name and as an agent's expert, made in the vehicle's own units, and from a file the law knows the vehicle."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text(BELIEVING)
    scenario = changed(PRESETS["cruise-calm"], vehicle=HEAVY)
    agent_of(()).save("agent")
    cell = drawn(scenario, 2, 0)
    told = rollout(make_policy("backstepping", vehicle=HEAVY), scenario, cell.episodes, 1.0).measures.steady_rmse
    wrong = rollout(make_policy("backstepping"), scenario, cell.episodes, 1.0).measures.steady_rmse
    runs = run_all(("backstepping", "./agent", "mine.py:Law", "mine.py:make_open_loop"), [cell])
    for run in runs[:2]:
        np.testing.assert_array_equal(run.measures.steady_rmse, told)
    as_it_is = rollout(Backstepping(vehicle=HEAVY), scenario, cell.episodes, 1.0).measures.steady_rmse
    np.testing.assert_array_equal(runs[2].measures.steady_rmse, as_it_is)
    assert runs[3].error is None
    assert told.mean() < 0.5 * wrong.mean()
    assert Config(scenarios=((scenario, 1.0),)).make_expert().vehicle == HEAVY
    assert make_policy("ekf", HEAVY).policy.controller.slow.vehicle == in_paper_units(HEAVY)
    assert make_policy("open-loop", HEAVY)
    residual = gym.make("auv_gym:UnderactuatedAUVTrackResidual-v0", scenario=scenario)
    assert residual.unwrapped.scenario.vehicle == HEAVY
    assert residual.get_wrapper_attr("expert").policy.vehicle == in_paper_units(HEAVY)


def test_an_expert_by_name_gets_the_common_vehicle():
    one, other = PRESETS["cruise-calm"], changed(PRESETS["cruise-calm"], vehicle=HEAVY)
    assert (common_vehicle([one, one]), common_vehicle([one, other])) == (one.vehicle, None)
    assert make_residual_vector_env(2, other).expert.policy.vehicle == in_paper_units(HEAVY)
    assert make_residual_vector_env(2, [one, other]).expert.vehicle == one.vehicle


@pytest.mark.parametrize("expert", ["los-pid", "lqi"])
def test_a_zero_correction_is_the_controller_for_a_vehicle_from_a_file(expert, tmp_path):
    """Its limits and its lag belong to what the expert knows, as in an evaluation."""
    text = (VEHICLES_FOLDER / "lauv.toml").read_text(encoding="utf-8").replace("F_u_max = 14.4", "F_u_max = 7.0")
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    scenario = changed(PRESETS["cruise-storm"], str(tmp_path / "mine.toml"))
    residual = make_residual_vector_env(2, scenario, expert=expert)
    policy, plain = make_policy(expert, scenario.known), UnderactuatedAUVTrackVectorEnv(2, scenario)
    (seen, _), (shown, _), memory, first = residual.reset(seed=3), plain.reset(seed=3), None, np.ones(2, dtype=bool)
    for _ in range(60):
        action, memory = policy.predict(shown, memory, first)
        np.testing.assert_array_equal(seen[:, -2:], action)
        seen, shown, first = residual.step(np.zeros((2, 2)))[0], plain.step(action)[0], np.zeros(2, dtype=bool)


def test_a_factory_can_get_the_actuators_of_the_vehicle(tmp_path):
    """By the argument `vehicle_model`; also from a scenario that was saved with its vehicle's model."""
    text = (VEHICLES_FOLDER / "lauv.toml").read_text(encoding="utf-8").replace("F_u_max = 14.4", "F_u_max = 7.0")
    (tmp_path / "mine.toml").write_text(text, encoding="utf-8")
    code = "def make(vehicle_model=None):\n    return make_policy('los-pid', vehicle_model)\n"
    (tmp_path / "own.py").write_text(f"from baselines import make_policy\n{code}", encoding="utf-8")
    scenario = changed(replace(PRESETS["cruise-calm"], start=Start(x_e=1.0)), str(tmp_path / "mine.toml"))
    scenario.save(tmp_path / "saved.toml")
    again = Scenario.load(tmp_path / "saved.toml")
    assert again.known == scenario.known != scenario.vehicle
    observation = UnderactuatedAUVTrackVectorEnv(2, scenario).reset(seed=1)[0]
    wanted = make_policy("los-pid", scenario.known).predict(observation)[0]
    for policy in (make_policy(f"{tmp_path / 'own.py'}:make", again.known), make_policy("los-pid", again.known)):
        np.testing.assert_array_equal(policy.predict(observation)[0], wanted)
    assert (make_policy("los-pid", scenario.vehicle).predict(observation)[0] != wanted).any()


def test_a_module_of_torch_is_a_network_and_a_class_is_none():
    torch = pytest.importorskip("torch")
    module, rows = torch.nn.Linear(20, 2), np.random.default_rng(0).uniform(0.1, 0.5, (3, 18))
    weights, bias = (p.detach().numpy() for p in module.parameters())
    by_hand = make_residual_policy(lambda seen: seen @ weights.T + bias)
    for network in (module, lambda seen: module(torch.as_tensor(seen, dtype=torch.float32))):
        np.testing.assert_allclose(
            make_residual_policy(network).predict(rows)[0], by_hand.predict(rows)[0], rtol=1e-5, atol=1e-6
        )
    for network in (None, torch.nn.Linear, "agent"):
        with pytest.raises(ValueError, match="it must be a function of a batch of observations, a module of torch"):
            make_residual_policy(network)
