"""Result files: the results of policies in cells, episode by episode.

They serve to resume an evaluation, to keep the results of frozen suites and of studies, and to show results to others.
A file is an .npz with a JSON record and arrays. Metrics have an entry for each episode, run after run.
"""

from __future__ import annotations

import io
import itertools
import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.scenarios.records import guarded
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.metrics import Measures, Track
from baselines.evaluation.runner import Recorded, Run
from baselines.tools.files import read_bytes, write_atomically

FORMAT = 1
"""Version of the file format."""
_LARGEST = 2**27  # [bytes] largest uncompressed size of a file
_RECORD = "record"  # name of the array with the JSON text
_PLAIN = (
    "policy", "cell_hash", "seconds", "decision_seconds", "slowest_decision", "warnings", "fingerprint", "simulator",
)  # fmt: skip
"""Fields of a run that are stored unchanged."""


@dataclass(frozen=True)
class ResultFile:
    """Runs of policies in cells, with their origin."""

    runs: tuple[Run, ...]
    suite: str = ""  # name of the frozen suite; "" for other scenarios
    suite_hash: str = ""  # of the suite, or of all episodes
    command: str = ""  # that made the file

    def write(self, file: Path, single: bool = False) -> None:
        """Write the file atomically; runs without results are left out.

        Args:
            file: the file.
            single: store metrics in single precision.

        Raises:
            OSError: it cannot be written.
        """
        done = [run for run in self.runs if run.measures is not None]
        scenarios = {run.scenario.name: run.scenario.to_dict() for run in done}
        record = {"format": FORMAT, "suite": self.suite, "suite_hash": self.suite_hash, "command": self.command}
        record |= {"scenarios": scenarios, "runs": [_record_of(run) for run in done]}
        table = np.array([np.concatenate([[], *(getattr(run.measures, f.name) for run in done)]) for f in _METRICS])
        arrays = {"measures": table.astype(np.float32 if single else np.float64)}
        arrays |= {f"bands_{i}": run.bands for i, run in enumerate(done) if run.bands is not None}
        arrays |= {
            f"tracks_{i}": np.concatenate([t.rows for t in run.tracks]) for i, run in enumerate(done) if run.tracks
        }
        buffer = io.BytesIO()
        contents: dict[str, Any] = {**arrays, _RECORD: np.array(json.dumps(record))}
        np.savez_compressed(buffer, **contents)
        write_atomically(file, buffer.getvalue())

    @classmethod
    def read(cls, file: Path) -> ResultFile:
        """Return the content of a file after a check of its structure; the file may be a stranger's.

        Raises:
            OSError: it cannot be read.
            ValueError: it is damaged, or of another version.
        """
        hint = "; results.npz beside it is one" if file.name in ("results.json", "results.csv") else ""
        with guarded(f"{file} is no file of results{hint}"):
            data = io.BytesIO(read_bytes(file))
            if sum(entry.file_size for entry in zipfile.ZipFile(data).infolist()) > _LARGEST:
                raise ValueError(f"it is larger than {_LARGEST} bytes unpacked")
            with np.load(data, allow_pickle=False) as archive:
                arrays = dict(archive.items())
            record = json.loads(str(arrays.pop(_RECORD)))
            if record["format"] != FORMAT:
                raise ValueError(f"its format is {record['format']}; this version reads {FORMAT}")
            scenarios = {name: Scenario.from_dict(entry) for name, entry in record["scenarios"].items()}
            entries, table = record["runs"], arrays["measures"].astype(np.float64)
            bounds = np.cumsum([0, *(entry["episodes"] for entry in entries)]).tolist()
            if table.shape != (len(_METRICS), bounds[-1]):
                raise ValueError(f"its metrics have the shape {table.shape}")
            parts = zip(entries, itertools.pairwise(bounds), strict=True)
            runs = tuple(_run(entry, scenarios, table[:, a:b], arrays, i) for i, (entry, (a, b)) in enumerate(parts))
            return cls(runs, record["suite"], record["suite_hash"], record["command"])

    def of(self, policy: str) -> list[Run]:
        """Return the runs of a policy."""
        return [run for run in self.runs if run.policy == policy]

    def with_runs(self, runs: Sequence[Run]) -> ResultFile:
        """Return the file with the runs of one policy in place of its earlier ones."""
        others = tuple(run for run in self.runs if run.policy != runs[0].policy)
        return ResultFile((*others, *runs), self.suite, self.suite_hash, self.command)


_METRICS = fields(Measures)


def _record_of(run: Run) -> dict[str, Any]:
    record = {name: getattr(run, name) for name in _PLAIN}
    tracks = [len(track) for track in run.tracks]
    recorded = asdict(run.recorded or Recorded.now())
    return {**record, **recorded, "scenario": run.scenario.name, "episodes": len(run.measures or ()), "tracks": tracks}


def _run(
    entry: Mapping[str, Any], scenarios: Mapping[str, Scenario], part: NDArray[Any], arrays: Mapping[str, Any], i: int
) -> Run:
    """Return run i of a file from its JSON values and its metrics."""
    *values, failed = part
    measures: Any = (*values, failed > 0)
    rows = np.split(arrays[f"tracks_{i}"], np.cumsum(entry["tracks"])[:-1]) if entry["tracks"] else ()
    return Run(
        **{name: entry[name] for name in _PLAIN if name != "warnings"},
        scenario=scenarios[entry["scenario"]],
        measures=Measures(*measures),
        bands=arrays.get(f"bands_{i}"),
        tracks=tuple(Track(r) for r in rows),
        warnings=tuple(entry["warnings"]),
        recorded=Recorded(entry["date"], entry["versions"]),
    )
