"""Read hyper-parameters in the YAML format of rl_zoo3: a table for each environment id.

`n_timesteps`, and `expert` and `authority` in `env_kwargs`, are defaults of command line options. The other entries are
hyper-parameters of the algorithm. YAML reads 3e-4 as a string; write 0.0003 or !!float 3e-4. The reader of rl_zoo3 is
not used: it evaluates strings as Python code and requires Optuna.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from baselines.tools.files import parse_yaml, read_yaml

_ENV_KWARGS = ("authority", "expert", "scenario")  # the scenario is for rl_zoo3 only; `--scenario` replaces it
_FOLDER = Path(__file__).parent
TRAINED_ENV = "UnderactuatedAUVTrackResidual-v0"  # the key of the files
FINE_TUNING_FILE_NAME = "fine-tuning"
"""The key of the hyper-parameters that differ from those of an agent's own training, if it is trained further."""


@dataclass(frozen=True)
class Hyperparameters:
    """The hyper-parameters of a file for an environment."""

    values: Mapping[str, Any]  # of the algorithm
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
        ValueError: the file has another format.
    """
    tables = read_yaml(file)
    table = tables.get(key) if isinstance(tables, Mapping) else None
    if not isinstance(table, Mapping) or not all(isinstance(key, str) for key in table):
        raise ValueError(f"{file} has no table of hyper-parameters under {key}")
    values = dict(table)
    env = values.pop("env_kwargs", {})
    if not isinstance(env, Mapping):
        raise ValueError(f"{file}: env_kwargs is {env!r}; it must be a table")
    if unknown := [name for name in env if name not in _ENV_KWARGS]:
        raise ValueError(f"{file}: env_kwargs has {unknown[0]!r}; allowed are {', '.join(_ENV_KWARGS)}")
    authority = env.get("authority")
    if isinstance(authority, (int, float)) and not isinstance(authority, bool):
        authority = (authority,)
    if authority is not None and not isinstance(authority, (list, tuple)):
        raise ValueError(f"{file}: authority is {authority!r}; it must be a number, or one each for surge and yaw")
    return Hyperparameters(
        values, values.pop("n_timesteps", None), env.get("expert"), None if authority is None else tuple(authority)
    )


def changes_of(words: Sequence[str]) -> dict[str, Any]:
    """Return the hyper-parameters of words NAME=VALUE, where a value is YAML, or a number such as 3e-4.

    Raises:
        ValueError: a word has another form.
    """
    changes = {}
    for word in words:
        name, _, text = word.partition("=")
        try:
            value = parse_yaml(text)
        except ValueError:
            value = None
        if not name or value is None:
            raise ValueError(f"--set is {word!r}; it must be NAME=VALUE, such as effort_weight=0.1")
        if isinstance(value, str):
            with suppress(ValueError):
                value = float(value)
        changes[name] = value
    return changes


def hyperparameter_words(changes: Mapping[str, Any]) -> list[str]:
    """Return hyper-parameters as words NAME=VALUE."""
    return [f"{name}={json.dumps(value, separators=(',', ':'))}" for name, value in changes.items()]


def shipped(algo: str) -> Path:
    """Return the file of an algorithm; TQC has the hyper-parameters of SAC."""
    return _FOLDER / f"{'sac' if algo == 'tqc' else algo}.yml"
