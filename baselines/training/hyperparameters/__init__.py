"""Hyper-parameters in rl_zoo3's YAML format: a table for each environment id.

`n_timesteps` and, of `env_kwargs`, `expert` and `authority` are defaults of the command line's options. The rest is
what the algorithm gets. YAML reads 3e-4 as a word; write 0.0003 or !!float 3e-4. rl_zoo3's own reader belongs to its
experiment manager, which evaluates strings as Python and needs Optuna and more.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from baselines.tools.files import parse_yaml, read_yaml

_FOLDER = Path(__file__).parent
TRAINED_ENV = "UnderactuatedAUVTrackResidual-v0"  # the key of the files
FINE_TUNING_FILE_NAME = "fine-tuning"
"""The key of what is other than in an agent's own training, where a training begins with that agent."""


@dataclass(frozen=True)
class Hyperparameters:
    """What a file says about an environment."""

    values: Mapping[str, Any]  # for the algorithm
    timesteps: int | None
    expert: str | None
    authority: tuple[float, ...] | None


def load_hyperparameters(file: Path, key: str = TRAINED_ENV) -> Hyperparameters:
    """Return the hyper-parameters of a YAML file.

    Args:
        file: the file.
        key: of the table in it: that of the residual environment, or `FINE_TUNING_FILE_NAME`.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is no such file.
    """
    tables = read_yaml(file)
    table = tables.get(key) if isinstance(tables, Mapping) else None
    if not isinstance(table, Mapping) or not all(isinstance(key, str) for key in table):
        raise ValueError(f"{file} has no table of hyper-parameters under {key}")
    values = dict(table)
    env = values.pop("env_kwargs", {})
    if not isinstance(env, Mapping):
        raise ValueError(f"{file}: env_kwargs is {env!r}; it must be a table")
    authority = env.get("authority")
    if isinstance(authority, (int, float)):
        authority = (authority,)
    if authority is not None and not isinstance(authority, (list, tuple)):
        raise ValueError(f"{file}: authority is {authority!r}; it must be a number, or one each for surge and yaw")
    return Hyperparameters(
        values, values.pop("n_timesteps", None), env.get("expert"), None if authority is None else tuple(authority)
    )


def changes_of(words: Sequence[str]) -> dict[str, Any]:
    """Return the hyper-parameters that words NAME=VALUE give; values are YAML, or numbers such as 3e-4.

    Raises:
        ValueError: a word is of another form.
    """
    changes = {}
    for word in words:
        name, _, text = word.partition("=")
        try:
            value = parse_yaml(text)
        except ValueError:
            value = None
        if not name or value is None:
            raise ValueError(f"--set {word!r} sets nothing; it must be NAME=VALUE, such as effort_weight=0.1")
        if isinstance(value, str):
            with suppress(ValueError):
                value = float(value)
        changes[name] = value
    return changes


def hyperparameter_words(changes: Mapping[str, Any]) -> list[str]:
    """Return hyper-parameters as words NAME=VALUE."""
    return [f"{name}={json.dumps(value, separators=(',', ':'))}" for name, value in changes.items()]


def shipped(algo: str) -> Path:
    """Return the file of an algorithm; TQC learns well with what SAC learns with."""
    return _FOLDER / f"{'sac' if algo == 'tqc' else algo}.yml"
