"""Records of episodes: equal to the environment's episodes, alone and in parallel."""

import gymnasium as gym
import numpy as np
import pytest

from auv_gym.scenarios.presets import PRESETS
from auv_gym.task.observation import SIZE
from baselines import list_policies, make_policy, run_episode, run_episodes

SHORT = {**PRESETS["cruise-storm"].to_dict(), "steps": 20}
LOSING = {**PRESETS["cruise-storm"].to_dict(), "steps": 200, "lost_distance": 2.0}


@pytest.mark.parametrize(
    ("policy", "scenario"), [("integral-normalised", SHORT), ("open-loop", LOSING), ("ppo-cruise", SHORT)]
)
def test_a_record_equals_an_episode_of_the_environment(policy, scenario):
    record, controller = run_episode(policy, scenario, seed=3), make_policy(policy)
    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario=scenario)
    observation, info = env.reset(seed=3)
    memory, first, k, over = None, np.array([True]), 0, False
    while not over:
        here = env.unwrapped
        np.testing.assert_allclose(record.observations[k], observation, rtol=0, atol=1e-10)
        np.testing.assert_allclose(record.positions[k], here.state[:2], rtol=0, atol=1e-10)
        np.testing.assert_allclose(record.references[k], here.reference[:2], rtol=0, atol=1e-10)
        np.testing.assert_allclose((record.errors[k], record.times[k]), (info["position_error"], info["time"]))
        assert record.saturated[k] == info["saturated"]
        action, memory = controller.predict(observation, memory, first)
        np.testing.assert_allclose(record.actions[k], action, rtol=0, atol=1e-6)
        observation, reward, terminated, truncated, info = env.step(record.actions[k])
        np.testing.assert_allclose(record.rewards[k], reward, rtol=0, atol=1e-10)
        first, over, k = np.array([False]), terminated or truncated, k + 1
    np.testing.assert_allclose(record.observations[k], observation, rtol=0, atol=1e-10)
    np.testing.assert_allclose(record.positions[k], env.unwrapped.state[:2], rtol=0, atol=1e-10)
    assert (len(record.rewards), len(record.errors), record.failed) == (k, k + 1, terminated)
    assert record.total_reward == record.rewards.sum()


def test_parallel_episodes_equal_single_episodes():
    for i, record in enumerate(run_episodes("open-loop", LOSING, 4, seed=5)):
        alone = run_episode("open-loop", LOSING, seed=5 + i)
        assert record.seed == alone.seed == 5 + i
        for name in ("positions", "observations", "actions", "rewards", "errors"):
            np.testing.assert_allclose(getattr(record, name), getattr(alone, name), rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match="episodes is 0"):
        run_episodes("open-loop", SHORT, 0)


def test_records_of_the_oracle_and_of_policies_with_a_preview():
    assert run_episode("oracle", SHORT, seed=0).errors[-1] < run_episode("open-loop", SHORT, seed=0).errors[-1]
    assert run_episode("helm", SHORT).observations.shape[1] > SIZE
    assert {"oracle", "helm"} <= set(list_policies())
