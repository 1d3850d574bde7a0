"""The request of an evaluation: checks the options and resolves their names before any episode runs."""

from __future__ import annotations

import hashlib
import itertools
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.planning.feasibility import InfeasibleReferenceError
from auv_gym.scenarios.missions import mission_scenario, read_mission
from auv_gym.scenarios.mixtures import MIXTURES
from auv_gym.scenarios.presets import PRESETS, SETPOINTS, as_scenario, is_preset, list_scenarios, preset_names
from auv_gym.scenarios.records import meant, table_file
from auv_gym.scenarios.scenario import Scenario
from baselines.agents.loading import caution, load_effects
from baselines.agents.names import agent_folder
from baselines.control import POLICIES
from baselines.evaluation.cells import Cell, drawn
from baselines.evaluation.options import Options
from baselines.evaluation.plants import PlantCommand, checked_plant
from baselines.evaluation.recorded import RecordedRuns, recorded_runs, speed_ranges_of
from baselines.evaluation.rollout import make_env
from baselines.evaluation.runner import Run
from baselines.evaluation.score import OPTIMUM_POLICY, expert_of, speed_range_of
from baselines.evaluation.suites import list_suites, load_suite
from baselines.policies import check_actions, list_policies, make_policy
from baselines.tools.command_line import UsageError, checked, checked_folder, printable
from baselines.tools.workers import Workers

DRAWN_SUITES: dict[str, tuple[str, ...]] = {"presets": tuple(PRESETS)}
"""The scenarios of each suite whose episodes are drawn from the seed; all other suites are frozen."""
DEFAULT_SUITE = "benchmark-v3"  # the suite if no scenario is given
DEFAULT_EPISODES = 20  # default number of episodes of each scenario that is not frozen
_MOST_EPISODES = 100_000  # largest number of episodes of each scenario, which are all drawn ahead


@dataclass(frozen=True)
class Request:
    """A checked evaluation."""

    options: Options
    command: str  # the command as typed by the user
    suite: str | None  # None: scenarios chosen by the user
    frozen: bool  # whether the suite is frozen
    hash: str  # hash of all episodes
    cells: tuple[Cell, ...]
    policies: tuple[str, ...]  # the expert first
    pairs: tuple[tuple[str, Cell], ...]  # policies and cells to run, cell by cell
    workers: Workers
    earlier: tuple[Run, ...] = ()  # recorded runs to compare with
    notes: tuple[str, ...] = ()  # remarks on the results
    trainings: tuple[tuple[str, ...], ...] = ()  # the policies from several seeds of one training, for each training
    plant: PlantCommand | None = None  # the program that moves the vehicles

    @classmethod
    def of(cls, options: Options, command: str = "") -> Request:
        """Return the request for the options of a command line, and create its folder.

        Raises:
            UsageError: an option is wrong; the message says what is allowed.
        """
        _check(options)
        import_effects(options.effects)
        named = [seeds_of(name) or (name,) for name in options.policy]
        trainings = tuple(seeds for seeds in named if len(seeds) > 1)
        suite = options.suite if options.scenario or options.mission else options.suite or DEFAULT_SUITE
        frozen = suite in list_suites()
        cells, digest, recorded = _frozen(suite or "", options) if frozen else _drawn(suite, options)
        scenarios = [cell.scenario for cell in cells]
        names = checked_policies((expert_of(scenarios), *itertools.chain.from_iterable(named)), scenarios)
        plant = None
        if options.plant is not None:
            plant, recorded = checked(partial(checked_plant, options.plant, scenarios)), RecordedRuns((), ())
            if privileged := [name for name in names if name in POLICIES and POLICIES[name].privileged]:
                raise UsageError(f"{privileged[0]} needs the equations of motion, which --plant replaces; leave it out")
        earlier = tuple(run for run in recorded.runs if run.policy not in names)
        if frozen and plant is None and all(run.policy != OPTIMUM_POLICY for run in earlier):
            names = tuple(dict.fromkeys((*names, OPTIMUM_POLICY)))
        notes, untrained = [*recorded.notes], {}
        if plant is not None:
            notes.append(f"the vehicles are moved by {options.plant}, with its own actuators")
        for name in names:
            ranges = speed_ranges_of(name)
            others = [cell.scenario.name for cell in cells if speed_range_of(cell.scenario.name) not in (*ranges, None)]
            untrained[name] = others if frozen else []
            if others:
                rest = " and runs in those only" if frozen else f", not for {', '.join(others)}"
                notes.append(f"{name} was trained for {' and '.join(ranges)} scenarios{rest}")
        notes += [
            f"{cell.beyond.sum()} of {len(cell.episodes)} episodes of {cell.scenario.name} need more than the limits "
            "in their current, or have no plan there"
            for cell in (() if frozen else cells)
            if cell.beyond.any()
        ]
        pairs = ((name, cell) for cell in cells for name in names if cell.scenario.name not in untrained[name])
        checked_folder(options.out)
        workers = Workers.of(options.jobs, options.cluster)
        return cls(
            options,
            command,
            suite,
            frozen,
            digest,
            cells,
            names,
            tuple(pairs),
            workers,
            earlier,
            tuple(notes),
            trainings,
            plant,
        )

    def ordered(self, runs: Sequence[Run]) -> list[Run]:
        """Return runs cell by cell, and in each cell in the order of the policies."""
        cells = [cell.scenario.name for cell in self.cells]
        names = list(dict.fromkeys((*self.policies, *(run.policy for run in self.earlier))))
        return sorted(runs, key=lambda run: (cells.index(run.scenario.name), names.index(run.policy)))


