"""ONNX Runtime: an agent as one graph, run without this package's networks, equal to the agent over an episode."""

from pathlib import Path

import numpy as np
import onnxruntime
import torch
from common import IDS, TRACK, steps, works
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env


class Actor(torch.nn.Module):
    """The deterministic actor of a model of Stable-Baselines3."""

    def __init__(self, policy: torch.nn.Module) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Return the mean action."""
        return self.policy(observation, deterministic=True)[0]


def exported(model: PPO, file: Path) -> onnxruntime.InferenceSession:
    """Return a session of the actor, written as a file."""
    size = model.observation_space.shape[0]
    torch.onnx.export(
        Actor(model.policy), (torch.zeros(1, size),), str(file), opset_version=17, dynamo=False,
        input_names=["observation"], output_names=["action"], dynamic_axes={"observation": {0: "n"}},
    )  # fmt: skip
    return onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])


if __name__ == "__main__":
    shown = []
    for env_id in IDS:
        env = make_vec_env(env_id, 2, seed=0)
        model = PPO("MlpPolicy", env, n_steps=64, device="cpu", seed=0).learn(steps(20_000, 128))
        session = exported(model, Path("track.onnx" if env_id == TRACK else "residual.onnx"))
        observation = env.reset()
        for _ in range(50):
            (action,) = session.run(None, {"observation": observation.astype(np.float32)})
            expected, _ = model.predict(observation, deterministic=True)
            np.testing.assert_allclose(np.clip(action, -1, 1), expected, rtol=0, atol=1e-5)
            observation, *_ = env.step(expected)
    shown.append("actors of Stable-Baselines3 on both ids")
    works(f"{' and '.join(shown)}, equal within 1e-5")
