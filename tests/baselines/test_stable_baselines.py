"""What Stable-Baselines3 trains on and what is exported from it, held against the environment and its own predict."""

import math

import gymnasium as gym
import numpy as np
import pytest
import torch
from sb3_contrib import ARS, CrossQ
from stable_baselines3 import SAC
from stable_baselines3.common.vec_env import DummyVecEnv
from torch import nn

from auv_gym.envs.track_vector_env import UnderactuatedAUVTrackVectorEnv
from auv_gym.physics.errors import to_world
from auv_gym.scenarios.presets import PRESETS
from auv_gym.scenarios.scenario import Scenario
from auv_gym.task.observation import decode_observation
from baselines import make_policy
from baselines.agents.features import FEATURES
from baselines.evaluation.rollout import rollout
from baselines.evaluation.runner import drawn
from baselines.evaluation.score import EXPERT
from baselines.training.config import Config
from baselines.training.sb3.callbacks import FrozenActor, ZeroCorrection
from baselines.training.sb3.export import exported_network
from baselines.training.sb3.trainer import ALGORITHM_CLASSES, make_model, make_training_env
from baselines.training.sb3.vec_env import SB3VecEnv
from baselines.training.sb3.vec_features import VecFeatures
from baselines.training.sb3.vec_reward import LINEAR
from baselines.training.validation import Validation, validation_cell

torch.set_num_threads(1)
STORM = Scenario.from_dict({**PRESETS["cruise-storm"].to_dict(), "name": "short", "steps": 30})
COST = "baselines.training.sb3.vec_reward.VecErrorCost"
RESIDUAL = "auv_gym:UnderactuatedAUVTrackResidual-v0"
SMOOTH = {"use_sde": True, "policy_kwargs": {"net_arch": {"pi": [16, 8], "qf": [8]}, "clip_mean": 0.0}}
VARIANTS = [*((algo, {}) for algo in ALGORITHM_CLASSES), ("sac", SMOOTH), ("ppo", {"use_sde": True})]
SIZES = {algo: {"pi": [16, 8], "vf" if algo.startswith("ppo") else "qf": [8]} for algo in ALGORITHM_CLASSES}


def configuration(algo="ppo", steps=30, expert=EXPERT, **values):
    more = {"n_steps": 8, "batch_size": 24} if algo.startswith("ppo") else {"buffer_size": 1000}
    scenario = Scenario.from_dict({**STORM.to_dict(), "steps": steps})
    kwargs = {"net_arch": SIZES[algo]} | ({"lstm_hidden_size": 12} if algo == "ppo_lstm" else {})
    values = {"n_envs": 3, "policy_kwargs": kwargs, **more, **values}
    return Config(algo, ((scenario, 1.0),), expert, (0.4, 0.8), hyperparameters=values)


def untrained(algo, **values):
    """Return a model with random weights of which the actor's last layer is not small."""
    model = make_model(configuration(algo, **values))
    torch.manual_seed(1)
    for layer in model.policy.modules():
        if isinstance(layer, nn.Linear):
            nn.init.normal_(layer.weight, std=0.3)
    return model


@pytest.mark.parametrize(("algo", "values"), VARIANTS)
def test_exported_actor_is_the_models_predict(algo, values):
    model = untrained(algo, **values)
    agent = exported_network(model.policy, configuration(algo))
    x = np.random.default_rng(0).uniform(-2, 2, (200, len(FEATURES))).astype(np.float32)
    expected, _ = model.predict(x, deterministic=True)
    hidden = np.zeros((agent.network.memory, 200))
    actions = agent.network.forward(agent.network.prepared(agent.weights), x.T.astype(np.float64), hidden)[0].T
    np.testing.assert_allclose(actions, expected, rtol=0, atol=1e-6)
    assert 0.05 < np.abs(expected).mean() < 0.95
    assert (np.abs(expected) == 1).any() == (algo == "ppo")  # clipped, the others bounded by tanh


