"""d3rlpy: TD3+BC and IQL on a dataset of Minari's DataCollector, scored by evaluate.py, and SAC online on both ids."""

import os
from pathlib import Path

os.environ["MINARI_DATASETS_PATH"] = str(Path("datasets").resolve())

import d3rlpy
import gymnasium as gym
import numpy as np
import torch
from common import IDS, TRACK, figure, steady_error, steps, works
from expert_dataset import expert_dataset
from offline_policy import write_policy

if __name__ == "__main__":
    d3rlpy.seed(0)
    recorded = expert_dataset(TRACK, "auv_gym/offline-v0", steps(40, 4), (0.0, 0.1))
    episodes = list(recorded.iterate_episodes())
    length = {len(e.actions) for e in episodes}
    dataset = d3rlpy.dataset.MDPDataset(
        np.concatenate([e.observations[:-1] for e in episodes]).astype(np.float32),
        np.concatenate([e.actions for e in episodes]),
        np.concatenate([e.rewards for e in episodes]).astype(np.float32),
        np.concatenate([e.terminations for e in episodes]),
        np.concatenate([e.truncations for e in episodes]),
    )
    assert length == {600}
    updates, errors = steps(20_000, 200), []
    for config in (d3rlpy.algos.TD3PlusBCConfig(), d3rlpy.algos.IQLConfig()):
        algorithm = config.create(device="cpu:0")
        algorithm.fit(
            dataset, updates, updates, show_progress=False, logger_adapter=d3rlpy.logging.NoopAdapterFactory()
        )
        algorithm.save_policy("policy.pt")
        errors.append(steady_error(write_policy(torch.jit.load("policy.pt"), Path(type(algorithm).__name__))))
    for env_id in IDS:
        env = gym.make(env_id)
        online = d3rlpy.algos.SACConfig(batch_size=32).create(device="cpu:0")
        online.fit_online(
            env,
            n_steps=steps(5000, 100),
            n_steps_per_epoch=steps(5000, 100),
            update_start_step=50,
            show_progress=False,
            logger_adapter=d3rlpy.logging.NoopAdapterFactory(),
        )
        assert np.isfinite(online.predict(env.reset(seed=0)[0][None].astype(np.float32))).all()
    bc, iql = map(figure, errors)
    works(f"TD3+BC{bc} and IQL{iql} offline on a dataset of cruise-calm, scored by evaluate.py; SAC online on both ids")
