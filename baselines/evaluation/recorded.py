"""Recorded rows: results of policies on the frozen suites, so that slow policies need not run again.

The file SUITE/POLICY.npz is made by `python -m research suites record SUITE --policy POLICY ...`, and has the hash of
the suite. `STAMPS_FILE` has the hash of each file, and the fingerprints of the policy and of the simulator.

Rows are not used if the suite, the file or the policy has changed. They are used again after a new recording, or after
`verify` has shown that the policy gives the same results. If the simulator has changed, rows are used with a note. A
slow policy may have run only the first episodes of each cell, and an agent only the cells of its speed range.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.installation import RECORD, checkout, found, left_out
from auv_gym.scenarios.presets import SPEED_RANGES
from baselines.agents.agent import Agent
from baselines.agents.names import agent_folder, bare_name
from baselines.evaluation.fingerprints import fingerprint, simulator_fingerprint
from baselines.evaluation.metrics import Measures
from baselines.evaluation.runner import Recorded, Run
from baselines.evaluation.score import speed_range_of
from baselines.evaluation.store import Stored, reading, write
from baselines.evaluation.suites import Suite
from baselines.policies import list_policies
from baselines.tools.files import json_text, write_atomically

RECORDED_FOLDER = Path(__file__).parent / "data" / "recorded"  # a folder for each suite, a file for each policy
RECORDED_SUITES = ("benchmark-v1", "ood-v1", "unmodelled-v1", "deep-v1", "sealed-v2", "vehicles-v2")
"""The suites with recorded rows."""
STAMPS_FILE = "fingerprints.json"  # file of the hashes and fingerprints


DIGITS = {"rmse": 8, "effort": 11, "smoothness": 13, "total_reward": 8}
"""Binary digits of metrics of which only means over episodes are reported; no printed number needs more. The other
metrics have single precision."""


@dataclass(frozen=True)
class Found:
    """The recorded rows of a suite."""

    runs: tuple[Run, ...]  # ordered by policy, as in the registry, then by cell
    refused: dict[str, str]  # the reason why rows are not used, by policy
    note: str = ""  # a note if the simulator has changed


def load_recorded(suite: Suite, folder: Path = RECORDED_FOLDER) -> Found:
    """Return the recorded runs of a suite, without outdated ones."""
    runs: list[Run] = []
    refused: dict[str, str] = {}
    stamps, simulators = _stamps(folder), set()
    for policy in recorded_policies(suite, folder):
        found = _usable(suite, policy, stamps, folder)
        if isinstance(found, str):
            refused[policy] = found
        else:
            runs += found
            simulators.add(tuple(stamps[_key(suite, policy)][2:]))
    changed = simulators - {(simulator_fingerprint(),)}
    note = f"the code of the simulator has changed since rows of {suite.name} were recorded" if changed else ""
    return Found(tuple(runs), refused, note)


def _usable(suite: Suite, policy: str, stamps: Mapping[str, list[str]], folder: Path) -> list[Run] | str:
    """Return the recorded runs of a policy, or the reason why they are not used."""
    try:
        runs = read_recorded(suite, policy, folder)
        if stamps.get(_key(suite, policy), [])[:2] != _stamp(suite, policy, folder)[:2]:
            return "the policy's files or the rows have changed since the recording"
    except (OSError, ValueError) as error:
        return str(error)
    return runs


def missing(suite: str, folder: Path = RECORDED_FOLDER) -> str | None:
    """Return a message if the recorded rows of a suite are only in the source repository, not in this package."""
    if checkout() is not None or suite not in RECORDED_SUITES or (folder / suite).is_dir():
        return None
    return left_out(f"the recorded rows of {suite} are")


def recorded_policies(suite: Suite, folder: Path = RECORDED_FOLDER) -> list[str]:
    """Return the names of the policies with recorded rows, in the order of the registry."""
    order, source = list(list_policies()), suite.source[0]
    places = (folder, RECORD / folder.name) if folder == RECORDED_FOLDER else (folder,)
    names = {file.stem for place in places for file in (place / source).glob("*.npz")}
    return sorted(names, key=lambda name: (order.index(name) if name in order else len(order), name))


def read_recorded(suite: Suite, policy: str, folder: Path = RECORDED_FOLDER) -> list[Run]:
    """Return the recorded runs of a policy, cell by cell, without a check of its fingerprint.

    Raises:
        OSError: there is no such file.
        ValueError: the file is damaged, or belongs to another suite or policy.
    """
    source, source_hash = suite.source
    with reading(found(folder, f"{source}/{policy}.npz")) as stored:
        record, rows = stored.record, stored.arrays["measures"].astype(np.float64)
        bounds = np.cumsum([0, *record["episodes"]]).tolist()
        cells = suite.cells_in(record.get("speed_ranges", SPEED_RANGES))
        when = Recorded(record["date"], record["versions"])
        runs = []
        for i, (cell, a, b) in enumerate(zip(cells, bounds[:-1], bounds[1:], strict=True)):
            *values, failed = rows[:, a:b]
            measures: Any = (*values, failed > 0)
            run = Run(policy, cell.scenario, cell.hash, Measures(*measures), recorded=when)
            seconds, decision = float(record["seconds"][i]), float(record["decision_seconds"][i])
            runs.append(replace(run, seconds=seconds, decision_seconds=decision))
        owner, text_hash = str(record["policy"]), str(record["suite_hash"])
        if rows.shape != (len(fields(Measures)), bounds[-1]):
            raise ValueError(f"its rows have shape {rows.shape}")
    if owner != policy:
        raise ValueError(f"its file has the rows of {owner}")
    if text_hash != source_hash:
        raise ValueError(f"its rows belong to another {source}, of hash {text_hash[:12]}")
    return runs


def stored_measures(measures: Measures) -> NDArray[np.float32]:
    """Return metrics as they are in files, in single precision or with `DIGITS`, shape (metrics, M)."""
    rows = []
    for field in fields(Measures):
        row = getattr(measures, field.name).astype(np.float64)
        if (digits := DIGITS.get(field.name)) is not None:
            fraction, exponent = np.frexp(row)
            row = np.ldexp(np.round(np.ldexp(fraction, digits)), exponent - digits)
        rows.append(row)
    return np.stack(rows).astype(np.float32)


def _key(suite: Suite, policy: str) -> str:
    """Return the key of a policy's rows in `STAMPS_FILE`."""
    return f"{suite.source[0]}/{policy}"


