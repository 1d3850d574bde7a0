"""Training with Stable-Baselines3: its environments, the exported actors, the cost of the error, and validation."""

import math
import sys
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
import torch
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor
from torch import nn

from auv_gym import decode_observation
from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.errors import to_world
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario
from baselines import make_policy
from baselines.agents.features import FEATURES
from baselines.agents.sb3_models import load_model
from baselines.evaluation.cells import drawn
from baselines.evaluation.rollout import rollout
from baselines.evaluation.score import EXPERT
from baselines.training.config import Config
from baselines.training.run_folder import RunFolder
from baselines.training.sb3.trainer import (
    ALGORITHM_CLASSES,
    Tracker,
    exported_agent,
    make_model,
    make_training_env,
    start_at_expert,
)
from baselines.training.sb3.vec_env import SB3VecEnv
from baselines.training.sb3.vec_features import LINEAR, VecFeatures
from baselines.training.validation import Validation

torch.set_num_threads(1)
STORM = Scenario.from_dict({**PRESETS["cruise-storm"].to_dict(), "name": "short", "steps": 30})
TRACK = "auv_gym:UnderactuatedAUVTrack-v0"
RESIDUAL = "auv_gym:UnderactuatedAUVTrackResidual-v0"
SMOOTH = {"use_sde": True, "policy_kwargs": {"net_arch": {"pi": [16, 8], "qf": [8]}, "clip_mean": 0.0}}
VARIANTS = [*((algo, {}) for algo in ALGORITHM_CLASSES), ("sac", SMOOTH), ("ppo", {"use_sde": True})]


def configuration(algo="ppo", steps=30, expert=EXPERT, **values):
    more = {"n_steps": 8, "batch_size": 24} if algo == "ppo" else {"buffer_size": 1000}
    scenario = Scenario.from_dict({**STORM.to_dict(), "steps": steps})
    kwargs = {"net_arch": {"pi": [16, 8], "vf" if algo == "ppo" else "qf": [8]}}
    values = {"n_envs": 3, "policy_kwargs": kwargs, **more, **values}
    return Config(algo, ((scenario, 1.0),), expert, (0.4, 0.8), hyperparameters=values)


@pytest.mark.parametrize("mode", ["NEXT_STEP", "DISABLED"])
def test_other_autoreset_modes_are_refused(mode):
    env = gym.vector.SyncVectorEnv([lambda: gym.make(TRACK)], autoreset_mode=gym.vector.AutoresetMode[mode])
    advice = r"autoreset_mode='SameStep'\), or .* vector_kwargs=\{'autoreset_mode': gym.vector.AutoresetMode.SAME_STEP"
    for make in (partial(SB3VecEnv, env), partial(adapted, autoreset_mode=mode)):
        with pytest.raises(ValueError, match=f"autoreset mode {mode}; Stable-Baselines3 needs SAME_STEP: .*{advice}"):
            make()
    with pytest.raises(ValueError, match=r"TimeLimit.* is not a vector environment; make one by gym.make_vec"):
        SB3VecEnv(gym.make(TRACK, max_episode_steps=9))


def test_the_scenario_of_each_sub_environment():
    own = adapted(scenario=[STORM, STORM.to_dict(), PRESETS["cruise-calm"]])
    assert own.get_attr("scenario", [2, 0]) == [PRESETS["cruise-calm"], STORM]
    assert own.get_attr("num_envs") == [3, 3, 3]
    kwargs = {"autoreset_mode": gym.vector.AutoresetMode.SAME_STEP}
    sync = SB3VecEnv(gym.make_vec(TRACK, 2, "sync", kwargs, scenario=STORM))
    assert sync.get_attr("scenario") == [STORM, STORM]


def untrained(algo, **values):
    """Return a model with random weights of which the actor's last layer is not small."""
    model = make_model(configuration(algo, **values))
    torch.manual_seed(1)
    for layer in model.policy.modules():
        if isinstance(layer, nn.Linear):
            nn.init.normal_(layer.weight, std=0.3)
    return model


