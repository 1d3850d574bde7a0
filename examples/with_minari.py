"""Minari: its DataCollector, a dataset of `auv-gym dataset`, and behaviour cloning from it, scored by evaluate.py."""

import os
import subprocess
import sys
from pathlib import Path

os.environ["MINARI_DATASETS_PATH"] = str(Path("datasets").resolve())

import gymnasium as gym
import minari
import numpy as np
import torch
from common import IDS, TRACK, figure, steady_error, steps, works
from minari import DataCollector
from offline_policy import write_policy
from torch import nn

from baselines import make_policy


def collected(env_id: str, name: str) -> minari.MinariDataset:
    """Return a dataset of the expert, recorded by Minari's DataCollector."""
    env, expert = DataCollector(gym.make(env_id)), make_policy("backstepping")
    for seed in range(2):
        observation, _ = env.reset(seed=seed)
        over = False
        while not over:
            action = expert.predict(observation)[0] if env_id == TRACK else np.zeros(2, dtype=np.float32)
            observation, _, terminated, truncated, _ = env.step(action)
            over = terminated or truncated
    return env.create_dataset(name, author="auv_gym contributors", code_permalink="", author_email="", description="")


def cloned(dataset: minari.MinariDataset, updates: int) -> nn.Module:
    """Train a network to imitate the actions of a dataset and return it."""
    episodes = list(dataset.iterate_episodes())
    observations = torch.tensor(np.concatenate([e.observations[:-1] for e in episodes]), dtype=torch.float32)
    actions = torch.tensor(np.concatenate([e.actions for e in episodes]), dtype=torch.float32)
    net = nn.Sequential(nn.Linear(observations.shape[1], 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, 2))
    optimizer = torch.optim.Adam(net.parameters(), 1e-3)
    for _ in range(updates):
        batch = torch.randint(len(observations), (256,))
        loss = ((net(observations[batch]) - actions[batch]) ** 2).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return net


if __name__ == "__main__":
    torch.manual_seed(0)
    for i, env_id in enumerate(IDS):
        dataset = collected(env_id, f"auv_gym/collected-{i}/expert-v0")
        assert (dataset.total_episodes, dataset.total_steps) == (2, 1200)
        assert dataset.recover_environment().spec.max_episode_steps == 600
    episodes = str(steps(40, 4))
    words = ("--scenario", "cruise-calm", "--episodes", episodes, "--noise", "0", "0.1", "--out", "datasets")
    subprocess.run([sys.executable, "-m", "baselines", "dataset", *words, "--id", "auv_gym/clone-v0"], check=True)
    net = cloned(minari.load_dataset("auv_gym/clone-v0"), steps(20_000, 1000))
    example = torch.zeros(1, 18)
    error = steady_error(write_policy(torch.jit.trace(net, example), Path("cloned")))
    works(f"DataCollector on both ids; auv-gym dataset; a clone of the expert{figure(error)} in cruise-calm")
