"""Tianshou: experiments with PPO and SAC by the high-level interface, with the id of an environment."""

import numpy as np
from common import IDS, steps, works
from tianshou.highlevel.config import OffPolicyTrainingConfig, OnPolicyTrainingConfig
from tianshou.highlevel.env import EnvFactoryRegistered, VectorEnvType
from tianshou.highlevel.experiment import ExperimentConfig, PPOExperimentBuilder, SACExperimentBuilder

if __name__ == "__main__":
    size = steps(5000, 100)
    shared = {
        "max_epochs": 1,
        "epoch_num_steps": size,
        "num_training_envs": 2,
        "num_test_envs": 1,
        "test_step_num_episodes": 1,
        "batch_size": 64,
        "collection_step_num_env_steps": 100,
    }
    for env_id in IDS:
        for builder, config in (
            (PPOExperimentBuilder, OnPolicyTrainingConfig(**shared)),
            (SACExperimentBuilder, OffPolicyTrainingConfig(update_step_num_gradient_steps_per_sample=0.1, **shared)),
        ):
            factory = EnvFactoryRegistered(task=env_id, venv_type=VectorEnvType.DUMMY)
            experiment = ExperimentConfig(seed=0, device="cpu", watch=False, persistence_enabled=False)
            built = builder(factory, experiment, config).build()
            result = built.run()
            assert result.trainer_result is not None
            assert np.isfinite(result.trainer_result.best_reward)
    works("PPO and SAC by its high-level interface, with test episodes; both ids")
