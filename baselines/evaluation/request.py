"""What to evaluate: a command line's words, checked and resolved before anything runs."""

from __future__ import annotations

import hashlib
import json
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple, TypeVar

from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.presets import PRESETS, as_scenario
from auv_gym.scenarios.scenario import Scenario
from baselines.agents.loading import caution
from baselines.evaluation import recorded
from baselines.evaluation.about import NOTHING, checked_about, checked_name
from baselines.evaluation.fingerprints import fingerprint, watched
from baselines.evaluation.options import Options
from baselines.evaluation.recorded import speed_ranges_of
from baselines.evaluation.rollout import make_env
from baselines.evaluation.runner import Cell, Run, drawn
from baselines.evaluation.score import EXPERT, Anchors, speed_range_of
from baselines.evaluation.suites import list_suites, load_suite
from baselines.policies import make_policy
from baselines.tools.command_line import UsageError, printable
from baselines.tools.workers import Workers

T = TypeVar("T")

DRAWN: dict[str, tuple[str, ...]] = {"presets": tuple(PRESETS)}
"""Scenarios of each suite whose episodes are drawn from the seed, by name; the others are frozen."""
DEFAULT_SUITE = "benchmark-v2"  # what is evaluated if no scenario is named
DEFAULT_EPISODES = 20  # of each scenario that is not frozen
_MOST_EPISODES = 100_000  # of each scenario: they are drawn before anything runs


@dataclass(frozen=True)
class Request:
    """An evaluation that can run."""

    options: Options
    command: str  # as the user gave it
    suite: str | None  # None: scenarios of the user's own choice
    hash: str  # the same hash, the same task
    cells: tuple[Cell, ...]
    policies: tuple[str, ...]  # the expert first
    pairs: tuple[tuple[str, Cell], ...]  # what is to run, cell by cell
    workers: Workers
    anchors: Anchors  # of the scores
    earlier: tuple[Run, ...] = ()  # recorded runs to compare with
    notes: tuple[str, ...] = ()  # what to know about the results

    @classmethod
    def of(cls, options: Options, command: str = "") -> Request:
        """Return the request of a command line's options; its folder exists and is writable then.

        Raises:
            UsageError: an option is wrong; the message says what is allowed.
        """
        _check(options)
        workers = checked(partial(Workers.of, options.jobs))
        names = checked_policies((EXPERT, *options.policy))
        suite = options.suite if options.scenario else options.suite or DEFAULT_SUITE
        _check_submission(options, suite)
        task = _frozen(suite, options) if suite in list_suites() else _drawn(suite, options)
        earlier = tuple(run for run in task.recorded if run.policy not in names)
        refused = {policy: reason for policy, reason in task.refused.items() if policy not in names}
        anchors = task.anchors or Anchors.among(names)
        if task.anchors is not None:
            names = tuple(dict.fromkeys((*names, *(p for p in anchors if all(run.policy != p for run in earlier)))))
        notes = [note for note in (recorded.missing(suite or ""), task.note) if note]
        if options.resume:
            notes += [f"--resume watches {own}" for own in map(watched, names) if own]
        notes += [f"the recorded rows of {policy} are left out: {reason}" for policy, reason in refused.items()]
        skipped = [_foreign(name, task, notes) for name in names]
        kept = zip(names, skipped, strict=True)
        without = {(name, cell.scenario.name) for name, cells in kept for cell in cells}
        pairs = [(name, cell) for cell in task.cells for name in names if (name, cell.scenario.name) not in without]
        checked_folder(options.out)
        return cls(
            options, command, suite, task.hash, task.cells, names, tuple(pairs), workers, anchors, earlier, tuple(notes)
        )


class _Task(NamedTuple):
    """Cells, the hash of them, and what is recorded of them."""

    cells: tuple[Cell, ...]
    hash: str
    anchors: Anchors | None = None  # of the scores in a frozen suite; None where none is
    recorded: tuple[Run, ...] = ()
    refused: Mapping[str, str] = MappingProxyType({})
    note: str = ""  # to know about what is recorded


def _check(options: Options) -> None:
    """Raise UsageError if a number makes no sense, or two options exclude each other."""
    if options.suite is not None and options.scenario:
        raise UsageError("--suite and --scenario exclude each other; give one of them")
    for name, least, most in (("episodes", 1, _MOST_EPISODES), ("seed", 0, 2**62), ("jobs", 1, 4096)):
        value = getattr(options, name)
        if value is not None and not least <= value <= most:
            limits = f"{least} or more" if value < least else f"at most {most}"
            raise UsageError(f"--{name} is {value if value < 10**30 else 'too large'}; it must be {limits}")
    if not options.step_limit > 0:
        raise UsageError(f"--step-limit is {options.step_limit}; it must be a positive number of seconds")