def adapted(env_id=TRACK, n=3, **options):
    return SB3VecEnv(gym.make_vec(env_id, num_envs=n, vectorization_mode="vector_entry_point", **options))


@pytest.mark.parametrize("env_id", [TRACK, RESIDUAL])
def test_rollouts_equal_dummy_vec_env_across_autoresets(env_id):
    scenario = {**STORM.to_dict(), "steps": 40}
    ours = adapted(env_id, scenario=scenario)
    theirs = DummyVecEnv([lambda: gym.make(env_id, scenario=scenario) for _ in range(3)])
    for env in (ours, theirs):
        env.seed(7)
    np.testing.assert_allclose(ours.reset(), theirs.reset(), rtol=0, atol=1e-12)
    rng, ends = np.random.default_rng(0), 0
    for _ in range(100):
        actions = rng.uniform(-1, 1, (3, 2)).astype(np.float32)
        (o1, r1, d1, i1), (o2, r2, d2, i2) = ours.step(actions), theirs.step(actions)
        np.testing.assert_allclose(o1, o2, rtol=0, atol=1e-10)
        np.testing.assert_allclose(r1, r2, rtol=0, atol=1e-6)
        assert (d1 == d2).all()
        for a, b in zip(i1, i2, strict=True):
            assert a.keys() == b.keys()
            assert a["TimeLimit.truncated"] == b["TimeLimit.truncated"]
            assert a["position_error"] == pytest.approx(b["position_error"], abs=1e-10)
            assert a["time"] == pytest.approx(b["time"], abs=1e-12)
            if "terminal_observation" in a:
                ends += 1
                np.testing.assert_allclose(a["terminal_observation"], b["terminal_observation"], rtol=0, atol=1e-10)
    assert ends == 6


def test_a_model_of_a_package_that_is_not_installed_is_one_line(tmp_path, monkeypatch):
    contrib = pytest.importorskip("sb3_contrib")
    contrib.TQC("MlpPolicy", gym.make(TRACK), buffer_size=10, device="cpu").save(tmp_path / "tqc.zip")
    monkeypatch.setitem(sys.modules, "sb3_contrib", None)
    with pytest.raises(ValueError, match=r"tqc.zip needs sb3_contrib: install the package sb3-contrib$"):
        load_model(tmp_path / "tqc.zip", make_policy(EXPERT))


@pytest.mark.parametrize(("algo", "values"), VARIANTS)
def test_exported_actor_is_the_models_predict(algo, values):
    model = untrained(algo, **values)
    agent = exported_agent(model.policy, configuration(algo))
    x = np.random.default_rng(0).uniform(-2, 2, (200, len(FEATURES))).astype(np.float32)
    expected, _ = model.predict(x, deterministic=True)
    layers, none = agent.network.prepared(agent.weights), np.zeros((0, 200))
    actions = agent.network.forward(layers, x.T.astype(np.float64), none)[0].T
    np.testing.assert_allclose(actions, expected, rtol=0, atol=1e-6)
    assert 0.05 < np.abs(expected).mean() < 0.95
    assert (np.abs(expected) == 1).any() == (algo == "ppo")  # clipped, the others bounded by tanh


def test_other_actors_are_rejected():
    other = make_model(configuration("ppo")).policy
    other.mlp_extractor.policy_net = nn.Sequential(nn.Linear(24, 8), nn.ELU())
    bounded = make_model(configuration("sac", use_sde=True, policy_kwargs={"clip_mean": 2.0})).policy
    for policy in (other, bounded):
        with pytest.raises(ValueError, match="must consist of linear layers"):
            exported_agent(policy, configuration())


