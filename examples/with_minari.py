"""Minari: datasets of its DataCollector, and behaviour cloning from one of them, scored by evaluate.py."""

import os
from pathlib import Path

os.environ["MINARI_DATASETS_PATH"] = str(Path("datasets").resolve())

import minari
import numpy as np
import torch
from common import IDS, TRACK, figure, steady_error, steps, works
from expert_dataset import expert_dataset
from offline_policy import write_policy
from torch import nn


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
        dataset = expert_dataset(env_id, f"auv_gym/collected-{i}/expert-v0", 2)
        assert (dataset.total_episodes, dataset.total_steps) == (2, 1200)
        env = dataset.recover_environment()
        assert (env.reset(seed=0)[0] == dataset[0].observations[0]).all()
    expert_dataset(TRACK, "auv_gym/clone-v0", steps(40, 4), (0.0, 0.1))
    net = cloned(minari.load_dataset("auv_gym/clone-v0"), steps(20_000, 1000))
    example = torch.zeros(1, 18)
    error = steady_error(write_policy(torch.jit.trace(net, example), Path("cloned")))
    works(f"DataCollector on both ids; a clone of the expert{figure(error)} in cruise-calm")