def _check(options: Options) -> None:
    """Raise UsageError if a number is out of range, or if two options exclude each other."""
    given = [name for name in ("suite", "scenario", "mission") if getattr(options, name)]
    if len(given) > 1:
        raise UsageError(f"--{given[0]} and --{given[1]} exclude each other; give one of them")
    names, usual = ("vehicle", "speed", "radius", "current"), Options()
    of_mission = [name for name in names if getattr(options, name) != getattr(usual, name)]
    if of_mission and options.mission is None:
        hint = "; a preset takes a vehicle as in cruise-storm@remus100" if options.vehicle else ""
        raise UsageError(f"--{of_mission[0]} is for a mission; a scenario file has its own{hint}")
    for name, least, most in (("episodes", 1, _MOST_EPISODES), ("seed", 0, 2**62), ("jobs", 1, 4096)):
        value = getattr(options, name)
        if value is not None and not least <= value <= most:
            limits = f"{least} or more" if value < least else f"at most {most}"
            raise UsageError(f"--{name} is {value if value < 10**30 else 'too large'}; it must be {limits}")
    if not options.step_limit > 0:
        raise UsageError(f"--step-limit is {options.step_limit}; it must be a positive number of seconds")


def _frozen(name: str, options: Options) -> tuple[tuple[Cell, ...], str, RecordedRuns]:
    """Return the cells of a frozen suite with the chosen number of episodes, their hash and the recorded runs."""
    count = options.episodes
    if options.seed:
        raise UsageError(
            f"--seed is {options.seed}; the episodes of suite {name} are frozen, so it must be 0 or left out"
        )
    suite = checked(partial(load_suite, name))
    recorded = checked(partial(recorded_runs, suite))
    if count is None or all(count >= len(cell.episodes) for cell in suite.cells):
        return suite.cells, suite.hash, recorded
    cells = tuple(Cell(cell.scenario, cell.episodes[:count]) for cell in suite.cells)
    first = tuple(replace(run, measures=run.measures and run.measures[:count]) for run in recorded.runs)
    return cells, hashlib.sha256(f"{suite.hash} {count}".encode()).hexdigest(), recorded._replace(runs=first)


def _drawn(suite: str | None, options: Options) -> tuple[tuple[Cell, ...], str, RecordedRuns]:
    """Return scenarios with episodes that are drawn from the seed, their hash, and no recorded runs."""
    if suite is not None and suite not in DRAWN_SUITES:
        known = *DRAWN_SUITES, *list_suites()
        more = "" if "research" in sys.modules else "; in a clone python evaluate.py has more, see docs/suites.md"
        raise UsageError(f"unknown suite {suite!r}{meant(suite, known)}; allowed are {', '.join(known)}{more}")
    scenarios: dict[str, Scenario] = {}
    if options.mission is not None:
        cell = checked(partial(_mission, options))
        return (cell,), cell.hash, RecordedRuns((), ())
    for scenario in map(checked_scenario, options.scenario or DRAWN_SUITES[suite or ""]):
        if scenarios.setdefault(scenario.name, scenario) != scenario:
            raise UsageError(
                f"two different scenarios are called {scenario.name!r}; rename one of them, in its file or "
                "in that of its vehicle"
            )
    count = DEFAULT_EPISODES if options.episodes is None else options.episodes
    cells = tuple(checked(partial(_cell, scenario, count, options.seed)) for scenario in scenarios.values())
    digest = hashlib.sha256(" ".join(cell.hash for cell in cells).encode()).hexdigest()
    return cells, digest, RecordedRuns((), ())


