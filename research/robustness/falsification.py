"""Look for the mildest sea that loses a policy, and write it as a scenario: `python -m research falsification --help`.

A sea is a point (`research.robustness.seas`), its severity the factor by which the storm's ranges are stretched
until they hold it. An evolution strategy moves a direction; along it seas of growing severity run side by side, until
the policy loses most of the episodes of one. What is minimised is the severity at which it does. All policies get the
same budget. That no milder sea was found is no proof that there is none.
"""

from __future__ import annotations

import math
import sys
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import Positional, arg

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.presets import SPEED_RANGES
from auv_gym.scenarios.scenario import Scenario
from baselines.control.backstepping import StabilityWarning
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.request import checked_folder, checked_policies
from baselines.evaluation.rollout import PolicyError
from baselines.evaluation.runner import Cell, drawn
from baselines.evaluation.score import ERROR_CAPS, capped, count_failures
from baselines.evaluation.side_by_side import SideBySide
from baselines.policies import make_policy
from baselines.tools.command_line import DONE, FAILED, UsageError, called, check_words, parse
from baselines.tools.files import json_text, read_json, write_atomically
from baselines.tuning.search import strategies
from research import DATA, DOCS
from research.robustness.seas import SEA_KINDS, names, sea
from research.seeds import FALSIFICATION

PROGRAM = "python -m research falsification"
SEAS_FOLDER = DOCS / "seas"  # of the scenarios that were found
_FILE = DATA / "seas.json"  # what was found
_POPULATION = 12  # directions of a generation
_EPISODES = 3  # of a sea while it is looked for; the one in the middle counts
_FIRST = tuple(np.geomspace(0.5, 6.0, 7).tolist())
"""Severities along a direction before a sea is found."""
AROUND = (0.75, 0.85, 0.93, 1.0, 1.1, 1.25, 1.5)
"""Severities along a direction afterwards, in units of the least one so far."""
CONFIRMED = 64  # fresh episodes of the sea in the end, of which it loses half or more
_STEPS = 1.03  # by which the severity grows, from one attempt to confirm it to the next
_SEED = 1  # of the evolution strategy


@dataclass(frozen=True)
class Options:
    """Look for the mildest sea that loses each policy; write it as a scenario, and what was found to seas.json.

    Exit status: 0 done, found or not, 1 a policy failed, 2 wrong usage.
    """

    policy: Annotated[Positional[tuple[str, ...]], arg(metavar="POLICY [POLICY ...]")]
    """Policies by name, folder or file."""
    speed_range: Annotated[tuple[str, ...], arg(metavar="R [R ...]", help_behavior_hint="")] = SPEED_RANGES
    """Slow, cruise, or both."""
    sea: Annotated[tuple[str, ...], arg(metavar="K [K ...]", help_behavior_hint="")] = SEA_KINDS
    """What is stretched: storm, the ranges of the presets' storm on slewing thrusters; adverse, those of the storm of
    training in which sensors, commands and actuators are not as told either."""
    generations: int = 24
    """Generations of the search; a generation is 252 episodes."""
    out: Path = SEAS_FOLDER
    """Folder for the scenarios. Another folder than that of the page gets a seas.json of its own, too."""


@dataclass(frozen=True)
class Search:
    """Whom to lose, and in which seas."""

    policy: str
    speed_range: str
    kind: str

    @property
    def name(self) -> str:
        """Name of the scenario that is found."""
        plain = "".join(c if c.isalnum() else "-" for c in self.policy)
        return f"{self.speed_range}-{self.kind}-that-loses-{plain}"

    def scenario(self, severity: float, towards: Array) -> Scenario:
        """Return the sea at a severity in a direction; see `seas.sea`."""
        return sea(self.speed_range, self.kind, self.name, severity, towards)


@dataclass(frozen=True)
class _Found:
    """The mildest sea that was found."""

    fingerprint: str  # of the policy
    severity: float  # inf: none
    coordinates: dict[str, float]  # by name: severity times direction, but for the current's own direction
    failed: int  # of `CONFIRMED` fresh episodes
    episodes: int  # that the search has run


def closeness(search: Search, cells: Sequence[Cell]) -> tuple[Array, Array]:
    """Return how near to lost a policy is in the seas of some cells, and in how many of its episodes it is lost.

    The first is the logarithm of the middle tail error over the one from which an episode is lost: 0 and more where
    most are; shape (cells,) each.
    """
    cap = ERROR_CAPS[search.speed_range]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)
        warnings.filterwarnings("ignore", "this agent was trained at reference speeds")
        ended = SideBySide(cells).run(make_policy(search.policy, cells[0].scenario.vehicle))
    steady_rmses = [capped(e, cap) for e in ended]
    failed = [count_failures(e, cap) for e in ended]
    return np.log(np.array([np.quantile(t, 0.5, method="lower") for t in steady_rmses]) / cap), np.array(failed)


def crossing(severities: Sequence[float], near: Sequence[float]) -> float:
    """Return the severity at which closeness first reaches 0, between the two that enclose it.

    Where it does at the first one already, that one; where it never does, beyond the last one, the farther the less
    close it comes. Seas that cannot be sailed, nan, do not count.
    """
    known = [(s, n) for s, n in zip(severities, near, strict=True) if math.isfinite(n)]
    if not known:
        return 2.0 * severities[-1]
    for (s, n), (t, m) in zip([(known[0][0], -1.0), *known], known, strict=False):
        if m >= 0.0:
            return t if m == n else s + (t - s) * min(1.0, n / (n - m) if n < m else 1.0)
    return known[-1][0] * (1.0 - known[-1][1])


