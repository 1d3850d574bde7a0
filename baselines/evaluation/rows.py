"""Finished runs on disk, one file each, so that an interrupted evaluation can go on."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from auv_gym.scenario import Scenario
from baselines.evaluation.metrics import Measures, Track
from baselines.evaluation.runner import Run
from baselines.tools.files import write_atomically


@dataclass(frozen=True)
class RowStore:
    """A folder of finished runs, each in a file named by its key. Failed runs are not kept: they are tried again."""

    folder: Path

    def save(self, run: Run) -> None:
        """Keep a run; no reader ever sees half of it."""
        if run.measures is not None:
            self.folder.mkdir(exist_ok=True)
            write_atomically(self._file(run.key), _packed(run))

    def load(self, key: str) -> Run | None:
        """Return the run of a key; None if there is none, or its file is damaged."""
        try:
            return unpacked(self._file(key).read_bytes())
        except (OSError, ValueError, KeyError, zipfile.BadZipFile):
            return None

    def _file(self, key: str) -> Path:
        return self.folder / f"{key}.npz"


def _packed(run: Run) -> bytes:
    assert run.measures is not None
    assert run.track is not None
    assert run.bands is not None
    record = {
        "policy": run.policy,
        "fingerprint": run.fingerprint,
        "scenario": run.scenario.to_dict(),
        "cell_hash": run.cell_hash,
        "seconds": run.seconds,
        "decision_seconds": run.decision_seconds,
        "warnings": run.warnings,
    }
    arrays: dict[str, Any] = {f"measures_{f.name}": getattr(run.measures, f.name) for f in fields(Measures)}
    arrays |= {f"track_{f.name}": getattr(run.track, f.name) for f in fields(Track)}
    buffer = io.BytesIO()
    np.savez(buffer, record=np.array(json.dumps(record)), bands=run.bands, **arrays)
    return buffer.getvalue()


def unpacked(content: bytes) -> Run:
    """Return the run of a file's content."""
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        record = json.loads(str(arrays["record"]))
        return Run(
            record["policy"],
            Scenario.from_dict(record["scenario"]),
            record["cell_hash"],
            Measures(*(arrays[f"measures_{f.name}"] for f in fields(Measures))),
            arrays["bands"],
            Track(*(arrays[f"track_{f.name}"] for f in fields(Track))),
            record["seconds"],
            record["decision_seconds"],
            warnings=tuple(record["warnings"]),
            fingerprint=record["fingerprint"],
        )
