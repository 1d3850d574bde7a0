"""The record of a study: steady-state errors of every episode and seed, learning curves, and how it was made."""

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
    """What S agents do in the M episodes of a suite's cells."""

    hash: str  # of the suite
    cells: tuple[str, ...]  # names of their scenarios
    steady_rmses: tuple[Array, ...]  # steady-state RMSE [m of the paper's vehicle], shape (S, M) for each cell
    failed: tuple[NDArray[np.bool_], ...]  # ended beyond `lost_distance`, shape (S, M) for each cell
    effort: Array  # mean over all episodes, shape (S,); see `metrics`
    smoothness: Array  # mean over all episodes, shape (S,); see `metrics`
    decision_seconds: float  # of an agent for one vehicle and control step

    @classmethod
    def of(cls, suite: str, runs: Sequence[Sequence[Run]]) -> InSuite:
        """Return what the runs of each agent in each cell tell.

        Raises:
            ValueError: one failed.
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
        """Return the steady-state errors, those of failures cut at `score.ERROR_CAPS`."""
        return tuple(capped(*cell) for cell in self._ended)

    def count_failures(self) -> int:
        """Return the number of failures of all seeds, see `score.has_failed`."""
        return sum(count_failures(*cell) for cell in self._ended)

    @property
    def _ended(self) -> list[tuple[Ended, float]]:
        """The ends of the episodes of each cell, and their error cap [m]."""
        parts = zip(self.steady_rmses, self.failed, map(error_cap, self.cells), strict=True)
        return [(Ended(steady_rmse, failed), cap) for steady_rmse, failed, cap in parts]


@dataclass(frozen=True)
class Study:
    """Agents that differ in the training seed alone."""

    about: str
    speed_range: str
    command: str
    date: str  # ISO 8601
    versions: Mapping[str, str]
    suites: Mapping[str, InSuite]
    curves: tuple[Array, ...]  # of each seed, columns `_CURVE`

    @classmethod
    def of(
        cls,
        about: str,
        speed_range: str,
        command: str,
        runs: Mapping[str, Sequence[Sequence[Run]]],
        curves: Sequence[Sequence[Mapping[str, float]]],
    ) -> Study:
        """Return the study of what agents did, suite by suite, and of their learning curves.

        Raises:
            ValueError: an agent failed somewhere.
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
        record["suites"][suite], own = packed_study(suite, found)
        arrays |= own
    write(folder / f"{name}.npz", Stored(record, arrays))


def packed_study(suite: str, found: InSuite) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return what agents do in a suite as plain JSON and arrays by name, see `unpacked_study`."""
    entry = asdict(found)
    arrays: dict[str, NDArray[Any]] = {}
    for key in ("steady_rmses", "failed"):
        kind = np.float32 if key == "steady_rmses" else np.bool_
        arrays[f"{suite}/{key}"] = np.concatenate(entry.pop(key), axis=1).astype(kind)
    lengths = [steady_rmse.shape[1] for steady_rmse in found.steady_rmses]
    entry |= {"effort": found.effort.tolist(), "smoothness": found.smoothness.tolist(), "lengths": lengths}
    return entry, arrays


def unpacked_study(suite: str, packed_entry: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> InSuite | None:
    """Return what agents do in a suite from plain JSON and arrays; None if the suite is another one since."""
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
    """Return the studies that are kept, by name; what they say of a suite that has changed since is left out.

    Raises:
        ValueError: a file is damaged.
    """
    return {file.stem: _load(file) for file in sorted(folder.glob("*.npz"))}


def _load(file: Path) -> Study:
    with reading(file) as stored:
        record, arrays = dict(stored.record), stored.arrays
        all_of = {suite: unpacked_study(suite, entry, arrays) for suite, entry in record.pop("suites").items()}
        found = {suite: own for suite, own in all_of.items() if own is not None}
        curves = [arrays[f"curve/{i}"] for i in range(sum(name.startswith("curve/") for name in arrays))]
        return Study(**record, suites=found, curves=tuple(curves))
