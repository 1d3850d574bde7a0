"""What policies did in the frozen suites when they were last run: rows to compare with, without waiting for slow ones.

One file for each suite, NAME.npz, made by `python -m baselines.evaluation.suites record NAME --policy P ...`. It counts
only for the suite of the hash that it names.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np

from baselines.evaluation.files import write_atomically
from baselines.evaluation.metrics import Measures
from baselines.evaluation.runner import Run
from baselines.evaluation.suites import Suite

FOLDER = Path(__file__).parent


def load(suite: Suite, folder: Path = FOLDER) -> list[Run]:
    """Return the recorded runs of a suite, policy by policy and cell by cell; none if they are of another hash."""
    record, arrays = _read(folder / f"{suite.name}.npz", suite.hash)
    bounds = np.cumsum([0, *(len(cell.episodes) for cell in suite.cells)]).tolist()
    runs = []
    for policy, entry in record["policies"].items():
        for i, cell in enumerate(suite.cells):
            rows = arrays[policy][:, bounds[i] : bounds[i + 1]].astype(np.float64)
            values: list[Any] = [*rows[:-1], rows[-1] > 0]
            measures = Measures(*values)
            seconds, decision = entry["seconds"][i], entry["decision_seconds"][i]
            run = Run(policy, cell.scenario, cell.hash, measures, seconds=seconds, decision_seconds=decision)
            runs.append(replace(run, recorded=entry["date"]))
    return runs


def save(suite: Suite, runs: Sequence[Run], versions: Mapping[str, str], folder: Path = FOLDER) -> None:
    """Add the runs of policies in all cells of a suite to its file, in place of what is there of the same policies.

    Raises:
        ValueError: a run failed, or is missing.
    """
    file = folder / f"{suite.name}.npz"
    record, arrays = _read(file, suite.hash)
    for policy in dict.fromkeys(run.policy for run in runs):
        own = {run.cell_hash: run for run in runs if run.policy == policy and run.measures is not None}
        if missing := [cell.scenario.name for cell in suite.cells if cell.hash not in own]:
            raise ValueError(f"{policy} has no result in {', '.join(missing)}")
        ordered = [own[cell.hash] for cell in suite.cells]
        measures = Measures.joined([run.measures for run in ordered if run.measures is not None])
        arrays[policy] = np.stack([getattr(measures, f.name) for f in fields(Measures)]).astype(np.float32)
        record["policies"][policy] = {
            "date": datetime.now(timezone.utc).date().isoformat(),
            "versions": dict(versions),
            "seconds": [run.seconds for run in ordered],
            "decision_seconds": [run.decision_seconds for run in ordered],
        }
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **{"": np.array(json.dumps(record)), **arrays})
    write_atomically(file, buffer.getvalue())


def _read(file: Path, suite_hash: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the record and the arrays of a file, empty if there is none for this hash."""
    empty: dict[str, Any] = {"suite_hash": suite_hash, "policies": {}}
    if not file.exists():
        return empty, {}
    with np.load(file, allow_pickle=False) as arrays:
        record: dict[str, Any] = json.loads(str(arrays[""]))
        if record["suite_hash"] != suite_hash:
            return empty, {}
        return record, {policy: arrays[policy] for policy in record["policies"]}
