"""What to train: a command line's words, checked and resolved before anything is written."""

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
from baselines.evaluation.request import checked, checked_folder, checked_scenario
from baselines.evaluation.score import EXPERT
from baselines.tools.command_line import UsageError
from baselines.tools.workers import Workers
from baselines.training.beginning import ALGO, Beginning, checked_craft, fitted, in_own_units
from baselines.training.config import ALGORITHMS, Config
from baselines.training.hyperparameters import ENV_ID, TUNING, changes_of, load_hyperparameters, shipped
from baselines.training.options import Options
from baselines.training.run_folder import AGENT, LOCK, read_config

DEFAULT_AUTHORITY = (0.5,)  # largest correction of surge and yaw, a fraction of the limits
DEFAULT_SCENARIO = ("cruise",)  # words of `--scenario` where none is given
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
        config, notes = _config(options)
        for note in notes:
            print(f"note: {note}", file=sys.stderr)
        configs = tuple(checked(partial(replace, config, seed=config.seed + i)) for i in range(options.seeds))
        checked(partial(check, config))
        out = options.out or Path("runs/train") / _name(options)
        folders = (out,) if len(configs) == 1 else tuple(out / f"seed-{c.seed}" for c in configs)
        for each, folder in zip(configs, folders, strict=True):
            _check_contents(each, folder, options.resume)
        for folder in folders:
            checked_folder(folder)
        return cls(configs, folders, out, workers, command)


def _config(options: Options) -> tuple[Config, list[str]]:
    """Return the configuration of a command line's options, and what to know about it.

    What the options leave open the agent says that it begins with, or the hyper-parameters.
    """
    if options.algo not in ALGORITHMS:
        raise UsageError(f"unknown algorithm {options.algo!r}; allowed are {', '.join(ALGORITHMS)}")
    begun = None if options.from_ is None else checked(partial(Beginning.of, options.from_))
    if begun and options.algo != ALGO:
        raise UsageError(f"--from goes on by the analytic gradient, not by {options.algo}; leave out --algo")
    file = options.hyperparameters or shipped(options.algo)
    found = checked(partial(load_hyperparameters, file, TUNING if begun else ENV_ID))
    changed = checked(partial(changes_of, options.set))
    values = {**found.values, **changed}
    expert, authority = options.expert or found.expert or EXPERT, options.authority or found.authority
    if begun:
        checked(partial(begun.check, options.expert, options.authority, changed))
        values = {**begun.config.hyperparameters, **values}
        expert, authority = begun.agent.expert, begun.agent.authority
    scenarios, steers, notes = _scenarios(options, begun)
    made = checked(
        lambda: Config(
            options.algo,
            scenarios,
            expert,
            _pair(authority or DEFAULT_AUTHORITY),
            options.seed,
            next(n for n in (options.timesteps, found.timesteps, DEFAULT_TIMESTEPS) if n is not None),
            values,
            begun.origin if begun else None,
            steers,
        )
    )
    return made, notes


def _scenarios(options: Options, begun: Beginning | None) -> tuple[Mixture, Vehicle | None, list[str]]:
    """Return what is trained on, the vehicle in whose units that is, and what was left out."""
    if begun and not options.scenario:
        if begun.config.steers is not None and options.vehicle is None:
            return begun.config.scenarios, begun.config.steers, []
        given = begun.config.scenarios
    else:
        given = resolved(options.scenario or DEFAULT_SCENARIO)
    craft, notes = None if options.vehicle is None else checked(partial(checked_craft, options.vehicle)), []
    if craft is not None:
        given, reasons = checked(partial(fitted, given, craft))
        if reasons:
            notes = [f"{len(reasons)} scenarios are left out: {reasons[0]}"]
    own, steers = checked(partial(in_own_units, given))
    return own, steers, notes


def _name(options: Options) -> str:
    """Return the name of the folder of a run whose options name none."""
    what = "-".join(name_of(word) for word in options.scenario or (() if options.from_ else DEFAULT_SCENARIO))
    words = Path(options.from_).name if options.from_ else options.algo, what, Path(options.vehicle or "").stem
    return "-".join(word for word in words if word)


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