def sailed(search: Search, towards: Sequence[Array], severities: Sequence[float], seed: int) -> Array:
    """Return the closeness in the seas along some directions, shape (directions, severities); nan: no such sea."""
    cells: dict[tuple[int, int], Cell] = {}
    for i, direction in enumerate(towards):
        for j, severity in enumerate(severities):
            with suppress(ValueError):  # its path cannot be followed, or its vehicle not be integrated
                cells[i, j] = drawn(search.scenario(severity, direction), _EPISODES, seed)
    near = np.full((len(towards), len(severities)), math.nan)
    if cells:
        for place, value in zip(cells, closeness(search, list(cells.values()))[0], strict=True):
            near[place] = value
    return near


def found_by(search: Search, generations: int) -> _Found:
    """Return the mildest sea that a search finds.

    Raises:
        PolicyError: the policy's actions are not finite.
    """
    size = len(names(search.speed_range, search.kind))
    options: dict[str, Any] = {"popsize": _POPULATION, "seed": _SEED, "verbose": -9, "bounds": [-1.0, 1.0]}
    strategy = strategies().CMAEvolutionStrategy(np.full(size, 0.3), 0.5, options | {"CMA_diagonal": True})
    best, ran, direction = math.inf, 0, np.zeros(size)
    for generation in range(generations):
        severities = _FIRST if math.isinf(best) else tuple(best * share for share in AROUND)
        towards = [np.asarray(t) / np.max(np.abs(t[:-1])) for t in strategy.ask()]
        towards = [np.append(t[:-1], np.clip(t[-1], -1.0, 1.0)) for t in towards]
        near = sailed(search, towards, severities, FALSIFICATION.first + generation * _EPISODES)
        ran += _EPISODES * int(np.isfinite(near).sum())
        values = [crossing(severities, row) for row in near.tolist()]
        strategy.tell(towards, values)
        least = int(np.argmin(values))
        if values[least] < best and np.nanmax(near[least]) >= 0.0:
            best, direction = values[least], towards[least]
        print(f"{search.name}: generation {generation + 1}, severity {best:.3f}", flush=True)
    return _confirmed(search, best, direction, ran)


def _confirmed(search: Search, severity: float, towards: Array, ran: int) -> _Found:
    """Return a sea along a direction that loses half of fresh episodes or more, the mildest from a severity on."""
    seed, digest = FALSIFICATION.end - CONFIRMED, fingerprint(search.policy)
    while math.isfinite(severity) and severity < 2.0 * _FIRST[-1]:
        ran += CONFIRMED
        cell = drawn(search.scenario(severity, towards), CONFIRMED, seed)
        failed = int(closeness(search, [cell])[1][0])
        if 2 * failed >= CONFIRMED:
            *place, direction = names(search.speed_range, search.kind)
            where = {name: severity * float(x) for name, x in zip(place, towards, strict=False)}
            return _Found(digest, severity, {**where, direction: float(towards[-1])}, failed, ran)
        severity *= _STEPS
    return _Found(digest, math.inf, {}, 0, ran)


def found_seas(file: Path = _FILE) -> dict[str, dict[str, Any]]:
    """Return what was found, a `_Found` as a dict by the name of the search.

    Raises:
        ValueError: the file is damaged.
    """
    record = read_json(file) if file.exists() else {}
    if not isinstance(record, dict):
        raise ValueError(f"{file} does not hold what {PROGRAM} writes; delete it, or name another folder with --out")
    return record


def _record(folder: Path) -> Path:
    """Return the file about the seas whose scenarios are in a folder."""
    return _FILE if folder.resolve() == SEAS_FOLDER.resolve() else folder / _FILE.name


def main(arguments: Sequence[str]) -> int:
    """Search as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    check_words("speed range", options.speed_range, SPEED_RANGES)
    check_words("sea", options.sea, SEA_KINDS)
    if not 1 <= options.generations <= 10_000:
        raise UsageError(f"--generations is {options.generations}; it must be in [1, 10000]")
    policies = checked_policies(options.policy)
    folder = checked_folder(options.out)
    try:
        strategies()
        found_seas(_record(folder))
    except (ImportError, ValueError) as error:
        raise UsageError(str(error)) from error
    searches = [
        Search(p, speed_range, kind) for kind in options.sea for speed_range in options.speed_range for p in policies
    ]
    for search in searches:
        try:
            found = found_by(search, options.generations)
        except PolicyError as error:
            print(f"{called(PROGRAM)}: {search.policy} failed: {error}", file=sys.stderr)
            return FAILED
        _write(search, found, folder)
    return DONE


def _write(search: Search, found: _Found, folder: Path) -> None:
    """Add what was found to a folder, and say it."""
    about = {"policy": search.policy, "speed_range": search.speed_range, "sea": search.kind}
    file = _record(folder)
    write_atomically(file, json_text({**found_seas(file), search.name: {**about, **asdict(found)}}))
    if math.isinf(found.severity):
        print(f"{search.name}: none found in {found.episodes} episodes")
        return
    (*_, direction) = found.coordinates
    towards = [x / (1.0 if name == direction else found.severity) for name, x in found.coordinates.items()]
    search.scenario(found.severity, np.array(towards)).save(folder / f"{search.name}.toml")
    print(f"{search.name}: severity {found.severity:.3f}, {found.failed} of {CONFIRMED} episodes lost", flush=True)
