"""What to evaluate: a command line's words, checked and resolved before anything runs."""

from __future__ import annotations

import hashlib
import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

from auv_gym.presets import PRESETS
from auv_gym.scenario import Scenario
from baselines import make_policy
from baselines.agents.loading import caution
from baselines.evaluation import recorded
from baselines.evaluation.rollout import make_env
from baselines.evaluation.runner import STEP_LIMIT, Cell, Run, drawn
from baselines.evaluation.score import EXPERT, ORACLE
from baselines.evaluation.suites import list_suites, load
from baselines.tools.command_line import UsageError
from baselines.tools.workers import Workers, connect

T = TypeVar("T")

DRAWN: dict[str, tuple[str, ...]] = {"presets": tuple(PRESETS), "paper": ("paper-circle",)}
"""Scenarios of each suite whose episodes are drawn from the seed, by name; the others are frozen."""
DEFAULT_SUITE, DEFAULT_EPISODES = "benchmark-v1", 20


@dataclass(frozen=True)
class Request:
    """An evaluation that can run."""

    policies: tuple[str, ...]  # the expert first
    suite: str | None  # None: scenarios of the user's own choice
    hash: str  # the same hash, the same task
    cells: tuple[Cell, ...]
    seed: int
    workers: Workers
    out: Path
    step_limit: float = STEP_LIMIT  # [s] largest time of a decision
    resume: bool = False  # whether to use the runs that an interrupted evaluation has left in `out`
    command: str = ""  # as the user gave it
    earlier: tuple[Run, ...] = ()  # recorded runs to compare with

    @classmethod
    def of(
        cls,
        policies: Sequence[str],
        suite: str | None,
        scenarios: Sequence[str],
        episodes: int | None,
        seed: int,
        jobs: int | None,
        out: Path,
        step_limit: float = STEP_LIMIT,
        resume: bool = False,
        cluster: str | None = None,
        command: str = "",
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
        if not step_limit > 0:
            raise UsageError(f"--step-limit is {step_limit}; it must be a positive number of seconds")
        names = checked_policies((EXPERT, *policies))
        suite = suite if scenarios else suite or DEFAULT_SUITE
        earlier: tuple[Run, ...] = ()
        if suite in list_suites():
            cells, digest, earlier = _frozen(suite, episodes, seed, names)
            if all(run.policy != ORACLE for run in earlier):
                names = (*names, ORACLE)
        else:
            cells, digest = _drawn(suite, scenarios, episodes, seed)
        workers = _workers(jobs, cluster)
        checked_folder(out)
        policies = tuple(dict.fromkeys(names))
        return cls(policies, suite, digest, cells, seed, workers, out, step_limit, resume, command, earlier)

    @property
    def scenarios(self) -> tuple[Scenario, ...]:
        """The scenarios of the cells."""
        return tuple(cell.scenario for cell in self.cells)

    @property
    def steps(self) -> int:
        """Control steps of each policy, over all episodes."""
        return sum(len(cell.episodes) * cell.scenario.steps for cell in self.cells)


def _workers(jobs: int | None, cluster: str | None) -> Workers:
    if cluster is None:
        return Workers(jobs or min(2, os.cpu_count() or 1))
    processors = checked(partial(connect, cluster))
    return Workers(jobs or processors, on_cluster=True)


def _frozen(
    name: str, episodes: int | None, seed: int, live: Sequence[str]
) -> tuple[tuple[Cell, ...], str, tuple[Run, ...]]:
    """Return the cells of a frozen suite, or the first episodes of each; its hash; recorded runs of other policies."""
    if seed:
        raise UsageError(f"--seed is {seed}; the episodes of suite {name} are frozen, so it must be 0 or left out")
    suite = checked(partial(load, name))
    found = recorded.load(suite)
    for policy, reason in found.refused.items():
        if policy not in live:
            print(f"note: the recorded rows of {policy} are left out: {reason}", file=sys.stderr)
    runs = tuple(run for run in found.runs if run.policy not in live)
    if episodes is None or all(episodes >= len(cell.episodes) for cell in suite.cells):
        return suite.cells, suite.hash, runs
    cells = tuple(Cell(cell.scenario, cell.episodes[:episodes]) for cell in suite.cells)
    first = tuple(replace(run, measures=run.measures and run.measures[:episodes]) for run in runs)
    return cells, hashlib.sha256(f"{suite.hash} {episodes}".encode()).hexdigest(), first


def _drawn(suite: str | None, names: Sequence[str], episodes: int | None, seed: int) -> tuple[tuple[Cell, ...], str]:
    """Return what is to run, and its hash."""
    if suite is not None and suite not in DRAWN:
        raise UsageError(f"unknown suite {suite!r}; allowed are {', '.join((*DRAWN, *list_suites()))}")
    scenarios = _distinct(checked_scenario(name) for name in names or DRAWN[suite or ""])
    count = DEFAULT_EPISODES if episodes is None else episodes
    record = {"scenarios": [s.to_dict() for s in scenarios], "episodes": count, "seed": seed}
    text = json.dumps(record, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return tuple(drawn(s, count, seed) for s in scenarios), hashlib.sha256(text.encode()).hexdigest()


def checked(make: Callable[[], T]) -> T:
    """Return what `make` returns.

    Raises:
        UsageError: it complains about the user's input, or a file cannot be read.
    """
    try:
        return make()
    except OSError as error:
        raise UsageError(f"cannot read {error.filename}: {error.strerror}") from error
    except ValueError as error:
        raise UsageError(str(error)) from error


def checked_scenario(name: str, others: Iterable[str] = ()) -> Scenario:
    """Return the scenario of a preset's name or a file, once it is known that its environment can be made.

    Args:
        name: of the preset, or path of the file.
        others: names that the caller takes, for the message.

    Raises:
        UsageError: there is none, or it cannot be used.
    """
    if name in PRESETS:
        return PRESETS[name]
    if not name.endswith((".toml", ".json")):
        known = ", ".join((*others, *PRESETS))
        raise UsageError(f"unknown scenario {name!r}; allowed are a .toml or .json file, or one of {known}")
    scenario = checked(partial(Scenario.load, name))
    checked(partial(make_env, scenario))
    return scenario


def _distinct(scenarios: Iterable[Scenario]) -> tuple[Scenario, ...]:
    """Return the scenarios without repetitions."""
    by_name: dict[str, Scenario] = {}
    for scenario in scenarios:
        if by_name.setdefault(scenario.name, scenario) != scenario:
            raise UsageError(f"two different scenarios are called {scenario.name!r}; rename one of them")
    return tuple(by_name.values())


def checked_policies(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names without repetitions, once it is known that each of them makes a policy.

    Raises:
        UsageError: one does not.
    """
    for name in names:
        if (note := caution(name)) is not None:
            print(f"note: {note}", file=sys.stderr)
        checked(partial(make_policy, name))
    return tuple(dict.fromkeys(names))


def checked_folder(folder: Path) -> Path:
    """Return a folder, made if need be, once it is known that it can be written to.

    Raises:
        UsageError: it cannot.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise UsageError(f"--out {folder} is not a folder that can be written to: {error.strerror}") from error
    return folder