def _cell(scenario: Scenario, count: int, seed: int) -> Cell:
    """Return drawn episodes of a scenario; raise ValueError with its name if none can be planned."""
    try:
        return drawn(scenario, count, seed)
    except InfeasibleReferenceError as error:
        raise ValueError(f"scenario {scenario.name}: {error}; a smaller speed or turn rate may help") from error


def _mission(options: Options) -> Cell:
    """Return the episodes of a mission; raise ValueError, with what to change, if the vehicle cannot follow it."""
    assert options.mission is not None
    mission = read_mission(options.mission)
    scenario = mission_scenario(mission, options.vehicle, options.speed, options.radius, options.current)
    if (hours := scenario.steps * scenario.control_dt / 3600) >= 1:
        print(f"note: the mission takes {hours:.1f} h, {scenario.steps} control steps of each policy", file=sys.stderr)
    try:
        return drawn(scenario, options.episodes or 1, options.seed)
    except InfeasibleReferenceError as error:
        advice = "a smaller speed or a larger --radius may help"
        if mission.depths:
            lengths, rises = np.hypot(*np.diff(mission.points, axis=0).T), np.abs(np.diff(mission.depths))
            k = int(np.argmax(rises / lengths))
            steepest = f"leg {k}, the steepest, has {rises[k]:.4g} m of depth on {lengths[k]:.4g} m"
            advice = f"{steepest}; a flatter leg, {advice}"
        raise ValueError(f"{error}; {advice}") from error


def import_effects(files: Iterable[Path]) -> None:
    """Import the files of the option --effects; raise UsageError if one cannot be imported."""
    for file in files:
        checked(partial(load_effects, file))


def checked_scenario(name: str, others: Iterable[str] = ()) -> Scenario:
    """Return the scenario of a preset's name or a file, once it is known that its environment can be made.

    Args:
        name: of the preset, perhaps with `@` and a vehicle, or path of the file.
        others: names that the caller takes, for the message.

    Raises:
        UsageError: there is none, or it cannot be used.
    """
    if is_preset(name):
        return checked(partial(as_scenario, name))
    if table_file(name.partition("@")[0]) is None:
        known = *others, *list_scenarios()
        is_mixture = name.removesuffix(SETPOINTS) in MIXTURES
        hint = " (a mixture for auv-gym train)" if is_mixture else meant(name, (*others, *preset_names()))
        raise UsageError(
            f"unknown scenario {name!r}{hint}; allowed are a .toml or .json file, or one of {', '.join(known)}; "
            f"a preset may end in {SETPOINTS}, and @ and a vehicle may follow"
        )
    scenario = checked(partial(as_scenario, name))
    if scenario.name != printable(scenario.name):
        raise UsageError(f"{name}: the scenario's name {scenario.name!r} cannot be printed; choose another one")
    checked(partial(make_env, scenario))
    return scenario


def seeds_of(name: str) -> tuple[str, ...]:
    """Return the folders with the agents of all seeds of a training, () if it has only one or none."""
    folder = Path(name)
    agents = folder.glob("seed-*/agent/agent.json") if agent_folder(name) is None and folder.is_dir() else ()
    return tuple(sorted((str(one.parents[1]) for one in agents), key=lambda one: (len(one), one)))


def checked_policies(names: Sequence[str], scenarios: Sequence[Scenario] = ()) -> tuple[str, ...]:
    """Return the names of policies without repetitions, and check that each policy can be made.

    Args:
        names: the names.
        scenarios: where the policies run; those in space need policies in space.

    Raises:
        UsageError: a policy cannot be made.
    """
    space = dict.fromkeys(scenario.known for scenario in scenarios if scenario.vertical)
    in_plane = not scenarios or any(scenario.vertical is None for scenario in scenarios)
    vehicles: list[Any] = [*space, *([PAPER_VEHICLE] if in_plane else [])]
    for name in names:
        if (note := caution(name)) is not None:
            print(f"note: {note}", file=sys.stderr)
        checked(partial(check_actions, name, scenarios))
        for vehicle in vehicles:  # a factory may require one
            if vehicle is not PAPER_VEHICLE or name not in list_policies():
                checked(partial(make_policy, name, vehicle))
    return tuple(dict.fromkeys(names))
