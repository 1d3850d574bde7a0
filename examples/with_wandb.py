"""Weights & Biases offline: the callback for Stable-Baselines3 logs a training into a local folder."""

import os
from pathlib import Path

os.environ["WANDB_MODE"] = "offline"

import wandb
from common import IDS, steps, works
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from wandb.integration.sb3 import WandbCallback

if __name__ == "__main__":
    for env_id in IDS:
        run = wandb.init(project="auv_gym", dir=".", sync_tensorboard=True, config={"env": env_id}, save_code=False)
        model = PPO("MlpPolicy", make_vec_env(env_id, 2), n_steps=64, device="cpu", tensorboard_log=f"tb/{run.id}")
        model.learn(steps(20_000, 256), callback=WandbCallback(verbose=0))
        run.finish()
    assert len(list(Path("wandb").glob("offline-run-*/*.wandb"))) >= len(IDS)
    works("WandbCallback offline, with TensorBoard's curves; both ids")