@pytest.mark.parametrize("expert", [EXPERT, "nmpc"])
def test_agent_acts_on_the_track_as_its_model_does_in_training(expert):
    """Across the ends of episodes too: features, memory, expert, preview and authority are the same on both ways."""
    config = configuration(expert=expert)
    model = untrained("ppo", expert=expert)
    env = model.get_env()
    policy = exported_agent(model.policy, config).policy()
    assert bool(policy.preview) == (expert == "nmpc")
    track = UnderactuatedAUVTrackVectorEnv(3, STORM, preview=policy.preview)
    features, (observation, _) = env.reset(), track.reset(seed=config.episode_seed)
    memory, first = None, np.ones(3, dtype=bool)
    for _ in range(70):
        features, _, _, infos = env.step(model.predict(features, deterministic=True)[0])
        action, memory = policy.predict(observation, memory, first)
        observation, _, terminated, truncated, info = track.step(action)
        first = terminated | truncated
        errors = np.where(first, info["final_info"]["position_error"] if first.any() else 0, info["position_error"])
        np.testing.assert_allclose([i["position_error"] for i in infos], errors, rtol=0, atol=1e-4)


def test_features_and_returns_are_the_same_on_scalar_environments():
    """Features are those of the scalar environments, and sums of rewards those of `VecMonitor`."""
    ours = make_training_env(configuration(n_envs=2))
    scalar = DummyVecEnv([lambda: gym.make(RESIDUAL, scenario=STORM, authority=(0.4, 0.8))] * 2)
    theirs = VecFeatures(VecMonitor(scalar))
    for env in (ours, theirs):
        env.seed(5)
    np.testing.assert_allclose(ours.reset(), theirs.reset(), rtol=0, atol=1e-6)
    rng = np.random.default_rng(0)
    for _ in range(65):
        actions = rng.uniform(-1.5, 1.5, (2, 2)).astype(np.float32)
        (x, _, _, infos), (y, _, _, others) = ours.step(actions), theirs.step(np.clip(actions, -1, 1))
        np.testing.assert_allclose(x, y, rtol=0, atol=1e-4)
        for a, b in zip(infos, others, strict=True):
            assert ("terminal_observation" in a) == ("terminal_observation" in b)
            if "terminal_observation" in a:
                np.testing.assert_allclose(a["terminal_observation"], b["terminal_observation"], rtol=0, atol=1e-4)
                assert a["episode"]["r"] == pytest.approx(b["episode"]["r"], rel=1e-4)
                assert a["episode"]["l"] == b["episode"]["l"] == 30


def test_last_features_of_an_episode():
    short, long = (make_training_env(configuration(steps=steps, n_envs=1)) for steps in (30, 31))
    for env in (short, long):
        env.seed(3)
        env.reset()
    action = np.full((1, 2), 0.3, dtype=np.float32)
    for _ in range(30):
        (x, _, _, infos), (y, *_) = short.step(action), long.step(action)
    np.testing.assert_allclose(infos[0]["terminal_observation"], y[0], rtol=0, atol=1e-6)
    names = [feature.name for feature in FEATURES]
    assert x[0, names.index("c_u")] == 0
    assert y[0, names.index("c_u")] == np.float32(0.3)
    assert 0 < abs(x[0, names.index("slow_x")]) < abs(y[0, names.index("slow_x")])


@pytest.mark.parametrize(("algo", "values"), VARIANTS)
def test_training_starts_at_the_expert_with_the_given_spread(algo, values):
    model = untrained(algo, **values)
    start_at_expert(model.policy, 0.05)
    x = model.observation_space.sample()[None].repeat(4000, axis=0)
    assert (model.predict(x, deterministic=True)[0] == 0).all()
    if values:
        assert (getattr(model.policy, "actor", model.policy).log_std == math.log(0.05)).all()
    elif algo != "td3":
        np.testing.assert_allclose(model.predict(x, deterministic=False)[0].std(axis=0), 0.05, rtol=0.1)
    else:
        assert (model.policy.actor_target(torch.tensor(x)) == 0).all()


