"""Estimate failure rates with an upper confidence bound: `python -m research failure-rate --help`.

Episodes are drawn from seeds of their own, on which nothing is trained, tuned or chosen, the same number of each
scenario. The bound is exact where all episodes fail with the same probability (Clopper and Pearson, Biometrika 26
(1934) 404). Where the scenarios' probabilities differ, it is conservative: of all probabilities with the same mean the
equal ones make few failures the likeliest, where few is one below the expected number, or less (Hoeffding, Annals of
Mathematical Statistics 27 (1956) 713).
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

from auv_gym.scenarios.mixtures import adverse
from auv_gym.scenarios.presets import CASES, PRESETS, SPEED_RANGES
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.metrics import failure_bound
from baselines.evaluation.request import checked_policies, checked_scenario
from baselines.evaluation.rollout import PolicyError, rollout
from baselines.evaluation.runner import drawn
from baselines.evaluation.score import count_failures, error_cap
from baselines.policies import make_policy
from baselines.tools.command_line import DONE, FAILED, UsageError, called, checked_record, parse
from baselines.tools.files import json_text, read_json, write_atomically
from research import DATA
from research.seeds import FAILURE_RATE

PROGRAM = "python -m research failure-rate"
_FILE = DATA / "certificates.json"  # what was counted
_EPISODES = 10_000  # of all scenarios that are named together
_AT_ONCE = 250  # episodes of a scenario that run side by side
ADVERSE = tuple(f"{speed_range}-adverse" for speed_range in SPEED_RANGES)
"""Names of the storms with sensor and actuator faults."""
FailureCount = Mapping[str, Any]
"""What a policy did in the first seeds of `FAILURE_RATE` of a scenario: `scenario` (SHA-256 of it), `episodes`,
`failed` (see `score.has_failed`), `largest_steady_rmse_m` [m]."""


@dataclass(frozen=True)
class Options:
    """Run policies through many fresh episodes, count the failures, and give the upper bound of their rate.

    Exit status: 0 done, whatever failed, 1 a policy's actions are not finite, 2 wrong usage.
    """

    policy: Annotated[Positional[tuple[str, ...]], arg(metavar="POLICY [POLICY ...]")]
    """Policies by name, folder or file."""
    scenario: Annotated[tuple[str, ...], arg(metavar="S [S ...]", help_behavior_hint="")] = SPEED_RANGES
    """Presets, scenario files, slow or cruise for the eight cases of a regime, slow-adverse or cruise-adverse for
    storms with sensor and actuator faults."""
    episodes: int = _EPISODES
    """Of each name of --scenario; those of a regime are shared evenly among its cases. Those that were run before
    count."""
    out: Path = _FILE
    """File for the counts, to which episodes are added."""


def _scenarios_of(name: str) -> tuple[Scenario, ...]:
    """Return the scenarios that a word of the command line stands for.

    Raises:
        UsageError: it stands for none.
    """
    if name in SPEED_RANGES:
        return tuple(PRESETS[f"{name}-{case}"] for case in CASES)
    if name in ADVERSE:
        return (adverse(name.partition("-")[0]),)
    return (checked_scenario(name, (*SPEED_RANGES, *ADVERSE)),)


def _counted(policy: str, scenario: Scenario, first: int, episodes: int) -> tuple[int, int, float]:
    """Return episodes, failures and the largest tail [m] of a policy, in episode `first` and the following ones.

    Raises:
        PolicyError: its actions are not finite.
    """
    cell = drawn(scenario, episodes, FAILURE_RATE.first + first)
    found = rollout(make_policy(policy, scenario.vehicle), scenario, cell.episodes).measures
    return episodes, count_failures(found, error_cap(scenario.name)), float(found.steady_rmse.max())


def failure_counts(file: Path = _FILE) -> dict[str, dict[str, Any]]:
    """Return what was counted, by policy: its `fingerprint`, and `counts`, a `FailureCount` by scenario.

    Raises:
        UsageError: the file holds something else.
    """
    with checked_record(file, PROGRAM):
        record: dict[str, dict[str, Any]] = read_json(file) if file.exists() else {}
        for own in record.values():
            together(own["counts"].values())
        return record


def together(counts: Iterable[FailureCount]) -> tuple[int, int, float]:
    """Return failures, episodes and the largest tail [m] of several counts."""
    failed, episodes, steady_rmses = zip(
        *((c["failed"], c["episodes"], c["largest_steady_rmse_m"]) for c in counts), strict=True
    )
    return sum(failed), sum(episodes), max(steady_rmses)


def main(arguments: Sequence[str]) -> int:
    """Count as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    named = {name: _scenarios_of(name) for name in options.scenario}
    if not (options.episodes >= 1 and FAILURE_RATE.holds(FAILURE_RATE.first, options.episodes)):
        most = FAILURE_RATE.end - FAILURE_RATE.first
        raise UsageError(f"--episodes is {options.episodes}; it must be in [1, {most}]")
    policies = checked_policies(options.policy)
    failure_counts(options.out)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    try:
        for policy in policies:
            for name, scenarios in named.items():
                share = -(-options.episodes // len(scenarios))  # of each, rounded up
                for target in (*range(_AT_ONCE, share, _AT_ONCE), share):  # in turns, so that none is ahead if it stops
                    counts = [_until(policy, scenario, target, options.out) for scenario in scenarios]
                failed, episodes, _ = together(counts)
                at_most = f"{100 * failure_bound(failed, episodes):.2g} % (one-sided, 95 %)"
                print(f"{policy}, {name}: {failed} of {episodes} lost, at most {at_most}", flush=True)
    except PolicyError as error:
        print(f"{called(PROGRAM)}: {policy} failed: {error}", file=sys.stderr)
        return FAILED
    return DONE


def _until(policy: str, scenario: Scenario, episodes: int, out: Path) -> FailureCount:
    """Run a policy until so many episodes of a scenario are counted in a file; return the count."""
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
        ran, failed, worst = _counted(policy, scenario, count["episodes"], min(_AT_ONCE, episodes - count["episodes"]))
        count = {
            "scenario": digest,
            "episodes": count["episodes"] + ran,
            "failed": count["failed"] + failed,
            "largest_steady_rmse_m": max(count["largest_steady_rmse_m"], worst),
        }
        record[policy] = {"fingerprint": print_, "counts": {**counts, scenario.name: count}}
        write_atomically(out, json_text(record))
