"""A policy whose memory is dropped says so, and an agent in the other regime; whoever does it right hears nothing."""

import warnings

import gymnasium as gym
import numpy as np
import pytest

from baselines import make_policy

REMEMBERING = ("integral", "ekf", "current-observer", "apg-cruise")


def driven(policy, kept, scenario="cruise-storm", steps=4, **first):
    """Drive a few steps, with the memory or without, and return the messages of warnings."""
    env = gym.make("auv_gym:UnderactuatedAUVTrack-v0", scenario=scenario)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        observation, _ = env.reset(seed=1)
        memory = None
        for _ in range(steps):
            action, after = policy.predict(observation, memory, **first)
            memory = after if kept else None
            observation, *_ = env.step(action)
    return [str(w.message) for w in caught if w.filename == __file__]


@pytest.mark.parametrize("name", REMEMBERING)
def test_dropped_memory_is_a_warning(name):
    policy = make_policy(name)
    assert driven(policy, kept=True) == []
    messages = driven(policy, kept=False)
    assert len(messages) == 3  # at every step but the first
    assert all("its memory was dropped" in message for message in messages)


def test_a_policy_without_memory_has_nothing_to_drop():
    for name in ("backstepping", "open-loop", "los-pid"):
        policy = make_policy(name)
        _, memory = policy.predict(gym.make("auv_gym:UnderactuatedAUVTrack-v0").reset(seed=0)[0])
        assert memory is not None or driven(policy, kept=False) == []


def test_episode_start_resets_the_memory():
    assert driven(make_policy("integral"), kept=False, episode_start=np.array([True])) == []
    assert driven(make_policy("apg-cruise"), kept=False, episode_start=np.array([True])) == []


def test_an_agent_in_the_other_speed_range_warns_once():
    for name, scenario in (("apg-slow", "cruise-calm"), ("apg-cruise", "paper-circle")):
        policy = make_policy(name)
        messages = driven(policy, kept=True, scenario=scenario)
        assert len(messages) == 1
        assert "choose the agent for that speed range" in messages[0]
        assert driven(policy, kept=True, scenario=scenario) == []


@pytest.mark.parametrize("speed_range", ["slow", "cruise"])
def test_no_warnings_in_the_speed_range_of_an_agent(speed_range):
    policy, n = make_policy(f"apg-{speed_range}"), 200
    env = gym.make_vec(
        "auv_gym:UnderactuatedAUVTrack-v0", n, vectorization_mode="vector_entry_point", scenario=f"{speed_range}-calm"
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        policy.predict(env.reset(seed=0)[0])
