"""Compare failures with and without a guard in the frozen suites: `python -m research guards`.

The agents run with a guard. The results without one, and those of the expert, are the recorded ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from tyro.conf import arg

from auv_gym.physics.namespaces import Array
from baselines.agents.names import GUARD
from baselines.evaluation import recorded, suites
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.request import checked_policies
from baselines.evaluation.runner import Cell
from baselines.evaluation.score import EXPERT, capped, error_cap, has_failed
from baselines.evaluation.side_by_side import SideBySide
from baselines.policies import make_policy
from baselines.tools.command_line import DONE, UsageError, check_words, checked_folder, parse
from baselines.tools.files import json_text, read_json, write_atomically
from research import DATA

PROGRAM = "python -m research guards"
GUARDS_FILE = DATA / "guards.json"  # record of the results
FINGERPRINT = "fingerprint"  # key next to the suites of a policy in the record
COUNTS = "episodes", "failed", "guarded_failed", "expert_keeps", "guarded_expert_keeps"
"""Keys of the counts of a row; "expert_keeps" are failures in episodes in which the expert does not fail."""
STEADY_RMSES = "steady_rmse_mm", "guarded_steady_rmse_mm"
"""Keys of the mean errors of a row."""
_SUITES = ("benchmark-v1", "ood-v1", "unmodelled-v1", "sealed-v2")
"""Suites in which policies fail."""
_BATCH = 520  # episodes that are simulated together


@dataclass(frozen=True)
class Options:
    """Run agents with a guard in frozen suites and keep the results.

    Exit status: 0 done, 2 wrong usage.
    """

    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = ("helm",)
    """Names of agents."""
    suite: Annotated[tuple[str, ...], arg(metavar="S [S ...]", help_behavior_hint="")] = _SUITES
    """Frozen suites."""
    episodes: int = 10_000
    """Largest number of episodes of each cell of a suite, the first ones."""
    out: Path = GUARDS_FILE
    """File to which the results are added."""


def in_suite(policy: str, suite: suites.Suite, most: int) -> dict[str, Any]:
    """Return counts of failures and mean errors of a policy with and without a guard, as `COUNTS` and `STEADY_RMSES`.

    Args:
        policy: name of the policy.
        suite: a frozen suite.
        most: largest number of episodes of each cell, the first ones.
    """
    by_policy = {name: {r.scenario.name: r for r in recorded.read_recorded(suite, name)} for name in (EXPERT, policy)}
    cells = [cell for cell in suite.cells if cell.scenario.name in by_policy[policy]]
    counts = dict.fromkeys(COUNTS, 0)
    steady_rmses: dict[str, list[Array]] = {key: [] for key in STEADY_RMSES}
    for cell in cells:
        episodes, name = cell.episodes[:most], cell.scenario.name
        cap = error_cap(name)
        rows = [by_policy[each][name].measures for each in (EXPERT, policy)]
        expert, plain = (m[: len(episodes)] for m in rows if m is not None)
        expert_failed = has_failed(expert, cap)
        steady_rmse, guarded_failed = _with_guard(policy, Cell(cell.scenario, episodes), cap)
        counts["episodes"] += len(episodes)
        for key, failed in (("", has_failed(plain, cap)), ("guarded_", guarded_failed)):
            counts[f"{key}failed"] += int(failed.sum())
            counts[f"{key}expert_keeps"] += int((failed & ~expert_failed).sum())
        steady_rmses["steady_rmse_mm"].append(capped(plain, cap))
        steady_rmses["guarded_steady_rmse_mm"].append(steady_rmse)
    return {**counts, **{key: 1e3 * float(np.concatenate(own).mean()) for key, own in steady_rmses.items()}}


def _with_guard(policy: str, cell: Cell, cap: float) -> tuple[Array, NDArray[np.bool_]]:
    """Return for each episode of a cell the capped error [m] of a policy with a guard, and whether it failed."""
    steady_rmses, failed = [], []
    for first in range(0, len(cell.episodes), _BATCH):
        part = Cell(cell.scenario, cell.episodes[first : first + _BATCH])
        (ended,) = SideBySide([part]).run(make_policy(f"{policy}{GUARD}", cell.scenario.known))
        failed.append(has_failed(ended, cap))
        steady_rmses.append(capped(ended, cap))
    return np.concatenate(steady_rmses), np.concatenate(failed)


def main(arguments: Sequence[str]) -> int:
    """Run agents with a guard, record the results, and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options = parse(Options, arguments, PROGRAM)
    check_words("suite", options.suite, _SUITES)
    if options.episodes < 1:
        raise UsageError(f"--episodes is {options.episodes}; it must be 1 or more")
    checked_folder(options.out.parent)
    policies = checked_policies(options.policy)
    for policy in policies:
        for name in options.suite:
            suite = suites.load_suite(name)
            if policy not in recorded.recorded_policies(suite):
                raise UsageError(f"there are no recorded rows of {policy} in {name}; record them first")
            row = in_suite(policy, suite, options.episodes)
            add_rows(options.out, policy, fingerprint(f"{policy}{GUARD}"), {name: row})
            print(f"{policy}, {name}: {row}", flush=True)
    return DONE


def add_rows(file: Path, policy: str, digest: str, rows: Mapping[str, Any]) -> None:
    """Add rows of a policy to a file and delete its rows with another fingerprint than `digest`."""
    record = read_json(file) if file.exists() else {}
    own = record.get(policy, {})
    rest = own if own.get(FINGERPRINT) == digest else {}
    record[policy] = {**rest, FINGERPRINT: digest, **rows}
    write_atomically(file, json_text(record))
