"""Check in many episodes that the full-information optimum never fails: `python -m research bound`.

A failure of `clairvoyant`, whose score is 1, would raise all other scores. The command runs it through held-out
episodes of all cases and keeps the counts in `research/data/bound.json`. A later run continues after the recorded
episodes, or starts again if the policy has changed. In episodes in which its steady-state error is not small, the
expert and the oracle run too: if one of them is better, the solver has failed.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import reduce
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
_FILE = DATA / "bound.json"  # record of the counts
OPTIMUM_EPISODES = 10_000  # of all cases together
_BATCH = 125  # episodes of a case that are solved together
SCENARIOS = tuple(PRESETS[f"{speed_range}-{case}"] for speed_range in SPEED_RANGES for case in CASES)
"""The cases of both speed ranges."""


@dataclass(frozen=True)
class Options:
    """Run the full-information optimum through many episodes of all cases and count its failures.

    Exit status: 0 done, 1 it failed, or another policy was better by more than a millimetre, 2 wrong usage.
    """

    episodes: int = OPTIMUM_EPISODES
    """Number of episodes of all cases together, those of earlier runs included."""
    out: Path = _FILE
    """File for the counts. New counts are added to those of earlier runs."""


@dataclass(frozen=True)
class OptimumCount:
    """Results of the optimum in episodes of a case, those of the first seeds of `OPTIMUM`."""

    episodes: int = 0
    failed: int = 0  # number of failures, see `score.has_failed`
    steady_rmses_m: float = 0.0  # sum of the steady-state errors
    largest_steady_rmse_m: float = 0.0
    largest_error_m: float = 0.0  # at any time after the first third of an episode; a vehicle that spins is metres away
    astray: tuple[Mapping[str, Any], ...] = field(default=())
    """Episodes whose error is not below `GOOD`: seed, error, and errors of oracle and expert [m]."""

    def with_more(self, more: OptimumCount) -> OptimumCount:
        """Return the results of these and of more episodes together."""
        return OptimumCount(
            self.episodes + more.episodes,
            self.failed + more.failed,
            self.steady_rmses_m + more.steady_rmses_m,
            max(self.largest_steady_rmse_m, more.largest_steady_rmse_m),
            max(self.largest_error_m, more.largest_error_m),
            (*self.astray, *more.astray),
        )


def run_episodes(scenario: Scenario, first: int, episodes: int) -> OptimumCount:
    """Run the optimum through episodes of a scenario, from number `first` of `OPTIMUM` on, and return the results."""
    seed = OPTIMUM.first + first
    cell = drawn(scenario, episodes, seed)
    found = rollout(make_policy(OPTIMUM_POLICY, scenario.known), scenario, cell.episodes)
    steady_rmse = found.measures.steady_rmse
    far = np.flatnonzero(~(steady_rmse < GOOD)).tolist()
    others = {policy: _steady_rmses(policy, cell, far) for policy in (ORACLE, EXPERT)} if far else {}
    astray = tuple(
        {"seed": seed + i, f"{OPTIMUM_POLICY}_m": float(steady_rmse[i]), **{f"{p}_m": others[p][j] for p in others}}
        for j, i in enumerate(far)
    )
    errors = found.errors[scenario.steps // 3 :]
    failed = count_failures(found.measures, error_cap(scenario.name))
    return OptimumCount(
        episodes, failed, float(steady_rmse.sum()), float(steady_rmse.max()), float(errors.max()), astray
    )


def _steady_rmses(policy: str, cell: Cell, indices: Sequence[int]) -> list[float]:
    """Return a policy's steady-state errors [m] in the episodes of a cell with these indices."""
    episodes = [cell.episodes[i] for i in indices]
    found = rollout(make_policy(policy, cell.scenario.known), cell.scenario, episodes)
    steady_rmses: list[float] = found.measures.steady_rmse.tolist()
    return steady_rmses


def optimum_counts(file: Path = _FILE) -> dict[str, OptimumCount]:
    """Return the recorded results by case; {} without a record or if the policy has changed since.

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
    """Return the results of all cases together."""
    return reduce(OptimumCount.with_more, counts.values(), OptimumCount())


def summary_text(counts: Mapping[str, OptimumCount]) -> str:
    """Return a sentence with the results of all cases together."""
    every = all_cases(counts)
    at_most = 100 * failure_bound(every.failed, every.episodes)
    return (
        f"{every.failed} of {every.episodes} episodes failed (95 % upper confidence bound {at_most:.2g} %); "
        f"steady-state error: mean {1e3 * every.steady_rmses_m / every.episodes:.3f} mm, largest "
        f"{1e3 * every.largest_steady_rmse_m:.3f} mm; "
        f"largest error at any time after the first third: {1e3 * every.largest_error_m:.3f} mm; episodes with a "
        f"steady-state error of {1e3 * GOOD:g} mm or more: {len(every.astray)}"
    )


def better_policies(counts: Mapping[str, OptimumCount]) -> list[str]:
    """Return a line for each episode in which oracle or expert is better than the optimum by more than a millimetre."""
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
    """Run the optimum, record the counts, and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options = parse(Options, arguments, PROGRAM)
    share = -(-options.episodes // len(SCENARIOS))  # of each case, rounded up
    if not (options.episodes >= 1 and OPTIMUM.holds(OPTIMUM.first, share)):
        most = len(SCENARIOS) * (OPTIMUM.end - OPTIMUM.first)
        raise UsageError(f"--episodes is {options.episodes}; it must be in [1, {most}]")
    counts = {scenario.name: OptimumCount() for scenario in SCENARIOS} | optimum_counts(options.out)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    for scenario in SCENARIOS:
        for first in range(counts[scenario.name].episodes, share, _BATCH):
            more = run_episodes(scenario, first, min(_BATCH, share - first))
            counts[scenario.name] = counts[scenario.name].with_more(more)
            record = {
                "fingerprint": fingerprint(OPTIMUM_POLICY),
                "cases": {name: asdict(c) for name, c in counts.items()},
            }
            write_atomically(options.out, json_text(record))
        print(f"{scenario.name}: {summary_text({scenario.name: counts[scenario.name]})}", flush=True)
    print(summary_text(counts))
    better = better_policies(counts)
    for line in better:
        print(f"{called(PROGRAM)}: another policy is better: {line}", file=sys.stderr)
    return FAILED if better or all_cases(counts).failed else DONE