def _check_submission(options: Options, suite: str | None) -> None:
    """Look whether a submission can come of an evaluation, before anything runs.

    Raises:
        UsageError: it cannot; the message says what to change.
    """
    if options.submit is None:
        if options.about != NOTHING:
            raise UsageError("--author, --link, --description and --training-... are for --submit NAME; add it")
        return
    if suite not in list_suites():
        allowed = ", ".join(list_suites())
        raise UsageError(f"--submit needs a frozen suite, one of {allowed}: --suite benchmark-v2")
    if len(set(options.policy)) != 1:
        raise UsageError(f"--submit needs one policy, --policy P; there are {len(set(options.policy))}")
    if options.episodes is not None:
        raise UsageError("--submit needs all episodes of the suite; leave out --episodes")
    try:
        checked_name(options.submit)
        checked_about(asdict(options.about))
    except ValueError as error:
        raise UsageError(f"--submit: {error}") from error


def _foreign(policy: str, task: _Task, notes: list[str]) -> list[Cell]:
    """Return the cells of a frozen suite that an agent does not run in, those of a regime that it was not trained for.

    A note says so; in scenarios of the user's own choice it says that the agent runs in them all the same.
    """
    speed_ranges = speed_ranges_of(policy)
    others = [cell for cell in task.cells if speed_range_of(cell.scenario.name) not in (*speed_ranges, None)]
    if others and task.anchors is not None:
        notes.append(f"{policy} was trained in {' and '.join(speed_ranges)} motion and runs in those cells alone")
        return others
    if others:
        names = ", ".join(cell.scenario.name for cell in others)
        notes.append(f"{policy} was trained in {' and '.join(speed_ranges)} motion, and not for {names}")
    return []


def _frozen(name: str, options: Options) -> _Task:
    """Return a frozen suite, or the first episodes of each of its cells."""
    count = options.episodes
    if options.seed:
        raise UsageError(
            f"--seed is {options.seed}; the episodes of suite {name} are frozen, so it must be 0 or left out"
        )
    suite = checked(partial(load_suite, name))
    found = recorded.load_recorded(suite)
    if count is None or all(count >= len(cell.episodes) for cell in suite.cells):
        return _Task(suite.cells, suite.hash, suite.anchors, found.runs, found.refused, found.note)
    cells = tuple(Cell(cell.scenario, cell.episodes[:count]) for cell in suite.cells)
    first = tuple(replace(run, measures=run.measures and run.measures[:count]) for run in found.runs)
    digest = hashlib.sha256(f"{suite.hash} {count}".encode()).hexdigest()
    return _Task(cells, digest, suite.anchors, first, found.refused, found.note)


def _drawn(suite: str | None, options: Options) -> _Task:
    """Return scenarios whose episodes are drawn from the seed."""
    if suite is not None and suite not in DRAWN:
        raise UsageError(f"unknown suite {suite!r}; allowed are {', '.join((*DRAWN, *list_suites()))}")
    scenarios = _distinct(checked_scenario(name) for name in options.scenario or DRAWN[suite or ""])
    count = DEFAULT_EPISODES if options.episodes is None else options.episodes
    record = {"scenarios": [s.to_dict() for s in scenarios], "episodes": count, "seed": options.seed}
    text = json.dumps(record, sort_keys=True, separators=(",", ":"), allow_nan=False)
    cells = tuple(checked(partial(drawn, scenario, count, options.seed)) for scenario in scenarios)
    return _Task(cells, hashlib.sha256(text.encode()).hexdigest())


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
        name: of the preset, perhaps with `@` and a vehicle, or path of the file.
        others: names that the caller takes, for the message.

    Raises:
        UsageError: there is none, or it cannot be used.
    """
    if name.partition("@")[0] in PRESETS:
        return checked(partial(as_scenario, name))
    if not name.endswith((".toml", ".json")):
        known = ", ".join((*others, *PRESETS))
        raise UsageError(f"unknown scenario {name!r}; allowed are a .toml or .json file, or one of {known}")
    scenario = checked(partial(Scenario.load, name))
    if scenario.name != printable(scenario.name):
        raise UsageError(f"{name}: the scenario's name {scenario.name!r} cannot be printed; choose another one")
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
        checked(partial(make_policy, name, PAPER_VEHICLE))  # a factory may insist on a vehicle
        checked(partial(fingerprint, name))
    return tuple(dict.fromkeys(names))


def checked_folder(folder: Path, option: str = "out") -> Path:
    """Return a folder, made if need be, once it is known that it can be written to.

    Args:
        folder: the folder.
        option: that named it, for the message.

    Raises:
        UsageError: it cannot.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise UsageError(f"--{option} {folder} is not a folder that can be written to: {error.strerror}") from error
    return folder
