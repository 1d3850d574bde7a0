"""The files of a study: steady-state errors of every episode and seed, learning curves, and the command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array
from baselines.evaluation import suites
from baselines.evaluation.metrics import Ended, Measures
from baselines.evaluation.runner import Run
from baselines.evaluation.score import capped, count_failures, error_cap, in_paper_metres
from baselines.evaluation.store import Stored, reading, write
from baselines.tools.files import versions
from research import DATA

STUDIES_FOLDER = DATA / "studies"
_CURVE = ("timesteps", "seconds", "score")
"""Columns of a learning curve."""


@dataclass(frozen=True)
class InSuite:
    """Results of S agents in the M episodes of each cell of a suite."""

    hash: str  # hash of the suite
    cells: tuple[str, ...]  # names of the scenarios
    steady_rmses: tuple[Array, ...]  # steady-state RMSE [m of the paper's vehicle], shape (S, M) for each cell
    failed: tuple[NDArray[np.bool_], ...]  # whether an episode ended beyond `lost_distance`, shape (S, M) for each cell
    effort: Array  # mean over all episodes, shape (S,); see `metrics`
    smoothness: Array  # mean over all episodes, shape (S,); see `metrics`
    decision_seconds: float  # mean time of a decision for one vehicle

    @classmethod
    def of(cls, suite: str, runs: Sequence[Sequence[Run]]) -> InSuite:
        """Return the results of the runs of each agent in each cell.

        Raises:
            ValueError: a run failed.
        """
        if broken := [run for own in runs for run in own if run.measures is None]:
            raise ValueError(f"{broken[0].policy} failed in {broken[0].scenario.name}: {broken[0].error}")
        measures = [[in_paper_metres(r.measures, r.scenario) for r in own if r.measures is not None] for own in runs]
        whole = [Measures.joined(own) for own in measures]
        by_cell = list(zip(*measures, strict=True))
        return cls(
            suites.load_suite(suite).hash,
            tuple(run.scenario.name for run in runs[0]),
            tuple(np.stack([m.steady_rmse for m in cell]) for cell in by_cell),
            tuple(np.stack([m.failed for m in cell]) for cell in by_cell),
            np.array([m.effort.mean() for m in whole]),
            np.array([m.smoothness.mean() for m in whole]),
            float(np.mean([run.decision_seconds for own in runs for run in own])),
        )

    def capped(self) -> tuple[Array, ...]:
        """Return the steady-state errors with those of failures set to `score.ERROR_CAPS`."""
        return tuple(capped(*cell) for cell in self._ended)

    def count_failures(self) -> int:
        """Return the number of failures of all seeds, see `score.has_failed`."""
        return sum(count_failures(*cell) for cell in self._ended)

    @property
    def _ended(self) -> list[tuple[Ended, float]]:
        """Steady-state errors and failures of each cell, and its error cap [m]."""
        parts = zip(self.steady_rmses, self.failed, map(error_cap, self.cells), strict=True)
        return [(Ended(steady_rmse, failed), cap) for steady_rmse, failed, cap in parts]


@dataclass(frozen=True)
class Study:
    """Agents that differ only in the training seed."""

    about: str
    speed_range: str
    command: str
    date: str  # ISO 8601
    versions: Mapping[str, str]
    suites: Mapping[str, InSuite]
    curves: tuple[Array, ...]  # learning curve of each seed, columns `_CURVE`

    @classmethod
    def of(
        cls,
        about: str,
        speed_range: str,
        command: str,
        runs: Mapping[str, Sequence[Sequence[Run]]],
        curves: Sequence[Sequence[Mapping[str, float]]],
    ) -> Study:
        """Return the study of agents from their runs, by suite, and their learning curves.

        Raises:
            ValueError: a run failed.
        """
        return cls(
            about,
            speed_range,
            command,
            datetime.now(timezone.utc).date().isoformat(),
            versions(),
            {name: InSuite.of(name, own) for name, own in runs.items()},
            tuple(np.array([[row[key] for key in _CURVE] for row in rows]) for rows in curves),
        )


def save_study(name: str, study: Study, folder: Path = STUDIES_FOLDER) -> None:
    """Write a study to its file."""
    arrays: dict[str, Any] = {f"curve/{i}": curve for i, curve in enumerate(study.curves)}
    record: dict[str, Any] = {key: getattr(study, key) for key in ("about", "speed_range", "command", "date")}
    record |= {"versions": dict(study.versions), "suites": {}}
    for suite, found in study.suites.items():
        record["suites"][suite], own = _pack(suite, found)
        arrays |= own
    write(folder / f"{name}.npz", Stored(record, arrays))


def _pack(suite: str, found: InSuite) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the results in a suite as JSON values and named arrays; `_unpack` is the inverse."""
    entry = asdict(found)
    arrays: dict[str, NDArray[Any]] = {}
    for key in ("steady_rmses", "failed"):
        kind = np.float32 if key == "steady_rmses" else np.bool_
        arrays[f"{suite}/{key}"] = np.concatenate(entry.pop(key), axis=1).astype(kind)
    lengths = [steady_rmse.shape[1] for steady_rmse in found.steady_rmses]
    entry |= {"effort": found.effort.tolist(), "smoothness": found.smoothness.tolist(), "lengths": lengths}
    return entry, arrays


def _unpack(suite: str, packed_entry: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> InSuite | None:
    """Return the results in a suite from JSON values and arrays; None if the suite has changed since."""
    entry = dict(packed_entry)
    if entry["hash"] != suites.load_suite(suite).hash:
        return None
    bounds = np.cumsum(entry.pop("lengths"))[:-1]
    steady_rmses, failed = (
        tuple(np.split(arrays[f"{suite}/{key}"], bounds, axis=1)) for key in ("steady_rmses", "failed")
    )
    values: dict[str, Any] = {key: np.array(entry.pop(key)) for key in ("effort", "smoothness")}
    entry["cells"] = tuple(entry["cells"])
    return InSuite(steady_rmses=tuple(t.astype(np.float64) for t in steady_rmses), failed=failed, **entry, **values)


def load_studies(folder: Path = STUDIES_FOLDER) -> dict[str, Study]:
    """Return the recorded studies, by name, without results in suites that have changed since.

    Raises:
        ValueError: a file is damaged.
    """
    return {file.stem: _load(file) for file in sorted(folder.glob("*.npz"))}


def _load(file: Path) -> Study:
    with reading(file) as stored:
        record, arrays = dict(stored.record), stored.arrays
        all_of = {suite: _unpack(suite, entry, arrays) for suite, entry in record.pop("suites").items()}
        found = {suite: own for suite, own in all_of.items() if own is not None}
        curves = [arrays[f"curve/{i}"] for i in range(sum(name.startswith("curve/") for name in arrays))]
        return Study(**record, suites=found, curves=tuple(curves))
