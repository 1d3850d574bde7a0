"""Estimate failure rates with an upper confidence bound: `python -m research failure-rate --help`.

Episodes are drawn with separate seeds, on which no policy is trained, tuned or chosen, and with the same number for
each scenario. The bound is exact if all episodes have the same failure probability (Clopper and Pearson, Biometrika 26
(1934) 404). If the probabilities differ between scenarios, the bound is conservative: for a given mean, the probability
of at most c failures is largest with equal probabilities, for c up to the expected number minus one (Hoeffding, Annals
of Mathematical Statistics 27 (1956) 713).
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from auv_gym.scenarios.presets import CASES, PRESETS, SPEED_RANGES
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.metrics import failure_bound
from baselines.evaluation.request import checked_policies, checked_scenario
from baselines.evaluation.rollout import PolicyError, rollout
from baselines.evaluation.runner import drawn
from baselines.evaluation.score import count_failures, error_cap
from baselines.policies import make_policy
from baselines.tools.command_line import DONE, FAILED, UsageError, called, checked_folder, checked_record, parse
from baselines.tools.files import json_text, read_json, write_atomically
from research import DATA
from research.seeds import FAILURE_RATE

PROGRAM = "python -m research failure-rate"
_FILE = DATA / "failure_rate.json"  # record of the counts
_EPISODES = 10_000  # of each name of --scenario
_BATCH = 250  # episodes of a scenario that are simulated together
FailureCount = Mapping[str, Any]
"""Results of a policy in a scenario, with the first seeds of `FAILURE_RATE`: `scenario` (SHA-256 of the scenario),
`episodes`, `failed` (see `score.has_failed`), `largest_steady_rmse_m` [m]."""


@dataclass(frozen=True)
class Options:
    """Run policies through many held-out episodes, count the failures, and compute the upper bound of the rate.

    Exit status: 0 done, with or without failures, 1 a policy's actions are not finite, 2 wrong usage.
    """

    policy: Annotated[Positional[tuple[str, ...]], arg(metavar="POLICY [POLICY ...]")]
    """Policies by name, folder or file."""
    scenario: Annotated[tuple[str, ...], arg(metavar="S [S ...]", help_behavior_hint="")] = SPEED_RANGES
    """Presets, scenario files, slow or cruise for the eight cases of a speed range."""
    episodes: int = _EPISODES
    """Number of episodes of each name of --scenario, those of earlier runs included. The cases of a speed range have
    equal shares."""
    out: Path = _FILE
    """File for the counts. New counts are added to those of earlier runs."""


def _scenarios_of(name: str) -> tuple[Scenario, ...]:
    """Return the scenarios of a name of --scenario.

    Raises:
        UsageError: the name is unknown.
    """
    if name in SPEED_RANGES:
        return tuple(PRESETS[f"{name}-{case}"] for case in CASES)
    return (checked_scenario(name, SPEED_RANGES),)


def _run(policy: str, scenario: Scenario, first: int, episodes: int) -> tuple[int, int, float]:
    """Run episodes from number `first` on; return their number, the failures and the largest steady-state error [m].

    Raises:
        PolicyError: the actions of the policy are not finite.
    """
    cell = drawn(scenario, episodes, FAILURE_RATE.first + first)
    found = rollout(make_policy(policy, scenario.known), scenario, cell.episodes).measures
    return episodes, count_failures(found, error_cap(scenario.name)), float(found.steady_rmse.max())


def failure_counts(file: Path = _FILE) -> dict[str, dict[str, Any]]:
    """Return the recorded counts by policy: its `fingerprint`, and `counts`, a `FailureCount` for each scenario.

    Raises:
        UsageError: the file is no record of this command.
    """
    with checked_record(file, PROGRAM):
        record: dict[str, dict[str, Any]] = read_json(file) if file.exists() else {}
        for own in record.values():
            total(own["counts"].values())
        return record


def total(counts: Iterable[FailureCount]) -> tuple[int, int, float]:
    """Return failures, episodes and the largest steady-state error [m] of several counts together."""
    failed, episodes, steady_rmses = zip(
        *((c["failed"], c["episodes"], c["largest_steady_rmse_m"]) for c in counts), strict=True
    )
    return sum(failed), sum(episodes), max(steady_rmses)


def main(arguments: Sequence[str]) -> int:
    """Count failures, record them, and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options = parse(Options, arguments, PROGRAM)
    named = {name: _scenarios_of(name) for name in options.scenario}
    if not (options.episodes >= 1 and FAILURE_RATE.holds(FAILURE_RATE.first, options.episodes)):
        most = FAILURE_RATE.end - FAILURE_RATE.first
        raise UsageError(f"--episodes is {options.episodes}; it must be in [1, {most}]")
    policies = checked_policies(options.policy)
    checked_folder(options.out.parent)
    failure_counts(options.out)
    try:
        for policy in policies:
            for name, scenarios in named.items():
                share = -(-options.episodes // len(scenarios))  # of each, rounded up
                for target in (*range(_BATCH, share, _BATCH), share):  # scenarios in turn, so that counts stay equal
                    counts = [_count(policy, scenario, target, options.out) for scenario in scenarios]
                failed, episodes, _ = total(counts)
                bound = f"{100 * failure_bound(failed, episodes):.2g} %"
                print(f"{policy}, {name}: {failed} of {episodes} failed, 95 % upper bound {bound}", flush=True)
    except PolicyError as error:
        print(f"{called(PROGRAM)}: {policy} failed: {error}", file=sys.stderr)
        return FAILED
    return DONE


def _count(policy: str, scenario: Scenario, episodes: int, out: Path) -> FailureCount:
    """Run a policy until a file has the counts of this number of episodes of a scenario; return the counts."""
    text = json.dumps(scenario.to_dict(), sort_keys=True, allow_nan=False)
    digest, print_ = hashlib.sha256(text.encode()).hexdigest(), fingerprint(policy)
    while True:
        record = failure_counts(out)
        own = record.get(policy, {})
        counts = own["counts"] if own.get("fingerprint") == print_ else {}
        count: dict[str, Any] = counts.get(scenario.name, {})
        if count.get("scenario") != digest:
            count = {"scenario": digest, "episodes": 0, "failed": 0, "largest_steady_rmse_m": 0.0}
        if count["episodes"] >= episodes:
            return count
        more, failed, worst = _run(policy, scenario, count["episodes"], min(_BATCH, episodes - count["episodes"]))
        count = {
            "scenario": digest,
            "episodes": count["episodes"] + more,
            "failed": count["failed"] + failed,
            "largest_steady_rmse_m": max(count["largest_steady_rmse_m"], worst),
        }
        record[policy] = {"fingerprint": print_, "counts": {**counts, scenario.name: count}}
        write_atomically(out, json_text(record))
