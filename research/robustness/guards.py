"""Failures of agents with a guard and without in the frozen suites: `python -m research guards`.

Agents run with a guard; what they and the expert do without one is recorded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
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
from baselines.tools.command_line import DONE, UsageError, check_words, parse
from baselines.tools.files import json_text, read_json, write_atomically
from research import DATA

PROGRAM = "python -m research guards"
GUARDS_FILE = DATA / "guards.json"  # what guards did
FINGERPRINT = "fingerprint"  # entry beside the rows of a policy
COUNTS = "episodes", "failed", "guarded_failed", "expert_keeps", "guarded_expert_keeps"
STEADY_RMSES = "steady_rmse_mm", "guarded_steady_rmse_mm"
_SUITES = ("benchmark-v1", "ood-v1", "unmodelled-v1", "sealed-v1")
"""Suites in which policies fail."""
_AT_ONCE = 520  # episodes side by side


@dataclass(frozen=True)
class Options:
    """Run agents with a guard in frozen suites and keep what each does.

    Exit status: 0 done, 2 wrong usage.
    """

    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = ("helm",)
    """Agents by name."""
    suite: Annotated[tuple[str, ...], arg(metavar="S [S ...]", help_behavior_hint="")] = _SUITES
    """Frozen suites."""
    episodes: int = 10_000
    """Most episodes of each cell of a suite, the first ones."""
    out: Path = GUARDS_FILE
    """File to which what they do is added."""


def in_suite(policy: str, suite: suites.Suite, most: int) -> dict[str, Any]:
    """Return what a policy does in a suite with a guard and without, and which of the expert's episodes it loses."""
    by_policy = {name: {r.scenario.name: r for r in recorded.read_recorded(suite, name)} for name in (EXPERT, policy)}
    cells = [cell for cell in suite.cells if cell.scenario.name in by_policy[policy]]
    counts = dict.fromkeys(COUNTS, 0)
    steady_rmses: dict[str, list[Array]] = {key: [] for key in STEADY_RMSES}
    for cell in cells:
        few, name = cell.episodes[:most], cell.scenario.name
        cap = error_cap(name)
        measured = [by_policy[who][name].measures for who in (EXPERT, policy)]
        expert, bare = (m[: len(few)] for m in measured if m is not None)
        gone = [has_failed(m, cap) for m in (expert, bare)]
        steady_rmse, failed = _with_guard(policy, Cell(cell.scenario, few), cap)
        counts["episodes"] += len(few)
        for key, mine in (("", gone[1]), ("guarded_", failed)):
            counts[f"{key}lost"] += int(mine.sum())
            counts[f"{key}expert_keeps"] += int((mine & ~gone[0]).sum())
        steady_rmses["steady_rmse_mm"].append(capped(bare, cap))
        steady_rmses["guarded_steady_rmse_mm"].append(steady_rmse)
    return {**counts, **{key: 1e3 * float(np.concatenate(own).mean()) for key, own in steady_rmses.items()}}


def _with_guard(policy: str, cell: Cell, cap: float) -> tuple[Array, Any]:
    """Return capped tails [m] of a policy with a guard in a cell, and which episodes it loses."""
    steady_rmses, failed = [], []
    for first in range(0, len(cell.episodes), _AT_ONCE):
        part = Cell(cell.scenario, cell.episodes[first : first + _AT_ONCE])
        (ended,) = SideBySide([part]).run(make_policy(f"{policy}{GUARD}", cell.scenario.vehicle))
        failed.append(has_failed(ended, cap))
        steady_rmses.append(capped(ended, cap))
    return np.concatenate(steady_rmses), np.concatenate(failed)


def main(arguments: Sequence[str]) -> int:
    """Run as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    check_words("suite", options.suite, _SUITES)
    if options.episodes < 1:
        raise UsageError(f"--episodes is {options.episodes}; it must be 1 or more")
    policies = checked_policies(options.policy)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    for policy in policies:
        for name in options.suite:
            suite = suites.load_suite(name)
            if policy not in recorded.recorded_policies(suite):
                raise UsageError(f"nothing is recorded of {policy} in {name}; record it first")
            row = in_suite(policy, suite, options.episodes)
            _add(options.out, policy, {name: row})
            print(f"{policy}, {name}: {row}", flush=True)
    return DONE


def _add(file: Path, policy: str, rows: Mapping[str, Any]) -> None:
    """Add rows of a policy to a file; those of another fingerprint go."""
    record = read_json(file) if file.exists() else {}
    own = record.get(policy, {})
    digest = fingerprint(f"{policy}{GUARD}")
    rest = own if own.get(FINGERPRINT) == digest else {}
    record[policy] = {**rest, FINGERPRINT: digest, **rows}
    write_atomically(file, json_text(record))
