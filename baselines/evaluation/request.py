"""What to evaluate: a command line's words, checked and resolved before anything runs."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

from auv_gym.scenario import PRESETS, Scenario
from baselines import make_policy
from baselines.command_line import UsageError
from baselines.evaluation.runner import make_env

T = TypeVar("T")

EXPERT = "backstepping"
"""The policy that every other one is compared with."""

SUITES: dict[str, tuple[str, ...]] = {"presets": tuple(PRESETS), "paper": ("paper-circle",)}
"""Scenarios of each suite, by name."""


@dataclass(frozen=True)
class Request:
    """An evaluation that can run."""

    policies: tuple[str, ...]  # the expert first
    suite: str | None  # None: scenarios of the user's own choice
    scenarios: tuple[Scenario, ...]
    episodes: int
    seed: int
    jobs: int
    out: Path

    @classmethod
    def of(
        cls,
        policies: Sequence[str],
        suite: str | None,
        scenarios: Sequence[str],
        episodes: int,
        seed: int,
        jobs: int | None,
        out: Path,
    ) -> Request:
        """Return the request of a command line's options; `out` exists and is writable then.

        Raises:
            UsageError: an option is wrong; the message says what is allowed.
        """
        if suite is not None and scenarios:
            raise UsageError("--suite and --scenario exclude each other; give one of them")
        for name, value, least in (("--episodes", episodes, 1), ("--seed", seed, 0), ("--jobs", jobs, 1)):
            if value is not None and value < least:
                raise UsageError(f"{name} is {value}; it must be {least} or more")
        names = (EXPERT, *policies)
        for name in names:
            _checked(partial(make_policy, name))
        if not scenarios:
            suite = suite or "presets"
            if suite not in SUITES:
                raise UsageError(f"unknown suite {suite!r}; allowed are {', '.join(SUITES)}")
        chosen = _distinct(_scenario(name) for name in scenarios or SUITES[suite or "presets"])
        _check_writable(out)
        jobs = jobs or min(2, os.cpu_count() or 1)
        return cls(tuple(dict.fromkeys(names)), suite, chosen, episodes, seed, jobs, out)

    @property
    def hash(self) -> str:
        """SHA-256 of the canonical JSON of scenarios, episodes and seed: the same hash, the same task."""
        record = {"scenarios": [s.to_dict() for s in self.scenarios], "episodes": self.episodes, "seed": self.seed}
        text = json.dumps(record, sort_keys=True, separators=(",", ":"), allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()


def _checked(make: Callable[[], T]) -> T:
    """Return what `make` returns, its complaints about the user's input as a UsageError."""
    try:
        return make()
    except OSError as error:
        raise UsageError(f"cannot read {error.filename}: {error.strerror}") from error
    except ValueError as error:
        raise UsageError(str(error)) from error


def _scenario(name: str) -> Scenario:
    """Return the scenario of a preset's name or a file, once it is known that its environment can be made."""
    if name in PRESETS:
        return PRESETS[name]
    if not name.endswith((".toml", ".json")):
        raise UsageError(
            f"unknown scenario {name!r}; allowed are a .toml or .json file, or one of {', '.join(PRESETS)}"
        )
    scenario = _checked(partial(Scenario.load, name))
    _checked(partial(make_env, scenario))
    return scenario


def _distinct(scenarios: Iterable[Scenario]) -> tuple[Scenario, ...]:
    """Return the scenarios without repetitions."""
    by_name: dict[str, Scenario] = {}
    for scenario in scenarios:
        if by_name.setdefault(scenario.name, scenario) != scenario:
            raise UsageError(f"two different scenarios are called {scenario.name!r}; rename one of them")
    return tuple(by_name.values())


def _check_writable(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise UsageError(f"--out {folder} is not a folder that can be written to: {error.strerror}") from error
