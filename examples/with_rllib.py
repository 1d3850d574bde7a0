"""RLlib: trains PPO with the new API stack, saves it and loads it."""

import math
from pathlib import Path

import gymnasium as gym
import ray
from common import IDS, steps, works
from ray.rllib.algorithms.algorithm import Algorithm
from ray.rllib.algorithms.ppo import PPOConfig
from ray.tune.registry import register_env

if __name__ == "__main__":
    ray.init("local", num_cpus=2, include_dashboard=False, log_to_driver=False)
    for env_id in IDS:
        name = env_id.rpartition(":")[2].removesuffix("-v0")  # must differ from the names in Gymnasium's registry
        register_env(name, lambda config, env_id=env_id: gym.make(env_id, **config))
        size = steps(4000, 700)
        config = (
            PPOConfig()
            .environment(name)
            .env_runners(num_env_runners=0, rollout_fragment_length=size)
            .training(train_batch_size_per_learner=size, minibatch_size=100, num_epochs=1)
            .debugging(seed=0)
        )
        algorithm = config.build_algo()
        result = algorithm.train()
        assert math.isfinite(result["env_runners"]["episode_return_mean"])
        saved = algorithm.save_to_path(str(Path(name).resolve()))
        algorithm.stop()
        Algorithm.from_checkpoint(saved).stop()
    ray.shutdown()
    works("PPO on its new stack, checkpoint and return; both ids")
