"""A TorchScript network as a policy for evaluate.py; `write_policy` copies this file into the network's folder."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import torch

NETWORK = "network.pt"


class Network:
    """A policy without memory that evaluates a network."""

    def __init__(self, network: Any) -> None:
        self.network = network

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = True
    ) -> Any:
        """Return the action (2,) or actions (N, 2), and no memory."""
        with torch.no_grad():
            rows = torch.tensor(np.atleast_2d(observation), dtype=torch.float32)
            actions = np.clip(self.network(rows).numpy(), -1.0, 1.0)
        return (actions[0] if observation.ndim == 1 else actions), None


def policy() -> Network:
    """Return the policy of the network in the folder of this file."""
    return Network(torch.jit.load(str(Path(__file__).with_name(NETWORK))))


def write_policy(network: Any, folder: Path) -> str:
    """Write a network and a copy of this file into a folder, and return the policy's name for evaluate.py."""
    folder.mkdir(parents=True, exist_ok=True)
    network.save(str(folder / NETWORK))
    shutil.copy(__file__, folder / "policy.py")
    return f"{folder / 'policy.py'}:policy"
