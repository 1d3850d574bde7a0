"""Recorded results of policies on the frozen suites, so that slow policies need not run again.

`python -m research suites record SUITE --policy POLICY ...` makes the file SUITE.npz. An agent has results in the cells
of its speed range only, and a slow policy may have run the first episodes of each cell only.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from auv_gym.scenarios.presets import SPEED_RANGES
from baselines.agents.agent import Agent
from baselines.agents.names import PolicyName
from baselines.evaluation.fingerprints import changed_parts, fingerprint, simulator_fingerprint
from baselines.evaluation.results import ResultFile
from baselines.evaluation.runner import Run
from baselines.evaluation.score import speed_range_of
from baselines.evaluation.suites import Suite
from baselines.policies import list_policies
from baselines.space import SPACE_POLICIES, SPEED_RANGE
from baselines.tools.files import data_files

RECORDED = "recorded"  # name of the folders of the files


class RecordedRuns(NamedTuple):
    """The recorded runs of a suite."""

    runs: tuple[Run, ...]  # ordered by policy, as in the registry
    notes: tuple[str, ...]  # the reasons why runs are left out, and what has changed since the recording


def recorded_runs(suite: Suite) -> RecordedRuns:
    """Return the recorded runs of a suite.

    Runs are left out if the equations or the data of the policy have changed. If only code that runs as Python has
    changed, or the simulator, they are used with a note: `python -m research suites verify` shows if they repeat.
    """
    order, notes = list(list_policies(None)), dict[str, None]()
    runs = [run for file in recorded_files(suite.name) for run in read_recorded(suite, file).runs]
    current = []
    for run in sorted(runs, key=lambda run: order.index(run.policy) if run.policy in order else len(order)):
        changes = changed_parts(run.fingerprint, fingerprint(run.policy, [run.scenario]))
        if "equations" in changes or "data" in changes:
            notes[f"the recorded results of {run.policy} are left out: its {changes[0]} have changed"] = None
            continue
        if changes or run.simulator != simulator_fingerprint([run.scenario]):
            what = "code of policies" if changes else "simulator"
            notes[f"the {what} has changed since results of {suite.name} were recorded"] = None
        current.append(run)
    return RecordedRuns(tuple(current), tuple(notes))


def recorded_files(suite: str) -> list[Path]:
    """Return the files with recorded results of a suite."""
    return data_files(f"{RECORDED}/{suite}.npz")


def read_recorded(suite: Suite, file: Path) -> ResultFile:
    """Return the content of a file of recorded results.

    Raises:
        OSError: it cannot be read.
        ValueError: it is damaged, or belongs to another suite.
    """
    content = ResultFile.read(file)
    if content.suite_hash != suite.hash:
        raise ValueError(f"{file} belongs to another {suite.name}, of hash {content.suite_hash[:12]}")
    return content


def speed_ranges_of(policy: str) -> tuple[str, ...]:
    """Return the speed ranges of a policy, "space" among them; for an agent, those of its training scenarios."""
    name = PolicyName.of(policy)
    if name.folder is None:
        in_space = name.kind != "controller" or name.base in SPACE_POLICIES
        return (*SPEED_RANGES, SPEED_RANGE) if in_space and name.fallback is None else SPEED_RANGES
    trained = {speed_range_of(scenario) for scenario in Agent.load(name.folder).scenarios}
    return tuple(speed_range for speed_range in (*SPEED_RANGES, SPEED_RANGE) if speed_range in trained) or SPEED_RANGES
