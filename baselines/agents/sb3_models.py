"""Policies from models of Stable-Baselines3 and sb3-contrib. The files hold pickled objects, which can run any code."""

from __future__ import annotations

import importlib
import json
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.installation import install
from auv_gym.task.observation import SIZE
from auv_gym.task.policy import Policy
from baselines.agents.corrected import CorrectedPolicy
from baselines.policy import Batched, Memory, Starts

_ALGORITHMS = {
    "stable_baselines3.common.policies": ("stable_baselines3", "PPO"),
    "stable_baselines3.sac.policies": ("stable_baselines3", "SAC"),
    "stable_baselines3.td3.policies": ("stable_baselines3", "TD3"),
    "sb3_contrib.common.recurrent.policies": ("sb3_contrib", "RecurrentPPO"),
    "sb3_contrib.tqc.policies": ("sb3_contrib", "TQC"),
    "sb3_contrib.crossq.policies": ("sb3_contrib", "CrossQ"),
    "sb3_contrib.ars.policies": ("sb3_contrib", "ARS"),
}
"""Package and class that load a model, by the module of its network. PPO also loads A2C and TRPO, TD3 also DDPG."""
STATISTICS = "vecnormalize.pkl"
"""File of rl_zoo3 with the statistics of `VecNormalize`, beside a model or in a folder beside it."""
_AUTHORITY = 0.5
"""Default authority of the residual environment."""
LARGEST_DATA = 2**26
"""Largest description [bytes] that is read."""


class _Model(Batched):
    """A model with the normalisation of its training.

    Args:
        model: as loaded.
        statistics: the `VecNormalize` of its training, if there was one.
    """

    def __init__(self, model: Any, statistics: Any) -> None:
        self.model, self.statistics = model, statistics

    def actions(
        self, rows: NDArray[Any], state: Memory | None, episode_start: Starts, deterministic: bool
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return actions and the model's memory, see `Batched`."""
        if self.statistics is not None:
            rows = self.statistics.normalize_obs(rows)
        action, state = self.model.predict(rows, _swapped(state), episode_start, deterministic)
        return action, _swapped(state)


def _swapped(memory: Memory | None) -> Memory | None:
    """Return a recurrent model's memory with its first two axes, layers and vehicles, swapped."""
    return memory and tuple(array.swapaxes(0, 1) for array in memory)


def statistics_file(file: Path) -> Path | None:
    """Return the file with the normalisation statistics of a model, None if there is none.

    It is beside the model, in a folder with the model's name, or that of `CheckpointCallback` of Stable-Baselines3,
    PREFIX_vecnormalize_N_steps.pkl for PREFIX_N_steps.zip.
    """
    prefix, _, steps = file.stem.removesuffix("_steps").rpartition("_")
    checkpoint = file.with_name(f"{prefix}_vecnormalize_{steps}_steps.pkl")
    places = checkpoint, file.with_name(STATISTICS), file.with_suffix("") / STATISTICS
    return next((path for path in places if path.is_file()), None)


def load_model(file: Path, expert: Policy, authority: float | tuple[float, float] = _AUTHORITY) -> Policy:
    """Return the policy of a FILE.zip.

    Args:
        file: the model; statistics of `VecNormalize` beside it are used.
        expert: a policy without memory, which a model of the residual environment corrects.
        authority: of the corrections.

    Raises:
        OSError: the file cannot be read.
        ValueError: the file is damaged, or the model is of another task.
    """
    package, algorithm = _algorithm(file)
    try:
        loader = getattr(importlib.import_module(package), algorithm)
    except ImportError as error:
        needed = install("train") if package == "stable_baselines3" else "install the package sb3-contrib"
        raise ValueError(f"{file} needs {package}: {needed}") from error
    try:
        model = loader.load(file, device="cpu")
        shapes = tuple(model.observation_space.shape), tuple(model.action_space.shape)
        beside = statistics_file(file)
        statistics = pickle.loads(beside.read_bytes()) if beside else None
    except OSError:
        raise
    except (Exception, SystemExit) as error:  # a damaged or foreign pickle can raise anything
        raise ValueError(f"{file} cannot be loaded: {type(error).__name__}: {error}") from error
    if shapes not in (((SIZE,), (2,)), ((SIZE + 2,), (2,))):
        raise ValueError(
            f"{file} takes observations {shapes[0]} and returns actions {shapes[1]}; here they are ({SIZE},), or "
            f"({SIZE + 2},) in the residual environment, and (2,): wrap it in a module and use FILE.py:FACTORY"
        )
    policy = _Model(model, statistics)
    return CorrectedPolicy(expert, policy, authority) if shapes[0] == (SIZE + 2,) else policy


def _algorithm(file: Path) -> tuple[str, str]:
    """Return package and class that load a file."""
    try:
        with zipfile.ZipFile(file) as archive:
            if archive.getinfo("data").file_size > LARGEST_DATA:
                raise ValueError(f"its description is larger than {LARGEST_DATA} bytes")
            module = json.loads(archive.read("data"))["policy_class"]["__module__"]
    except OSError:
        raise
    except Exception as error:  # zipfile.BadZipFile, zlib.error, KeyError, TypeError, RecursionError ...
        raise ValueError(f"{file} is not a model of Stable-Baselines3: {error}") from error
    if not isinstance(module, str) or module not in _ALGORITHMS:
        raise ValueError(f"{file} has a network of {module}; allowed are those of {', '.join(_ALGORITHMS)}")
    return _ALGORITHMS[module]