def _stamp(suite: Suite, policy: str, folder: Path) -> list[str]:
    """Return the hash of a file of rows, and the current fingerprints of the policy and the simulator."""
    rows = found(folder, f"{_key(suite, policy)}.npz").read_bytes()
    return [hashlib.sha256(rows).hexdigest(), fingerprint(policy), simulator_fingerprint()]


def _stamps(folder: Path) -> dict[str, list[str]]:
    try:
        record: dict[str, list[str]] = json.loads((folder / STAMPS_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        record = {}
    return record


def stamp_recorded(suite: Suite, policy: str, folder: Path = RECORDED_FOLDER) -> None:
    """Write the current hash and fingerprints of a policy's rows to `STAMPS_FILE`."""
    stamps = _stamps(folder) | {_key(suite, policy): _stamp(suite, policy, folder)}
    write_atomically(folder / STAMPS_FILE, json_text(dict(sorted(stamps.items()))))


def speed_ranges_of(policy: str) -> tuple[str, ...]:
    """Return the speed ranges of a policy; for an agent, those of the scenarios on which it was trained."""
    folder = agent_folder(bare_name(policy))
    own = {speed_range_of(scenario) for scenario in Agent.load(folder).scenarios} if folder else set()
    return tuple(speed_range for speed_range in SPEED_RANGES if speed_range in own) or SPEED_RANGES


def save_recorded(
    suite: Suite,
    runs: Sequence[Run],
    versions: Mapping[str, str],
    folder: Path = RECORDED_FOLDER,
    speed_ranges: Sequence[str] = SPEED_RANGES,
) -> None:
    """Write the file of a policy's runs: one for each cell of a suite, or for each cell of some speed ranges.

    Raises:
        ValueError: a run failed, or is missing.
    """
    policy, own = runs[0].policy, {run.scenario.name: run for run in runs if run.measures is not None}
    cases = [cell.scenario.name for cell in suite.cells_in(speed_ranges)]
    if missing := [case for case in cases if case not in own]:
        raise ValueError(f"{policy} has no result in {', '.join(missing)}")
    ordered = [own[case] for case in cases]
    parts = [run.measures for run in ordered if run.measures is not None]
    name, digest = suite.source
    record = {
        "suite": name,
        "suite_hash": digest,
        "policy": policy,
        "date": datetime.now(timezone.utc).date().isoformat(),
        "versions": dict(versions),
        "speed_ranges": list(speed_ranges),
        "episodes": [len(part) for part in parts],
        "seconds": [run.seconds for run in ordered],
        "decision_seconds": [run.decision_seconds for run in ordered],
    }
    write(found(folder, f"{name}/{policy}.npz"), Stored(record, {"measures": stored_measures(Measures.joined(parts))}))
    stamp_recorded(suite, policy, folder)
