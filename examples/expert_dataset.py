"""A dataset of the expert, recorded by Minari's DataCollector."""

from __future__ import annotations

from collections.abc import Sequence

import gymnasium as gym
import minari
import numpy as np

from baselines import make_policy


def expert_dataset(env_id: str, name: str, episodes: int, noises: Sequence[float] = (0.0,)) -> minari.MinariDataset:
    """Record episodes of the expert and return them as a dataset; for a correction of the expert, the correction 0.

    Args:
        env_id: id of the environment.
        name: id of the dataset, NAMESPACE/NAME-v0.
        episodes: number of episodes for each level of noise.
        noises: standard deviations of white noise on the actions, as fractions of the limits.
    """
    env, expert, rng = minari.DataCollector(gym.make(env_id)), make_policy("backstepping"), np.random.default_rng(0)
    for seed in range(episodes * len(noises)):
        noise = noises[seed // episodes]
        observation, _ = env.reset(seed=seed)
        over = False
        while not over:
            action = np.zeros(2) if "Residual" in env_id else expert.predict(observation)[0]
            action = np.clip(action + noise * rng.standard_normal(2), -1.0, 1.0).astype(np.float32)
            observation, _, terminated, truncated, _ = env.step(action)
            over = terminated or truncated
    about = {"author": "auv_gym contributors", "author_email": "", "code_permalink": "", "description": env_id}
    return env.create_dataset(name, algorithm_name="backstepping", **about)
