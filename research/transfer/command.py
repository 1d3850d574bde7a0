"""Compare policies in the plane and in six degrees of freedom: `python -m research transfer --help`.

The page of the results is docs/transfer.md.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg

from auv_gym.scenarios.names import CASES as KNOWN
from baselines.policies import list_policies
from baselines.tools.command_line import DONE, UsageError, check_words, parse
from baselines.tools.files import json_text, write_atomically
from baselines.tools.workers import Workers
from research.transfer import trials
from research.transfer.comparison import TRANSFER_FILE, TransferTask, summary
from research.transfer.page import verdict
from research.transfer.simulators import SIX_DOF_MODELS

PROGRAM = "python -m research transfer"
_POLICIES = (
    "backstepping",
    "backstepping-normalised",
    "integral-normalised",
    "ilos",
    "los-pid",
    "smc-dob",
    "adaptive",
    "lqi",
    "ekf",
    "nmpc",
    "helm",
    "helm-any",
)
"""Policies by default."""
_CASES = ("calm", "noise", "current", "waves", "mismatch", "storm")
"""Cases by default: those with the same disturbances in both simulators, which have different actuator lags."""


@dataclass(frozen=True)
class Options:
    """Run policies on the same episodes in the plane and in six degrees of freedom, and compare the errors.

    Exit status: 0 done, 2 wrong usage.
    """

    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = _POLICIES
    """Names of policies."""
    vehicle: Annotated[tuple[str, ...], arg(metavar="V [V ...]", help_behavior_hint="")] = tuple(SIX_DOF_MODELS)
    """Names of vehicles."""
    case: Annotated[tuple[str, ...], arg(metavar="C [C ...]", help_behavior_hint="")] = _CASES
    """Names of cases."""
    episodes: int = 64
    """Number of episodes of each case."""
    log: Annotated[Path | None, arg(metavar="LOG.csv", help_behavior_hint="")] = None
    """Only write the log of a trial of the first vehicle, for an identification."""
    jobs: int = 1
    """Worker processes."""
    out: Path = TRANSFER_FILE
    """File for the results."""


def main(arguments: Sequence[str]) -> int:
    """Compare the simulators, write the results, and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
        OSError: a file cannot be read or written.
    """
    options = parse(Options, arguments, PROGRAM)
    _check(options)
    if options.log is not None:
        trials.log(options.vehicle[0]).save(options.log)
        print(f"written: {options.log}, a trial of {options.vehicle[0]} in six degrees of freedom")
        return DONE
    record: dict[str, Any] = {}
    for vehicle in options.vehicle:
        record[vehicle] = {
            **summary(_results(options, vehicle)),
            "trials": trials.steady_motion(vehicle),
        }
        print(f"{vehicle}: {verdict(record[vehicle])}", flush=True)
    write_atomically(options.out, json_text(record))
    print(f"written: {options.out}")
    return DONE


def _check(options: Options) -> None:
    """Raise UsageError if an option is invalid."""
    check_words("policy", options.policy, list_policies())
    check_words("vehicle", options.vehicle, SIX_DOF_MODELS)
    check_words("case", options.case, KNOWN)
    if options.episodes < 2 or options.jobs < 1:
        raise UsageError("--episodes must be 2 or more and --jobs 1 or more")
    if len(options.policy) < 2 and options.log is None:
        raise UsageError(f"--policy names {len(options.policy)}; a ranking needs 2 or more")


def _results(options: Options, vehicle: str) -> dict[str, dict[str, Any]]:
    """Return the results by policy and case."""
    tasks = [TransferTask(policy, vehicle, options.case, options.episodes) for policy in options.policy]
    found: dict[str, dict[str, Any]] = {}
    for task, own in Workers(options.jobs).results(TransferTask.run, [(task,) for task in tasks]):
        found[task.policy] = own
        print(f"{vehicle}: {task.policy}", file=sys.stderr, flush=True)
    return {policy: found[policy] for policy in options.policy}
