"""The adapter to Stable-Baselines3, held against its own `DummyVecEnv` of scalar environments."""

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from auv_gym.scenarios.presets import PRESETS
from baselines.training.sb3.vec_env import SB3VecEnv

TRACK = "auv_gym:UnderactuatedAUVTrack-v0"
RESIDUAL = "auv_gym:UnderactuatedAUVTrackResidual-v0"
STORM = {**PRESETS["cruise-storm"].to_dict(), "steps": 40}


def adapted(env_id=TRACK, n=3, **options):
    return SB3VecEnv(gym.make_vec(env_id, num_envs=n, vectorization_mode="vector_entry_point", **options))


@pytest.mark.parametrize("env_id", [TRACK, RESIDUAL])
def test_rollouts_equal_dummy_vec_env_across_autoresets(env_id):
    ours = adapted(env_id, scenario=STORM)
    theirs = DummyVecEnv([lambda: gym.make(env_id, scenario=STORM) for _ in range(3)])
    for env in (ours, theirs):
        env.seed(7)
    np.testing.assert_allclose(ours.reset(), theirs.reset(), rtol=0, atol=1e-12)
    rng = np.random.default_rng(0)
    ends = 0
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


def test_attributes_and_methods_are_the_vector_environments():
    env = adapted(RESIDUAL, n=2, authority=0.25)
    assert env.get_attr("authority") == [(0.25, 0.25)] * 2
    assert [s.name for s in env.get_attr("scenarios", indices=[0])[0]] == ["paper-circle"] * 2
    env.set_attr("authority", (0.1, 0.2))
    assert env.env.authority == (0.1, 0.2)
    with pytest.raises(ValueError, match="all sub-environments"):
        env.set_attr("authority", (0.1, 0.2), indices=[0])
    assert env.env_is_wrapped(gym.Wrapper) == [False, False]
    assert len(env.env_method("reset", seed=1)) == 2


def test_options_reach_the_environment_and_must_agree():
    env = adapted(n=2)
    env.set_options({"initial_error": (2.0, 0.0, 0.0)})
    env.reset()
    assert [info["position_error"] for info in env.reset_infos] == [2.0, 2.0]
    env.set_options([{"initial_error": (2.0, 0.0, 0.0)}, {}])
    with pytest.raises(ValueError, match="options differ"):
        env.reset()


def test_a_short_training_runs():
    env = VecMonitor(adapted(RESIDUAL, n=4, scenario=STORM))
    PPO("MlpPolicy", env, n_steps=64, batch_size=64, n_epochs=1, seed=0, device="cpu").learn(512)
