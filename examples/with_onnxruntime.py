"""ONNX Runtime: compares an exported agent and exported actors of Stable-Baselines3 with their originals."""

import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import onnxruntime
import torch
from common import IDS, TRACK, steps, works
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

from baselines import make_policy


class Actor(torch.nn.Module):
    """The deterministic actor of a model of Stable-Baselines3."""

    def __init__(self, policy: torch.nn.Module) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, observation: torch.Tensor) -> torch.Tensor:
        """Return the mean action."""
        return self.policy(observation, deterministic=True)[0]


def exported(model: PPO, file: Path) -> onnxruntime.InferenceSession:
    """Write the actor as a file and return a session with it."""
    size = model.observation_space.shape[0]
    torch.onnx.export(
        Actor(model.policy), (torch.zeros(1, size),), str(file), opset_version=17, dynamo=False,
        input_names=["observation"], output_names=["action"], dynamic_axes={"observation": {0: "n"}},
    )  # fmt: skip
    return onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])


def agree(name: str, count: int) -> None:
    """Export an agent and compare its graph with the agent in each control step of an episode, including the memory."""
    words = ("--out", ".", "--format", "onnx")
    subprocess.run([sys.executable, "-m", "baselines", "export", name, *words], check=True, stdout=subprocess.DEVNULL)
    session = onnxruntime.InferenceSession(f"{name}.onnx", providers=["CPUExecutionProvider"])
    env, policy, memory = gym.make(TRACK), make_policy(name), None
    given = {i.name: np.zeros((1, i.shape[1]), np.float32) for i in session.get_inputs()}
    outputs = [output.name for output in session.get_outputs()]
    observation, _ = env.reset(seed=0)
    for _ in range(count):
        given["observation"][0] = observation
        results = dict(zip(outputs, session.run(None, given), strict=True))
        expected, memory = policy.predict(observation, memory)
        np.testing.assert_allclose(results["action"][0], expected, rtol=0, atol=1e-5)
        given |= {key.removeprefix("next_"): value for key, value in results.items() if key.startswith("next_")}
        observation, *_ = env.step(expected)


if __name__ == "__main__":
    agree("ppo-cruise", steps(600, 600))
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
    works("an exported agent with its memory over an episode, and actors of Stable-Baselines3 on both ids, within 1e-5")
