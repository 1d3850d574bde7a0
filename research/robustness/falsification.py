"""Find the smallest disturbances that make a policy fail: `python -m research falsification --help`.

Disturbances are points of a search space (`research.robustness.search_space`). The severity of a point is the factor by
which the ranges of the storm are stretched to contain it. CMA-ES varies a direction. Along each direction points of
growing severity are simulated together, and the objective is the severity at which the policy fails in most episodes.
The point is confirmed on other episodes and written as a scenario. All policies have the same budget. The search does
not prove that no smaller disturbance exists.
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
from baselines.evaluation.request import checked_policies
from baselines.evaluation.rollout import PolicyError
from baselines.evaluation.runner import Cell, drawn
from baselines.evaluation.score import ERROR_CAPS, capped, count_failures
from baselines.evaluation.side_by_side import SideBySide
from baselines.policies import make_policy
from baselines.tools.command_line import DONE, FAILED, UsageError, called, check_words, checked_folder, parse
from baselines.tools.files import json_text, read_json, write_atomically
from baselines.tuning.search import strategies
from research import DATA, DOCS
from research.robustness.search_space import coordinate_names, scenario_at
from research.seeds import FALSIFICATION

PROGRAM = "python -m research falsification"
SCENARIO_FOLDER = DOCS / "failing-scenarios"  # folder of the scenarios
_FILE = DATA / "falsification.json"  # record of the results
_POPULATION = 12  # directions of a generation
_EPISODES = 3  # episodes at a point during the search; the median counts
_FIRST = tuple(np.geomspace(0.5, 6.0, 7).tolist())
"""Severities along a direction until a point is found."""
AROUND = (0.75, 0.85, 0.93, 1.0, 1.1, 1.25, 1.5)
"""Severities along a direction afterwards, in units of the smallest one found so far."""
CONFIRMED = 64  # held-out episodes at the result; the policy must fail in half of them or more
_STEP = 1.03  # factor of the severity from one attempt of the confirmation to the next
_SEED = 1  # seed of CMA-ES


@dataclass(frozen=True)
class Options:
    """Find the smallest disturbances that make each policy fail; write the scenarios and a record of the results.

    Exit status: 0 done, with or without a result, 1 a policy's actions are not finite, 2 wrong usage.
    """

    policy: Annotated[Positional[tuple[str, ...]], arg(metavar="POLICY [POLICY ...]")]
    """Policies by name, folder or file."""
    speed_range: Annotated[tuple[str, ...], arg(metavar="R [R ...]", help_behavior_hint="")] = SPEED_RANGES
    """Speed ranges: slow, cruise."""
    generations: int = 24
    """Generations of the search; a generation is 252 episodes."""
    out: Path = SCENARIO_FOLDER
    """Folder for the scenarios. A folder other than the default also contains the record."""


@dataclass(frozen=True)
class Search:
    """A policy, and the search space in which it is made to fail."""

    policy: str
    speed_range: str

    @property
    def name(self) -> str:
        """Name of the resulting scenario."""
        plain = "".join(c if c.isalnum() else "-" for c in self.policy)
        return f"{self.speed_range}-storm-fails-{plain}"

    def scenario(self, severity: float, towards: Array) -> Scenario:
        """Return the scenario at a severity in a direction, see `search_space.scenario_at`."""
        return scenario_at(self.speed_range, self.name, severity, towards)


@dataclass(frozen=True)
class _Found:
    """Result of a search."""

    fingerprint: str  # of the policy
    severity: float  # inf: no point was found
    coordinates: dict[str, float]  # severity times direction, by name; the direction of the current is not multiplied
    failed: int  # number of failures in `CONFIRMED` held-out episodes
    episodes: int  # number of episodes of the search


def failure_margins(search: Search, cells: Sequence[Cell]) -> tuple[Array, Array]:
    """Return the margin of failure of a policy and its number of failures in each cell, shape (cells,) each.

    The margin is the logarithm of the median steady-state error divided by the error cap. It is 0 or more if most
    episodes fail.
    """
    cap = ERROR_CAPS[search.speed_range]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)
        warnings.filterwarnings("ignore", "this agent was trained at reference speeds")
        ended = SideBySide(cells).run(make_policy(search.policy, cells[0].scenario.known))
    steady_rmses = [capped(e, cap) for e in ended]
    failed = [count_failures(e, cap) for e in ended]
    return np.log(np.array([np.quantile(t, 0.5, method="lower") for t in steady_rmses]) / cap), np.array(failed)


def crossing(severities: Sequence[float], margins: Sequence[float]) -> float:
    """Return the interpolated severity at which the margin of failure first reaches 0.

    If the first margin is 0 or more, the result is at most the first severity. If all margins are negative, it is
    beyond the last severity, and the farther the smaller the last margin is. NaN margins are ignored.
    """
    known = [(s, n) for s, n in zip(severities, margins, strict=True) if math.isfinite(n)]
    if not known:
        return 2.0 * severities[-1]
    for (s, n), (t, m) in zip([(known[0][0], -1.0), *known], known, strict=False):
        if m >= 0.0:
            return t if m == n else s + (t - s) * min(1.0, n / (n - m) if n < m else 1.0)
    return known[-1][0] * (1.0 - known[-1][1])


def margins_along(search: Search, towards: Sequence[Array], severities: Sequence[float], seed: int) -> Array:
    """Return the margins of failure along directions, shape (directions, severities); NaN without a scenario."""
    cells: dict[tuple[int, int], Cell] = {}
    for i, direction in enumerate(towards):
        for j, severity in enumerate(severities):
            with suppress(ValueError):  # the path is infeasible, or the vehicle too stiff for the integration
                cells[i, j] = drawn(search.scenario(severity, direction), _EPISODES, seed)
    margins = np.full((len(towards), len(severities)), math.nan)
    if cells:
        for place, value in zip(cells, failure_margins(search, list(cells.values()))[0], strict=True):
            margins[place] = value
    return margins


def smallest_point(search: Search, generations: int) -> _Found:
    """Return the point of smallest severity that a search finds.

    Raises:
        PolicyError: the actions of the policy are not finite.
    """
    size = len(coordinate_names(search.speed_range))
    options: dict[str, Any] = {"popsize": _POPULATION, "seed": _SEED, "verbose": -9, "bounds": [-1.0, 1.0]}
    strategy = strategies().CMAEvolutionStrategy(np.full(size, 0.3), 0.5, options | {"CMA_diagonal": True})
    best, episodes, direction = math.inf, 0, np.zeros(size)
    for generation in range(generations):
        severities = _FIRST if math.isinf(best) else tuple(best * share for share in AROUND)
        towards = [np.asarray(t) / np.max(np.abs(t[:-1])) for t in strategy.ask()]
        towards = [np.append(t[:-1], np.clip(t[-1], -1.0, 1.0)) for t in towards]
        margins = margins_along(search, towards, severities, FALSIFICATION.first + generation * _EPISODES)
        episodes += _EPISODES * int(np.isfinite(margins).sum())
        values = [crossing(severities, row) for row in margins.tolist()]
        strategy.tell(towards, values)
        least = int(np.argmin(values))
        if values[least] < best and np.nanmax(margins[least]) >= 0.0:
            best, direction = values[least], towards[least]
        print(f"{search.name}: generation {generation + 1}, severity {best:.3f}", flush=True)
    return _confirm(search, best, direction, episodes)


def _confirm(search: Search, severity: float, towards: Array, episodes: int) -> _Found:
    """Return the point of smallest severity along a direction at which half of held-out episodes or more fail.

    Args:
        search: the search.
        severity: smallest severity to try.
        towards: the direction.
        episodes: number of episodes of the search so far.
    """
    seed, digest = FALSIFICATION.end - CONFIRMED, fingerprint(search.policy)
    while math.isfinite(severity) and severity < 2.0 * _FIRST[-1]:
        episodes += CONFIRMED
        cell = drawn(search.scenario(severity, towards), CONFIRMED, seed)
        failed = int(failure_margins(search, [cell])[1][0])
        if 2 * failed >= CONFIRMED:
            *place, direction = coordinate_names(search.speed_range)
            where = {name: severity * float(x) for name, x in zip(place, towards, strict=False)}
            return _Found(digest, severity, {**where, direction: float(towards[-1])}, failed, episodes)
        severity *= _STEP
    return _Found(digest, math.inf, {}, 0, episodes)


def found_points(file: Path = _FILE) -> dict[str, dict[str, Any]]:
    """Return the recorded results, a `_Found` as a dict for each name of a search.

    Raises:
        ValueError: the file is damaged.
    """
    record = read_json(file) if file.exists() else {}
    if not isinstance(record, dict):
        raise ValueError(f"{file} is no record of {PROGRAM}; delete it, or name another folder with --out")
    return record


def _record_of(folder: Path) -> Path:
    """Return the record of the scenarios in a folder."""
    return _FILE if folder.resolve() == SCENARIO_FOLDER.resolve() else folder / _FILE.name


def main(arguments: Sequence[str]) -> int:
    """Run the searches, record their results, and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options = parse(Options, arguments, PROGRAM)
    check_words("speed range", options.speed_range, SPEED_RANGES)
    if not 1 <= options.generations <= 10_000:
        raise UsageError(f"--generations is {options.generations}; it must be in [1, 10000]")
    policies = checked_policies(options.policy)
    folder = checked_folder(options.out)
    try:
        strategies()
        found_points(_record_of(folder))
    except (ImportError, ValueError) as error:
        raise UsageError(str(error)) from error
    for search in [Search(policy, speed_range) for speed_range in options.speed_range for policy in policies]:
        try:
            found = smallest_point(search, options.generations)
        except PolicyError as error:
            print(f"{called(PROGRAM)}: {search.policy} failed: {error}", file=sys.stderr)
            return FAILED
        _write(search, found, folder)
    return DONE


def _write(search: Search, found: _Found, folder: Path) -> None:
    """Write the result of a search and its scenario to a folder, and print it."""
    about = {"policy": search.policy, "speed_range": search.speed_range}
    file = _record_of(folder)
    write_atomically(file, json_text({**found_points(file), search.name: {**about, **asdict(found)}}))
    if math.isinf(found.severity):
        print(f"{search.name}: none found in {found.episodes} episodes")
        return
    (*_, direction) = found.coordinates
    towards = [x / (1.0 if name == direction else found.severity) for name, x in found.coordinates.items()]
    search.scenario(found.severity, np.array(towards)).save(folder / f"{search.name}.toml")
    print(f"{search.name}: severity {found.severity:.3f}, {found.failed} of {CONFIRMED} episodes failed", flush=True)
