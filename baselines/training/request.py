"""What to train: a command line's words, checked and resolved before anything is written."""

from __future__ import annotations

import importlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from auv_gym.scenario import Scenario
from baselines.evaluation.request import checked, checked_folder, checked_scenario
from baselines.evaluation.score import EXPERT
from baselines.tools.command_line import UsageError
from baselines.tools.workers import Workers
from baselines.training.config import ALGORITHMS, Config
from baselines.training.hyperparameters import changes_of, load_hyperparameters, shipped
from baselines.training.mixtures import MIXTURES
from baselines.training.options import Options
from baselines.training.run_folder import AGENT, LOCK, read_config

DEFAULT_AUTHORITY = (0.5,)  # largest correction of surge and yaw, a fraction of the limits
DEFAULT_TIMESTEPS = 1_000_000  # control steps, summed over vehicles


@dataclass(frozen=True)
class Request:
    """Trainings that can run: configurations that differ in the seed, a folder each."""

    configs: tuple[Config, ...]
    folders: tuple[Path, ...]
    out: Path
    workers: Workers
    command: str = ""  # as the user gave it

    @classmethod
    def of(cls, options: Options, command: str = "") -> Request:
        """Return the request of a command line's options; its folders exist and are writable then.

        Raises:
            UsageError: an option is wrong, or a folder holds something else; the message says what is allowed.
        """
        if options.seeds < 1:
            raise UsageError(f"--seeds is {options.seeds}; it must be 1 or more")
        workers = checked(partial(Workers.of, options.jobs, options.cluster))
        config = _config(options)
        configs = tuple(checked(partial(replace, config, seed=config.seed + i)) for i in range(options.seeds))
        checked(partial(check, config))
        name = f"{options.algo}-{'-'.join(name_of(s) for s in options.scenario)}"
        out = options.out or Path("runs/train") / name
        folders = (out,) if len(configs) == 1 else tuple(out / f"seed-{c.seed}" for c in configs)
        for each, folder in zip(configs, folders, strict=True):
            _check_contents(each, folder, options.resume)
        for folder in folders:
            checked_folder(folder)
        return cls(configs, folders, out, workers, command)


def _config(options: Options) -> Config:
    """Return the configuration of a command line's options; what they leave open the hyper-parameters say."""
    if options.algo not in ALGORITHMS:
        raise UsageError(f"unknown algorithm {options.algo!r}; allowed are {', '.join(ALGORITHMS)}")
    found = checked(partial(load_hyperparameters, options.hyperparameters or shipped(options.algo)))
    changed = checked(partial(changes_of, options.set))
    return checked(
        lambda: Config(
            options.algo,
            resolved(options.scenario),
            options.expert or found.expert or EXPERT,
            _pair(options.authority or found.authority or DEFAULT_AUTHORITY),
            options.seed,
            next(n for n in (options.timesteps, found.timesteps, DEFAULT_TIMESTEPS) if n is not None),
            {**found.values, **changed},
        )
    )


def resolved(words: Sequence[str]) -> tuple[tuple[Scenario, float], ...]:
    """Return the scenarios with weights that a command line's words name.

    Raises:
        UsageError: a word names none, or a weight is no positive number.
    """
    found: list[tuple[Scenario, float]] = []
    for word in words:
        name, weight = _split(word)
        if name in MIXTURES:
            found += [(scenario, weight * share) for scenario, share in MIXTURES[name]]
        else:
            found.append((checked_scenario(name, tuple(MIXTURES)), weight))
    return tuple(found)


def name_of(word: str) -> str:
    """Return the name that a word of `--scenario` gives a run folder."""
    return Path(_split(word)[0]).stem


def _split(word: str) -> tuple[str, float]:
    """Return name and weight of NAME or NAME:WEIGHT."""
    name, colon, text = word.rpartition(":")
    if not colon or word.endswith((".toml", ".json")):
        return word, 1.0
    try:
        weight = float(text)
    except ValueError:
        weight = math.nan
    if not 0 < weight < math.inf:
        raise UsageError(f"scenario {word!r} has weight {text!r}; it must be a positive number")
    return name, weight


def _pair(authority: Sequence[float]) -> Any:
    return (*authority, *authority) if len(authority) == 1 else tuple(authority)


def check(config: Config) -> None:
    """Raise ValueError if the algorithm cannot train the configuration."""
    importlib.import_module(ALGORITHMS[config.algo]).check(config)


def _check_contents(config: Config, folder: Path, resume: bool) -> None:
    """Raise UsageError if a folder holds something other than a run to go on with."""
    there = checked(partial(read_config, folder))
    if there is None:
        if folder.is_dir() and any(file.name != LOCK for file in folder.iterdir()):
            raise UsageError(f"--out {folder} is not empty and holds no run of train.py; choose another folder")
        return
    if (mine := config.to_dict()) != (theirs := there.to_dict()):
        name = next(key for key in mine if mine[key] != theirs[key])
        change = f": {theirs[name]} instead of {mine[name]}" if name not in ("scenarios", "hyperparameters") else ""
        raise UsageError(f"--out {folder} holds a run with other {name}{change}; choose another folder")
    finished = (folder / AGENT).exists()
    if not resume:
        state = "finished" if finished else "unfinished"
        advice = (
            "choose another folder, or delete it" if finished else "add --resume to go on, or choose another folder"
        )
        raise UsageError(f"--out {folder} holds this run already, {state}; {advice}")
