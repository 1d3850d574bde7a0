"""What policies did in the frozen suites when they were last run: rows to compare with, without waiting for slow ones.

A file SUITE/POLICY.npz each, made by `python -m baselines.evaluation.suites record SUITE --policy POLICY ...`. It names
the suite's hash and the fingerprint of the policy's files; where one of them is another now, its rows do not count. A
slow policy may have run the first episodes of each cell only, and an agent the cells of its regime.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.presets import REGIMES
from baselines import list_policies
from baselines.agents.agent import Agent
from baselines.agents.loading import AGENTS, FADING, fingerprint, shipped_agents
from baselines.evaluation.metrics import Measures
from baselines.evaluation.runner import Cell, Recorded, Run
from baselines.evaluation.score import regime_of
from baselines.evaluation.suites import Suite
from baselines.tools.files import write_atomically

FOLDER = Path(__file__).parent / "data" / "recorded"


@dataclass(frozen=True)
class Found:
    """The recorded rows of a suite."""

    runs: tuple[Run, ...]  # policy by policy in the order of the registry, cell by cell
    refused: dict[str, str]  # why the rows of a policy do not count, by its name


def load(suite: Suite, folder: Path = FOLDER) -> Found:
    """Return the recorded runs of a suite."""
    runs: list[Run] = []
    refused: dict[str, str] = {}
    files = {file.stem: file for file in (folder / suite.name).glob("*.npz")}
    order = list(list_policies())
    for policy in sorted(files, key=lambda name: (order.index(name) if name in order else len(order), name)):
        try:
            record, rows = _read(files[policy])
            if (reason := _reason(record, suite)) is None:
                runs += _runs(record, rows, suite)
        except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
            reason = f"cannot be read: {error}"
        if reason is not None:
            refused[policy] = reason
    return Found(tuple(runs), refused)


def _reason(record: Mapping[str, Any], suite: Suite) -> str | None:
    """Return why a record does not count, if so."""
    if record["suite_hash"] != suite.hash:
        return f"another {suite.name}, of hash {record['suite_hash'][:12]}"
    if record["fingerprint"] != fingerprint(record["policy"]):
        return "the policy's files have changed since"
    return None


def _read(file: Path) -> tuple[dict[str, Any], NDArray[np.float32]]:
    with np.load(file, allow_pickle=False) as arrays:
        return json.loads(str(arrays["record"])), arrays["measures"]


def _runs(record: Mapping[str, Any], rows: NDArray[np.float32], suite: Suite) -> list[Run]:
    bounds = np.cumsum([0, *record["episodes"]]).tolist()
    when, runs = Recorded(record["date"], record["versions"]), []
    for i, cell in enumerate(_cells(suite, record.get("regimes", REGIMES))):
        *values, lost = rows[:, bounds[i] : bounds[i + 1]].astype(np.float64)
        measures: Any = (*values, lost > 0)
        run = Run(record["policy"], cell.scenario, cell.hash, Measures(*measures), recorded=when)
        times = {name: record[name][i] for name in ("seconds", "decision_seconds")}
        runs.append(replace(run, fingerprint=record["fingerprint"], **times))
    return runs


def regimes_of(policy: str) -> tuple[str, ...]:
    """Return the regimes that a policy by name is made for: an agent's are those of its scenarios."""
    name = policy.removesuffix(FADING)
    if name not in shipped_agents():
        return REGIMES
    own = {regime_of(scenario) for scenario in Agent.load(AGENTS / name).scenarios}
    return tuple(regime for regime in REGIMES if regime in own) or REGIMES


def _cells(suite: Suite, regimes: Sequence[str]) -> list[Cell]:
    """Return a suite's cells in these regimes."""
    return [cell for cell in suite.cells if regime_of(cell.scenario.name) in regimes]


def save(
    suite: Suite,
    runs: Sequence[Run],
    versions: Mapping[str, str],
    folder: Path = FOLDER,
    regimes: Sequence[str] = REGIMES,
) -> None:
    """Write the file of one policy's runs, one in each cell of a suite, or of some of its regimes.

    Raises:
        ValueError: a run failed, or is missing.
    """
    policy, own = runs[0].policy, {run.scenario.name: run for run in runs if run.measures is not None}
    names = [cell.scenario.name for cell in _cells(suite, regimes)]
    if missing := [name for name in names if name not in own]:
        raise ValueError(f"{policy} has no result in {', '.join(missing)}")
    ordered = [own[name] for name in names]
    parts = [run.measures for run in ordered if run.measures is not None]
    measures = Measures.joined(parts)
    record = {
        "suite": suite.name,
        "suite_hash": suite.hash,
        "policy": policy,
        "fingerprint": runs[0].fingerprint,
        "date": datetime.now(timezone.utc).date().isoformat(),
        "versions": dict(versions),
        "regimes": list(regimes),
        "episodes": [len(part) for part in parts],
        "seconds": [run.seconds for run in ordered],
        "decision_seconds": [run.decision_seconds for run in ordered],
    }
    rows = np.stack([getattr(measures, f.name) for f in fields(Measures)]).astype(np.float32)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, record=np.array(json.dumps(record)), measures=rows)
    (folder / suite.name).mkdir(parents=True, exist_ok=True)
    write_atomically(folder / suite.name / f"{policy}.npz", buffer.getvalue())
