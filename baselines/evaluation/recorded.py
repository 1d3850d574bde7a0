"""What policies did in the frozen suites when they were last run: rows to compare with, without waiting for slow ones.

A file SUITE/POLICY.npz each, made by `python -m research suites record SUITE --policy POLICY ...`. It names the suite's
hash. `STAMPS_FILE` has, for each file, its own hash and the fingerprints of the policy and the simulator that made it.
Where the suite, the file or the policy is another one now, the rows do not count, until they are recorded again or
`verify` finds that the policy still gives the same numbers. Where the simulator is another one, they count, and a note
says so. A slow policy may have run the first episodes of each cell only, an agent its regime's cells.
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
RECORDED_SUITES = ("benchmark-v1", "ood-v1", "unmodelled-v1", "deep-v1", "sealed-v1", "vehicles-v1")
"""The suites that rows are recorded of."""
STAMPS_FILE = "fingerprints.json"  # file of the fingerprints of what was recorded


DIGITS = {"rmse": 8, "effort": 11, "smoothness": 13, "total_reward": 8}
"""Binary digits that are kept of measures of which nothing but means over episodes is told; no printed figure needs
more. Of the others all that single precision has."""


@dataclass(frozen=True)
class Found:
    """The recorded rows of a suite."""

    runs: tuple[Run, ...]  # policy by policy in the order of the registry, cell by cell
    refused: dict[str, str]  # why the rows of a policy do not count, by its name
    note: str = ""  # says that the simulator has changed since, if it has


def load_recorded(suite: Suite, folder: Path = RECORDED_FOLDER) -> Found:
    """Return the recorded runs of a suite that count."""
    runs: list[Run] = []
    refused: dict[str, str] = {}
    stamps, simulators = _stamps(folder), set()
    for policy in recorded_policies(suite, folder):
        found = _counted(suite, policy, stamps, folder)
        if isinstance(found, str):
            refused[policy] = found
        else:
            runs += found
            simulators.add(tuple(stamps[_key(suite, policy)][2:]))
    changed = simulators - {(simulator_fingerprint(),)}
    note = f"the code of the simulator has changed since rows of {suite.name} were recorded" if changed else ""
    return Found(tuple(runs), refused, note)


def _counted(suite: Suite, policy: str, stamps: Mapping[str, list[str]], folder: Path) -> list[Run] | str:
    """Return the runs that are kept of a policy, or why they do not count."""
    try:
        own = read_recorded(suite, policy, folder)
        if stamps.get(_key(suite, policy), [])[:2] != _stamp(suite, policy, folder)[:2]:
            return "the policy's files have changed since, or the rows have"
    except (OSError, ValueError) as error:
        return str(error)
    return own


def missing(suite: str, folder: Path = RECORDED_FOLDER) -> str | None:
    """Return why no rows of a suite are here that the sources have; None where they are here, or nowhere."""
    if checkout() is not None or suite not in RECORDED_SUITES or (folder / suite).is_dir():
        return None
    return left_out(f"the recorded rows of {suite} are")


def recorded_policies(suite: Suite, folder: Path = RECORDED_FOLDER) -> list[str]:
    """Return the names of the policies that rows are kept of, in the order of the registry."""
    order, source = list(list_policies()), suite.source[0]
    places = (folder, RECORD / folder.name) if folder == RECORDED_FOLDER else (folder,)
    names = {file.stem for place in places for file in (place / source).glob("*.npz")}
    return sorted(names, key=lambda name: (order.index(name) if name in order else len(order), name))


def read_recorded(suite: Suite, policy: str, folder: Path = RECORDED_FOLDER) -> list[Run]:
    """Return the runs that are kept of a policy, cell by cell, whatever it is made of now.

    Raises:
        OSError: there is no such file.
        ValueError: it is damaged, of another suite or of another policy.
    """
    source, source_hash = suite.source
    with reading(found(folder, f"{source}/{policy}.npz")) as stored:
        record, rows = stored.record, stored.arrays["measures"].astype(np.float64)
        bounds = np.cumsum([0, *record["episodes"]]).tolist()
        cells, when = (
            suite.cells_in(record.get("speed_ranges", SPEED_RANGES)),
            Recorded(record["date"], record["versions"]),
        )
        runs = []
        for i, (cell, a, b) in enumerate(zip(cells, bounds[:-1], bounds[1:], strict=True)):
            *values, failed = rows[:, a:b]
            measures: Any = (*values, failed > 0)
            run = Run(policy, cell.scenario, cell.hash, Measures(*measures), recorded=when)
            seconds, decision = float(record["seconds"][i]), float(record["decision_seconds"][i])
            runs.append(replace(run, seconds=seconds, decision_seconds=decision))
        kept, text_hash = str(record["policy"]), str(record["suite_hash"])
        if rows.shape != (len(fields(Measures)), bounds[-1]):
            raise ValueError(f"its rows have shape {rows.shape}")
    if kept != policy:
        raise ValueError(f"its file holds the rows of {kept}")
    if text_hash != source_hash:
        raise ValueError(f"another {source}, of hash {text_hash[:12]}")
    return runs


def stored_measures(measures: Measures) -> NDArray[np.float32]:
    """Return measures as files hold them, in single precision or with `DIGITS`, shape (measures, M)."""
    rows = []
    for field in fields(Measures):
        row = getattr(measures, field.name).astype(np.float64)
        if (digits := DIGITS.get(field.name)) is not None:
            fraction, exponent = np.frexp(row)
            row = np.ldexp(np.round(np.ldexp(fraction, digits)), exponent - digits)
        rows.append(row)
    return np.stack(rows).astype(np.float32)


def _key(suite: Suite, policy: str) -> str:
    """Return the name of a file of rows among the stamps."""
    return f"{suite.source[0]}/{policy}"


def _stamp(suite: Suite, policy: str, folder: Path) -> list[str]:
    """Return the hash of a file of rows, and the fingerprints of the policy and the simulator as they are now."""
    rows = found(folder, f"{_key(suite, policy)}.npz").read_bytes()
    return [hashlib.sha256(rows).hexdigest(), fingerprint(policy), simulator_fingerprint()]


def _stamps(folder: Path) -> dict[str, list[str]]:
    try:
        record: dict[str, list[str]] = json.loads((folder / STAMPS_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        record = {}
    return record


def stamp_recorded(suite: Suite, policy: str, folder: Path = RECORDED_FOLDER) -> None:
    """Write down that the rows of a policy are what it does now."""
    stamps = _stamps(folder) | {_key(suite, policy): _stamp(suite, policy, folder)}
    write_atomically(folder / STAMPS_FILE, json_text(dict(sorted(stamps.items()))))


def speed_ranges_of(policy: str) -> tuple[str, ...]:
    """Return the regimes that a policy is made for: an agent's are those of the scenarios that it was trained on."""
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
    """Write the file of one policy's runs, one in each cell of a suite, or of some of its regimes.

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
