"""The request of an evaluation: checks the options and resolves their names before any episode runs."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.presets import PRESETS, as_scenario
from auv_gym.scenarios.scenario import Scenario
from baselines.agents.loading import caution
from baselines.evaluation import recorded
from baselines.evaluation.about import NOTHING, checked_about, checked_name
from baselines.evaluation.fingerprints import covered_files, fingerprint
from baselines.evaluation.options import Options
from baselines.evaluation.recorded import speed_ranges_of
from baselines.evaluation.rollout import make_env
from baselines.evaluation.runner import Cell, Run, drawn
from baselines.evaluation.score import EXPERT, Anchors, speed_range_of
from baselines.evaluation.suites import list_suites, load_suite
from baselines.policies import make_policy
from baselines.tools.command_line import UsageError, checked, checked_folder, printable
from baselines.tools.workers import Workers

DRAWN_SUITES: dict[str, tuple[str, ...]] = {"presets": tuple(PRESETS)}
"""The scenarios of each suite whose episodes are drawn from the seed; all other suites are frozen."""
DEFAULT_SUITE = "benchmark-v2"  # the suite if no scenario is given
DEFAULT_EPISODES = 20  # default number of episodes of each scenario that is not frozen
_MOST_EPISODES = 100_000  # largest number of episodes of each scenario, which are all drawn ahead


@dataclass(frozen=True)
class Request:
    """A checked evaluation."""

    options: Options
    command: str  # the command as typed by the user
    suite: str | None  # None: scenarios chosen by the user
    hash: str  # hash of all episodes
    cells: tuple[Cell, ...]
    policies: tuple[str, ...]  # the expert first
    pairs: tuple[tuple[str, Cell], ...]  # policies and cells to run, cell by cell
    workers: Workers
    anchors: Anchors  # of the scores
    earlier: tuple[Run, ...] = ()  # recorded runs to compare with
    notes: tuple[str, ...] = ()  # remarks on the results

    @classmethod
    def of(cls, options: Options, command: str = "") -> Request:
        """Return the request for the options of a command line, and create its folder.

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
            notes += [f"--resume checks {files}" for files in map(covered_files, names) if files]
        notes += [f"the recorded rows of {policy} are left out: {reason}" for policy, reason in refused.items()]
        skipped = [_skipped(name, task, notes) for name in names]
        kept = zip(names, skipped, strict=True)
        without = {(name, cell.scenario.name) for name, cells in kept for cell in cells}
        pairs = [(name, cell) for cell in task.cells for name in names if (name, cell.scenario.name) not in without]
        checked_folder(options.out)
        return cls(
            options, command, suite, task.hash, task.cells, names, tuple(pairs), workers, anchors, earlier, tuple(notes)
        )


class _Task(NamedTuple):
    """The cells of an evaluation, their hash and their recorded rows."""

    cells: tuple[Cell, ...]
    hash: str
    anchors: Anchors | None = None  # of the scores in a frozen suite; None without a suite
    recorded: tuple[Run, ...] = ()
    refused: Mapping[str, str] = MappingProxyType({})
    note: str = ""  # a remark on the recorded rows


def _check(options: Options) -> None:
    """Raise UsageError if a number is out of range, or if two options exclude each other."""
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
    """Check before any episode runs that an evaluation can give a submission.

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


def _skipped(policy: str, task: _Task, notes: list[str]) -> list[Cell]:
    """Return the cells of a frozen suite in which an agent does not run: those of other speed ranges than its training.

    A note is added. In scenarios that the user has chosen the agent runs, and the note says that it was not trained
    for them.
    """
    speed_ranges = speed_ranges_of(policy)
    others = [cell for cell in task.cells if speed_range_of(cell.scenario.name) not in (*speed_ranges, None)]
    if others and task.anchors is not None:
        notes.append(f"{policy} was trained for {' and '.join(speed_ranges)} scenarios and runs in those only")
        return others
    if others:
        names = ", ".join(cell.scenario.name for cell in others)
        notes.append(f"{policy} was trained for {' and '.join(speed_ranges)} scenarios, not for {names}")
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
    if suite is not None and suite not in DRAWN_SUITES:
        raise UsageError(f"unknown suite {suite!r}; allowed are {', '.join((*DRAWN_SUITES, *list_suites()))}")
    scenarios = _distinct(checked_scenario(name) for name in options.scenario or DRAWN_SUITES[suite or ""])
    count = DEFAULT_EPISODES if options.episodes is None else options.episodes
    record = {"scenarios": [s.to_dict() for s in scenarios], "episodes": count, "seed": options.seed}
    text = json.dumps(record, sort_keys=True, separators=(",", ":"), allow_nan=False)
    cells = tuple(checked(partial(drawn, scenario, count, options.seed)) for scenario in scenarios)
    return _Task(cells, hashlib.sha256(text.encode()).hexdigest())


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
    scenario = checked(partial(as_scenario, name))
    if scenario.name != printable(scenario.name):
        raise UsageError(f"{name}: the scenario's name {scenario.name!r} cannot be printed; choose another one")
    checked(partial(make_env, scenario))
    return scenario


def _distinct(scenarios: Iterable[Scenario]) -> tuple[Scenario, ...]:
    """Return the scenarios without repetitions.

    Raises:
        UsageError: two different scenarios have the same name.
    """
    by_name: dict[str, Scenario] = {}
    for scenario in scenarios:
        if by_name.setdefault(scenario.name, scenario) != scenario:
            raise UsageError(f"two different scenarios are called {scenario.name!r}; rename one of them")
    return tuple(by_name.values())


def checked_policies(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names of policies without repetitions, and check that each policy can be made.

    Raises:
        UsageError: a policy cannot be made.
    """
    for name in names:
        if (note := caution(name)) is not None:
            print(f"note: {note}", file=sys.stderr)
        checked(partial(make_policy, name, PAPER_VEHICLE))  # a factory may require a vehicle
        checked(partial(fingerprint, name))
    return tuple(dict.fromkeys(names))
