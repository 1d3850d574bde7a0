"""The request of a command line, checked completely before anything is written."""

from __future__ import annotations

import importlib
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from auv_gym.physics.vehicle import Vehicle
from auv_gym.scenarios.mixtures import MIXTURES, Mixture
from auv_gym.scenarios.scenario import Scenario
from auv_gym.scenarios.vehicles import as_vehicle, as_vehicle_model
from baselines.agents.names import AGENT_FOLDER
from baselines.evaluation.request import checked_scenario
from baselines.evaluation.score import EXPERT
from baselines.tools.command_line import UsageError, checked, checked_folder
from baselines.tools.workers import Workers
from baselines.training.config import ALGORITHMS, Config
from baselines.training.hyperparameters import (
    FINE_TUNING_FILE_NAME,
    TRAINED_ENV,
    changes_of,
    load_hyperparameters,
    shipped,
)
from baselines.training.initial_agent import ALGO, InitialAgent, fitted, in_own_units
from baselines.training.options import Options
from baselines.training.run_folder import LOCK, read_config

DEFAULT_AUTHORITY = (0.5,)  # largest correction of surge and yaw, a fraction of the limits
DEFAULT_SCENARIO = ("cruise",)  # of `--scenario`
DEFAULT_TIMESTEPS = 1_000_000  # control steps, summed over vehicles


@dataclass(frozen=True)
class Request:
    """Checked trainings: configurations that differ in the seed, and a folder for each."""

    configs: tuple[Config, ...]
    folders: tuple[Path, ...]
    out: Path
    workers: Workers
    command: str = ""  # command line of the user

    @classmethod
    def of(cls, options: Options, command: str = "") -> Request:
        """Return the request of the options of a command line, and create its folders.

        Raises:
            UsageError: an option is wrong, or a folder holds something else; the message says what is allowed.
        """
        workers = checked(partial(Workers.of, options.jobs))
        configs = checked(partial(_configs, options))
        out = options.out or Path("runs/train") / _name(options)
        folders = (out,) if len(configs) == 1 else tuple(out / f"seed-{config.seed}" for config in configs)
        there = [_holds(config, folder, options.resume) for config, folder in zip(configs, folders, strict=True)]
        if options.resume and not any(there):
            print(f"note: --out {out} holds no run yet, so --resume begins one", file=sys.stderr)
        for folder in folders:
            checked_folder(folder)
        return cls(configs, folders, out, workers, command)


def _configs(options: Options) -> tuple[Config, ...]:
    """Return the checked configuration of each seed.

    Defaults of the options come from the initial agent, else from the hyper-parameters.

    Raises:
        OSError: a file cannot be read.
        UsageError: `--scenario` is wrong.
        ValueError: another option is wrong.
    """
    if options.seeds < 1:
        raise ValueError(f"--seeds is {options.seeds}; it must be 1 or more")
    if options.algo not in ALGORITHMS:
        raise ValueError(f"unknown algorithm {options.algo!r}; allowed are {', '.join(ALGORITHMS)}")
    begun = None if options.from_ is None else InitialAgent.of(options.from_)
    if begun and options.algo != ALGO:
        raise ValueError(f"--from requires the algorithm {ALGO}, not {options.algo}; leave out --algo")
    found = load_hyperparameters(
        options.hyperparameters or shipped(options.algo), FINE_TUNING_FILE_NAME if begun else TRAINED_ENV
    )
    changes = changes_of(options.set)
    values, origin = {**found.values, **changes}, None
    expert = options.expert or found.expert or EXPERT
    authority = options.authority or found.authority or DEFAULT_AUTHORITY
    if begun:
        begun.check(options.expert, options.authority, changes)
        values, origin = {**begun.config.hyperparameters, **values}, begun.origin
        expert, authority = begun.agent.expert, begun.agent.authority
    scenarios, steers = _scenarios(options, begun)
    both: Any = tuple(authority) * (2 if len(authority) == 1 else 1)
    timesteps = next(n for n in (options.timesteps, found.timesteps, DEFAULT_TIMESTEPS) if n is not None)
    first = Config(options.algo, scenarios, expert, both, options.seed, timesteps, values, origin, steers)
    configs = tuple(replace(first, seed=first.seed + i) for i in range(options.seeds))
    check(first)
    return configs


def _scenarios(options: Options, begun: InitialAgent | None) -> tuple[Mixture, Vehicle | None]:
    """Return the training scenarios and the vehicle in whose units they are; note left-out scenarios on stderr."""
    if begun and not options.scenario:
        if begun.config.steers is not None and options.vehicle is None:
            return begun.config.scenarios, begun.config.steers
        given = begun.config.scenarios
    else:
        given = resolved(options.scenario or DEFAULT_SCENARIO)
    if options.vehicle is not None:
        as_vehicle(options.vehicle)  # raises ValueError for an unknown vehicle
        if (vehicle_model := as_vehicle_model(options.vehicle)) is not None:
            given, reasons = fitted(given, vehicle_model)
            if reasons:
                print(f"note: {len(reasons)} scenarios are left out: {reasons[0]}", file=sys.stderr)
    return in_own_units(given)


def _name(options: Options) -> str:
    """Return the default name of a run's folder."""
    what = "-".join(
        Path(_split(word)[0]).stem for word in options.scenario or (() if options.from_ else DEFAULT_SCENARIO)
    )
    words = Path(options.from_).name if options.from_ else options.algo, what, Path(options.vehicle or "").stem
    return "-".join(word for word in words if word)


def resolved(words: Sequence[str]) -> tuple[tuple[Scenario, float], ...]:
    """Return the scenarios and weights of the words of `--scenario`.

    Raises:
        UsageError: a scenario is unknown, or a weight is not a positive number.
    """
    found: list[tuple[Scenario, float]] = []
    for word in words:
        name, weight = _split(word)
        if name in MIXTURES:
            found += [(scenario, weight * share) for scenario, share in MIXTURES[name]]
        else:
            found.append((checked_scenario(name, tuple(MIXTURES)), weight))
    return tuple(found)


def _split(word: str) -> tuple[str, float]:
    """Return the name and weight of NAME or NAME:WEIGHT."""
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


def check(config: Config) -> None:
    """Raise ValueError if the algorithm cannot train the configuration."""
    importlib.import_module(ALGORITHMS[config.algo]).check(config)


def _holds(config: Config, folder: Path, resume: bool) -> bool:
    """Return whether a folder holds the run; raise UsageError if it holds something else, or the run without resume."""
    there = checked(partial(read_config, folder))
    if there is None:
        if folder.is_dir() and any(file.name != LOCK for file in folder.iterdir()):
            raise UsageError(f"--out {folder} is not empty and holds no run of `auv-gym train`; choose another folder")
        return False
    if (mine := config.to_dict()) != (theirs := there.to_dict()):
        name = next(key for key in mine if mine[key] != theirs[key])
        change = f": {theirs[name]} instead of {mine[name]}" if name not in ("scenarios", "hyperparameters") else ""
        raise UsageError(f"--out {folder} holds a run with other {name}{change}; choose another folder")
    finished = (folder / AGENT_FOLDER).exists()
    if not resume:
        state = "finished" if finished else "unfinished"
        advice = (
            "choose another folder, or delete it" if finished else "add --resume to continue, or choose another folder"
        )
        raise UsageError(f"--out {folder} holds this run already, {state}; {advice}")
    return True