@pytest.mark.parametrize("algo", ["sac", "td3"])
def test_frozen_actor_does_not_change(algo, tmp_path, monkeypatch):
    values = {"learning_starts": 0, "train_freq": 1, "gradient_steps": 2, "batch_size": 16, "frozen_steps": 60}
    config = configuration(algo, **values)
    model, tracker = make_model(config), Tracker(RunFolder(config, tmp_path), 0, use_sde=False)
    monkeypatch.setattr(tracker, "_validate", lambda: None)

    def parameters(net):
        return [p.detach().clone() for p in net.parameters()]

    actor, critic = parameters(model.actor), parameters(model.critic)
    model.learn(60, tracker, log_interval=None)
    assert all(torch.equal(a, b) for a, b in zip(actor, parameters(model.actor), strict=True))
    assert not any(torch.equal(a, b) for a, b in zip(critic, parameters(model.critic), strict=True))
    model.learn(30, tracker, log_interval=None, reset_num_timesteps=False)
    assert not all(torch.equal(a, b) for a, b in zip(actor, parameters(model.actor), strict=True))


def test_validation_is_what_an_evaluation_measures():
    """Scenarios of different lengths, one in which vehicles fail, against `rollout` of each alone."""
    scenarios = [
        Scenario.from_dict({**STORM.to_dict(), "name": "cruise-short"}),
        Scenario.from_dict({**PRESETS["cruise-current"].to_dict(), "name": "own", "steps": 60, "lost_distance": 2.0}),
    ]
    cells = [drawn(scenario, 6, 11) for scenario in scenarios]
    validation = Validation(cells)
    assert validation.run(make_policy("backstepping")).score == pytest.approx(0, abs=1e-12)
    verdict = validation.run(make_policy("open-loop"))
    results = [rollout(make_policy("open-loop"), cell.scenario, cell.episodes, 1.0).measures for cell in cells]
    assert results[1].failed.any()
    capped = [np.minimum(m.steady_rmse, 2.0) for m in results]
    capped[1][results[1].failed] = 2.0
    assert verdict.error_m == pytest.approx(np.mean([c.mean() for c in capped]), rel=1e-5)
    assert verdict.failed == pytest.approx(np.mean([(c == 2.0).mean() for c in capped]))
    assert validation.score(0.0, "cruise") == 1
    assert validation.score(1.5 * validation.expert_m["cruise"], "cruise") == pytest.approx(-0.5)
    assert set(validation.expert_m) == {"cruise", None}


def test_cost_is_that_of_the_extrapolated_error(monkeypatch):
    """Against differences of the world error in time, without sensor noise; linear in the lag, then logarithmic."""
    quiet = Scenario.from_dict({**PRESETS["cruise-current"].to_dict(), "sensors": {}, "name": "quiet", "steps": 200})
    values = {"n_envs": 4, "error_weight": 1.0, "reward_share": 0.0, "lead": 1.5}
    env = make_training_env(Config("sac", ((quiet, 1.0),), authority=(0.4, 0.8), hyperparameters=values))
    env.seed(3)
    rows, rewards = [], []
    for name in ("reset", "step_wait"):
        method = getattr(env.venv, name)
        monkeypatch.setattr(env.venv, name, lambda method=method: rows.append(method()) or rows[-1])
    env.reset()
    for _ in range(120):
        _, reward, done, _ = env.step(np.full((4, 2), -1, dtype=np.float32))
        assert not done.any()
        rewards.append(reward)
    o = decode_observation(np.concatenate([rows[0], *(row[0] for row in rows[1:])]))
    x, y = (np.reshape(e, (121, 4)) for e in to_world(o.e_x, o.e_y, o.cos_psi, o.sin_psi))
    speed, dt = np.hypot(o.u_R, o.v_R).reshape(121, 4), float(o.dt[0])
    moved = [e[1:-1] + 1.5 * (e[2:] - e[:-2]) / (2 * dt) for e in (x, y)]
    lag = np.hypot(*moved) / speed[:-2]
    assert lag.min() < LINEAR < 2 * LINEAR < lag.max()
    cost = np.where(lag < LINEAR, lag, LINEAR * (1 + np.log(np.maximum(lag, LINEAR) / LINEAR)))
    np.testing.assert_allclose(-np.array(rewards)[:-1], cost, rtol=0, atol=0.03)