def test_exported_memory_is_the_models():
    """Step after step, with episodes that begin in between."""
    model = untrained("ppo_lstm")
    agent = exported_network(model.policy, configuration("ppo_lstm"))
    layers, rng, state = agent.network.prepared(agent.weights), np.random.default_rng(0), None
    hidden = np.zeros((agent.network.memory, 4))
    for k in range(12):
        x = rng.uniform(-2, 2, (4, len(FEATURES))).astype(np.float32)
        first = np.array([k == 0, k in (0, 5), k == 0, k in (0, 7)])
        expected, state = model.predict(x, state, first, deterministic=True)
        actions, hidden = agent.network.forward(layers, x.T.astype(np.float64), np.where(first, 0.0, hidden))
        np.testing.assert_allclose(actions.T, expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("values", [{"n_lstm_layers": 2}, {"lstm_kwargs": {"bias": False}}])
def test_other_memories_are_refused(values):
    model = make_model(configuration("ppo_lstm", policy_kwargs={"lstm_hidden_size": 4, **values}))
    with pytest.raises(ValueError, match="must be one layer: set n_lstm_layers to 1"):
        exported_network(model.policy, configuration("ppo_lstm"))


@pytest.mark.parametrize("squash", [True, False])
def test_random_search_can_be_exported_too(squash):
    model = ARS("MlpPolicy", make_training_env(configuration(), 3), policy_kwargs={"squash_output": squash}, seed=0)
    x = np.random.default_rng(0).uniform(-2, 2, (200, len(FEATURES))).astype(np.float32)
    agent = exported_network(model.policy, configuration())
    actions = agent.network.forward(agent.network.prepared(agent.weights), x.T.astype(np.float64), np.zeros((0, 200)))[
        0
    ].T
    np.testing.assert_allclose(actions, model.predict(x, deterministic=True)[0], rtol=0, atol=1e-6)


def test_other_actors_are_rejected():
    env = make_training_env(configuration(), 3)
    smooth = {"use_sde": True, "policy_kwargs": {"clip_mean": 2.0}}
    other = make_model(configuration("ppo")).policy
    other.mlp_extractor.policy_net = nn.Sequential(nn.Linear(24, 8), nn.ELU())
    models = CrossQ("MlpPolicy", env, buffer_size=100), SAC("MlpPolicy", env, buffer_size=100, **smooth)
    refused = [nn.Linear(24, 2), other, *(model.policy for model in models)]
    for policy in refused:
        with pytest.raises(ValueError, match="must consist of linear layers"):
            exported_network(policy, configuration())


@pytest.mark.parametrize("expert", [EXPERT, "nmpc"])
def test_agent_acts_on_the_track_as_its_model_does_in_training(expert):
    """Across the ends of episodes too: features, memory, expert, preview and authority are the same on both ways."""
    config = configuration(expert=expert)
    model = untrained("ppo", expert=expert)
    env = model.get_env()
    policy = exported_network(model.policy, config).policy()
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


def test_features_are_the_same_on_scalar_environments():
    ours = make_training_env(configuration(), 2)
    theirs = VecFeatures(DummyVecEnv([lambda: gym.make(RESIDUAL, scenario=STORM, authority=(0.4, 0.8))] * 2))
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


def test_last_features_of_an_episode():
    short, long = (make_training_env(configuration(steps=steps), 1) for steps in (30, 31))
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


def test_features_are_of_the_residual_environment_only():
    track = gym.make_vec("auv_gym:UnderactuatedAUVTrack-v0", num_envs=1, vectorization_mode="vector_entry_point")
    with pytest.raises(ValueError, match=r"those of the residual environment have \(20,\)"):
        VecFeatures(SB3VecEnv(track))


@pytest.mark.parametrize(("algo", "values"), VARIANTS)
def test_training_starts_at_the_expert_with_the_given_spread(algo, values):
    model = untrained(algo, **values)
    callback = ZeroCorrection(0.05)
    callback.init_callback(model)
    callback.on_training_start({}, {})
    x = model.observation_space.sample()[None].repeat(4000, axis=0)
    assert (model.predict(x, deterministic=True)[0] == 0).all()
    if values:
        assert (getattr(model.policy, "actor", model.policy).log_std == math.log(0.05)).all()
    elif algo != "td3":
        np.testing.assert_allclose(model.predict(x, deterministic=False)[0].std(axis=0), 0.05, rtol=0.1)
    else:
        assert (model.policy.actor_target(torch.tensor(x)) == 0).all()
    model.num_timesteps = 1
    before = exported_network(untrained(algo).policy, configuration(algo)).weights
    model = untrained(algo)
    model.num_timesteps = 1
    callback.init_callback(model)
    callback.on_training_start({}, {})
    after = exported_network(model.policy, configuration(algo)).weights
    assert all(np.array_equal(before[name], after[name]) for name in before)


@pytest.mark.parametrize("algo", ["sac", "td3", "tqc"])
def test_frozen_actor_does_not_change(algo):
    model = make_model(configuration(algo, learning_starts=0, train_freq=1, gradient_steps=2, batch_size=16))

    def parameters(net):
        return [p.detach().clone() for p in net.parameters()]

    actor, critic = parameters(model.actor), parameters(model.critic)
    model.learn(60, FrozenActor(60), log_interval=None)
    assert all(torch.equal(a, b) for a, b in zip(actor, parameters(model.actor), strict=True))
    assert not any(torch.equal(a, b) for a, b in zip(critic, parameters(model.critic), strict=True))
    model.learn(30, FrozenActor(60), log_interval=None, reset_num_timesteps=False)
    assert not all(torch.equal(a, b) for a, b in zip(actor, parameters(model.actor), strict=True))


def test_validation_is_what_an_evaluation_measures():
    """Scenarios of different lengths, one in which vehicles are lost, against `rollout` of each alone."""
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
    assert validation.score(validation.anchor_errors["cruise"].oracle_m, "cruise") == 1
    assert all(0 < own.oracle_m < own.expert_m for own in validation.anchor_errors.values())


def test_presets_are_validated_on_the_frozen_suite():
    assert len(validation_cell(PRESETS["slow-storm"]).episodes) == 50
    assert len(validation_cell(PRESETS["paper-circle"]).episodes) == 64


def test_cost_is_linear_then_logarithmic():
    """Against the integral of the cost's slope, 1 up to LINEAR and LINEAR / t beyond it."""
    plain, dear = (make_training_env(configuration(steps=200), 4, wrappers) for wrappers in ([], [{COST: {}}]))
    for env in (plain, dear):
        env.seed(3)
        env.reset()
    track = dear.get_attr("reference")
    lags = []
    for _ in range(120):
        speed = np.hypot(track[0].u, track[0].v)
        (_, r, _, infos), (_, r_dear, *_) = (env.step(np.full((4, 2), -1, dtype=np.float32)) for env in (plain, dear))
        for lag, a, b in zip([i["position_error"] for i in infos] / speed, r, r_dear, strict=True):
            t = np.linspace(0, lag, 20001)
            assert a - b == pytest.approx(
                np.trapezoid(np.where(t < LINEAR, 1, LINEAR / np.maximum(t, 1e-9)), t), abs=1e-3
            )
            lags.append(lag)
        track = dear.get_attr("reference")
    assert min(lags) < LINEAR < 2 * LINEAR < max(lags)
    none = make_training_env(configuration(), 1, [{COST: {"weight": 0.0, "share": 0.0}}])
    none.reset()
    assert (none.step(np.zeros((1, 2), dtype=np.float32))[1] == 0).all()


def test_cost_with_a_lead_is_that_of_the_extrapolated_error():
    """Against differences of the world error in time, without sensor noise."""
    quiet = Scenario.from_dict({**PRESETS["cruise-current"].to_dict(), "sensors": {}, "name": "quiet", "steps": 60})
    config = Config("sac", ((quiet, 1.0),), authority=(0.4, 0.8), hyperparameters={})
    env = make_training_env(config, 4, [{COST: {"share": 0.0, "lead": 1.5}}]).venv
    env.seed(3)
    rows, rewards = [env.reset()], []
    for _ in range(50):
        row, reward, done, _ = env.step(np.zeros((4, 2), dtype=np.float32))
        assert not done.any()
        rows.append(row)
        rewards.append(reward)
    o = decode_observation(np.concatenate(rows))
    x, y = (np.reshape(e, (51, 4)) for e in to_world(o.e_x, o.e_y, o.cos_psi, o.sin_psi))
    speed, dt = np.hypot(o.u_R, o.v_R).reshape(51, 4), float(o.dt[0])
    moved = [e[1:-1] + 1.5 * (e[2:] - e[:-2]) / (2 * dt) for e in (x, y)]
    lag = np.hypot(*moved) / speed[:-2]
    cost = np.where(lag < LINEAR, lag, LINEAR * (1 + np.log(np.maximum(lag, LINEAR) / LINEAR)))
    np.testing.assert_allclose(-np.array(rewards)[:-1], cost, rtol=0, atol=0.03)
