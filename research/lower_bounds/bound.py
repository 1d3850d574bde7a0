"""Check in many episodes that the full-information optimum never fails: `python -m research bound`.

A failure of `clairvoyant`, whose score is 1, would raise all other scores. It runs held-out episodes of all cases, and
the counts are kept in `research/data/bound.json`. A later run continues where an earlier one has stopped, and starts
again if the policy has changed. Where its steady-state error is not small, expert and oracle run too: an episode in
which one of them is better shows a fault of the solver.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from auv_gym.scenarios.presets import CASES, PRESETS, SPEED_RANGES
from auv_gym.scenarios.scenario import Scenario
from baselines.control.privileged.solver import GOOD
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.metrics import failure_bound
from baselines.evaluation.rollout import rollout
from baselines.evaluation.runner import Cell, drawn
from baselines.evaluation.score import EXPERT, OPTIMUM_POLICY, ORACLE, count_failures, error_cap
from baselines.policies import make_policy
from baselines.tools.command_line import DONE, FAILED, UsageError, called, checked_record, parse
from baselines.tools.files import json_text, read_json, write_atomically
from research import DATA
from research.seeds import OPTIMUM

PROGRAM = "python -m research bound"
_FILE = DATA / "bound.json"  # what was counted
OPTIMUM_EPISODES = 10_000  # of all cases together
_AT_ONCE = 125  # episodes of a case that are solved together
SCENARIOS = tuple(PRESETS[f"{speed_range}-{case}"] for speed_range in SPEED_RANGES for case in CASES)
"""The cases, of both speed ranges."""


@dataclass(frozen=True)
class Options:
    """Run the full-information optimum through many episodes of all cases and count its failures.

    Exit status: 0 done, 1 it failed, or another policy was better by more than a millimetre, 2 wrong usage.
    """

    episodes: int = OPTIMUM_EPISODES
    """Of all cases together; those that were run before count."""
    out: Path = _FILE
    """File for the counts, to which episodes are added."""


@dataclass(frozen=True)
class OptimumCount:
    """Counts of some episodes of a case, those of the first seeds of `OPTIMUM`."""

    episodes: int = 0
    failed: int = 0  # see `score.has_failed`
    steady_rmses_m: float = 0.0  # the sum of the steady-state errors
    largest_steady_rmse_m: float = 0.0
    largest_error_m: float = 0.0  # at any instant after the first third: a vehicle that spins is metres away
    astray: tuple[Mapping[str, Any], ...] = field(default=())
    """Episodes whose error is not below `GOOD`: seed, error, and those of oracle and expert [m]."""

    def with_more(self, more: OptimumCount) -> OptimumCount:
        """Return the count of these episodes and of others."""
        return OptimumCount(
            self.episodes + more.episodes,
            self.failed + more.failed,
            self.steady_rmses_m + more.steady_rmses_m,
            max(self.largest_steady_rmse_m, more.largest_steady_rmse_m),
            max(self.largest_error_m, more.largest_error_m),
            (*self.astray, *more.astray),
        )


def counted(scenario: Scenario, first: int, episodes: int) -> OptimumCount:
    """Return what the bound does in episodes of a scenario, `first` and the following ones of `OPTIMUM`."""
    seed = OPTIMUM.first + first
    cell = drawn(scenario, episodes, seed)
    found = rollout(make_policy(OPTIMUM_POLICY, scenario.vehicle), scenario, cell.episodes)
    steady_rmse = found.measures.steady_rmse
    far = np.flatnonzero(~(steady_rmse < GOOD)).tolist()
    rivals = {policy: _steady_rmses(policy, cell, far) for policy in (ORACLE, EXPERT)} if far else {}
    astray = tuple(
        {"seed": seed + i, f"{OPTIMUM_POLICY}_m": float(steady_rmse[i]), **{f"{p}_m": rivals[p][j] for p in rivals}}
        for j, i in enumerate(far)
    )
    errors = found.errors[scenario.steps // 3 :]
    failed = count_failures(found.measures, error_cap(scenario.name))
    return OptimumCount(
        episodes, failed, float(steady_rmse.sum()), float(steady_rmse.max()), float(errors.max()), astray
    )


def _steady_rmses(policy: str, cell: Cell, few: Sequence[int]) -> list[float]:
    """Return a policy's steady-state errors [m] in a few of a cell's episodes."""
    own = [cell.episodes[i] for i in few]
    steady_rmses: list[float] = rollout(
        make_policy(policy, cell.scenario.vehicle), cell.scenario, own
    ).measures.steady_rmse.tolist()
    return steady_rmses


def optimum_counts(file: Path = _FILE) -> dict[str, OptimumCount]:
    """Return what was counted, by case; nothing where the bound has changed since, or nothing was counted.

    Raises:
        UsageError: the file is damaged.
    """
    if not file.exists():
        return {}
    with checked_record(file, PROGRAM):
        record = read_json(file)
        found = {name: OptimumCount(**{**of, "astray": tuple(of["astray"])}) for name, of in record["cases"].items()}
        return found if record["fingerprint"] == fingerprint(OPTIMUM_POLICY) else {}


def all_cases(counts: Mapping[str, OptimumCount]) -> OptimumCount:
    """Return the count of all cases."""
    every = OptimumCount()
    for count in counts.values():
        every = every.with_more(count)
    return every


def in_words(counts: Mapping[str, OptimumCount]) -> str:
    """Return what was counted, in words."""
    every = all_cases(counts)
    at_most = 100 * failure_bound(every.failed, every.episodes)
    return (
        f"{every.failed} of {every.episodes} episodes failed (95 % upper confidence bound {at_most:.2g} %); "
        f"steady-state error: mean {1e3 * every.steady_rmses_m / every.episodes:.3f} mm, largest "
        f"{1e3 * every.largest_steady_rmse_m:.3f} mm; "
        f"largest error at any time after the first third: {1e3 * every.largest_error_m:.3f} mm; episodes with a "
        f"steady-state error of {1e3 * GOOD:g} mm or more: {len(every.astray)}"
    )


def nearer(counts: Mapping[str, OptimumCount]) -> list[str]:
    """Return the episodes in which oracle or expert is nearer than the bound by more than a millimetre, in words."""
    found = []
    for name, count in counts.items():
        for own in count.astray:
            best = min((ORACLE, EXPERT), key=lambda policy: own[f"{policy}_m"])
            if own[f"{best}_m"] < own[f"{OPTIMUM_POLICY}_m"] - 1e-3:
                found.append(
                    f"{name}, seed {own['seed']}: {own[f'{OPTIMUM_POLICY}_m']:.4f} m, {best} {own[f'{best}_m']:.4f} m"
                )
    return found


def main(arguments: Sequence[str]) -> int:
    """Count as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    share = -(-options.episodes // len(SCENARIOS))  # of each case, rounded up
    if not (options.episodes >= 1 and OPTIMUM.holds(OPTIMUM.first, share)):
        most = len(SCENARIOS) * (OPTIMUM.end - OPTIMUM.first)
        raise UsageError(f"--episodes is {options.episodes}; it must be in [1, {most}]")
    counts = {scenario.name: OptimumCount() for scenario in SCENARIOS} | optimum_counts(options.out)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    for scenario in SCENARIOS:
        for first in range(counts[scenario.name].episodes, share, _AT_ONCE):
            more = counted(scenario, first, min(_AT_ONCE, share - first))
            counts[scenario.name] = counts[scenario.name].with_more(more)
            record = {
                "fingerprint": fingerprint(OPTIMUM_POLICY),
                "cases": {name: asdict(c) for name, c in counts.items()},
            }
            write_atomically(options.out, json_text(record))
        print(f"{scenario.name}: {in_words({scenario.name: counts[scenario.name]})}", flush=True)
    print(in_words(counts))
    worse = nearer(counts)
    for line in worse:
        print(f"{called(PROGRAM)}: another policy is nearer: {line}", file=sys.stderr)
    return FAILED if worse or all_cases(counts).failed else DONE
