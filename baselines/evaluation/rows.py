"""Stores finished runs on disk, one file each, so that an interrupted evaluation can be resumed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.metrics import Measures, Track
from baselines.evaluation.runner import Run
from baselines.evaluation.store import Stored, reading, write

_PLAIN = ("policy", "fingerprint", "cell_hash", "seconds", "decision_seconds", "slowest_decision", "simulator")
"""Fields of a run that are stored unchanged."""
_TRACK = fields(Track)  # each is stored as an array


@dataclass(frozen=True)
class RowStore:
    """A folder of finished runs, each in a file named by its key. Failed runs are not stored, so they run again."""

    folder: Path

    def save(self, run: Run) -> None:
        """Write a finished run atomically; do nothing for a failed one."""
        if run.measures is None or not run.tracks or run.bands is None:
            return
        record = {name: getattr(run, name) for name in _PLAIN}
        record |= {"scenario": run.scenario.to_dict(), "warnings": list(run.warnings), "tracks": len(run.tracks)}
        arrays = {f"measures_{f.name}": getattr(run.measures, f.name) for f in fields(Measures)}
        arrays |= {f"track{i}_{f.name}": getattr(track, f.name) for i, track in enumerate(run.tracks) for f in _TRACK}
        write(self._file(run.key), Stored(record, {**arrays, "bands": run.bands}))

    def load(self, key: str) -> Run | None:
        """Return the run with a key; None if there is no such file, or if it is damaged or has another key."""
        try:
            with reading(self._file(key)) as stored:
                record, arrays = stored.record, stored.arrays
                run = Run(
                    **{name: record[name] for name in _PLAIN},
                    scenario=Scenario.from_dict(record["scenario"]),
                    measures=Measures(*(arrays[f"measures_{f.name}"] for f in fields(Measures))),
                    bands=arrays["bands"],
                    tracks=tuple(_track(arrays, i) for i in range(record["tracks"])),
                    warnings=tuple(map(str, record["warnings"])),
                )
                return run if run.key == key else None
        except (OSError, ValueError):
            return None

    def _file(self, key: str) -> Path:
        return self.folder / f"{key}.npz"


def _track(arrays: Mapping[str, NDArray[Any]], i: int) -> Track:
    return Track(*(arrays[f"track{i}_{f.name}"] for f in _TRACK))
