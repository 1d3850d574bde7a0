"""skrl: the runner trains PPO on the scalar and the native vector environments."""

import gymnasium as gym
import numpy as np
from common import IDS, steps, works
from skrl.envs.wrappers.torch import wrap_env
from skrl.utils.runner.torch import Runner

NETWORK = [{"name": "net", "input": "OBSERVATIONS", "layers": [16, 16], "activations": "elu"}]


def configuration(timesteps: int) -> dict[str, object]:
    """Return a runner's configuration."""
    return {
        "seed": 0,
        "models": {
            "separate": True,
            "policy": {"class": "GaussianMixin", "clip_actions": True, "network": NETWORK, "output": "ACTIONS"},
            "value": {"class": "DeterministicMixin", "network": NETWORK, "output": "ONE"},
        },
        "memory": {"class": "RandomMemory", "memory_size": -1},
        "agent": {
            "class": "PPO",
            "rollouts": 16,
            "learning_epochs": 2,
            "mini_batches": 2,
            "experiment": {"directory": "runs", "write_interval": 0, "checkpoint_interval": 0},
        },
        "trainer": {
            "class": "SequentialTrainer",
            "timesteps": timesteps,
            "headless": True,
            "close_environment_at_exit": False,
        },
    }


if __name__ == "__main__":
    count = 0
    for env_id in IDS:
        vector = {"num_envs": 4, "vectorization_mode": "vector_entry_point"}
        for env in (
            gym.wrappers.DtypeObservation(gym.make(env_id), np.float32),  # skrl's networks have single precision
            gym.wrappers.vector.DtypeObservation(gym.make_vec(env_id, **vector, autoreset_mode="NextStep"), np.float32),
        ):
            wrapped = wrap_env(env, wrapper="gymnasium")
            runner = Runner(wrapped, configuration(steps(5000, 64)))
            runner.run("train")
            runner.agent.save(f"agent_{count}.pt")
            runner.agent.load(f"agent_{count}.pt")
            count += 1
    works("its runner trains PPO on the scalar and the native vector environment; both ids")
