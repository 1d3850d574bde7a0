"""The files of a study: steady-state errors of every episode and seed, and the command that made them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True)
class InSuite:
    """Results of S agents in the M episodes of each cell of a suite."""

    hash: str  # hash of the suite
    cells: tuple[str, ...]  # names of the scenarios
    steady_rmses: tuple[Array, ...]  # steady-state RMSE [m of the paper's vehicle], shape (S, M) for each cell
    failed: tuple[NDArray[np.bool_], ...]  # whether an episode ended beyond `lost_distance`, shape (S, M) for each cell
    smoothness: Array  # mean over all episodes, shape (S,); see `metrics`

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
            np.array([m.smoothness.mean() for m in whole]),
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

    speed_range: str
    command: str  # of the trainings
    suites: Mapping[str, InSuite]

    @classmethod
    def of(cls, speed_range: str, command: str, runs: Mapping[str, Sequence[Sequence[Run]]]) -> Study:
        """Return the study of agents from their runs, by suite.

        Raises:
            ValueError: a run failed.
        """
        return cls(speed_range, command, {name: InSuite.of(name, own) for name, own in runs.items()})


def save_study(name: str, study: Study, folder: Path = STUDIES_FOLDER) -> None:
    """Write a study to its file, with the date and the versions of the libraries."""
    entries: dict[str, Any] = {}
    arrays: dict[str, NDArray[Any]] = {}
    for suite, found in study.suites.items():
        lengths = [steady_rmse.shape[1] for steady_rmse in found.steady_rmses]
        smoothness = found.smoothness.tolist()
        entries[suite] = {"hash": found.hash, "cells": found.cells, "smoothness": smoothness, "lengths": lengths}
        arrays[f"{suite}/steady_rmses"] = np.concatenate(found.steady_rmses, axis=1).astype(np.float32)
        arrays[f"{suite}/failed"] = np.concatenate(found.failed, axis=1)
    made = {"date": datetime.now(timezone.utc).date().isoformat(), "versions": versions()}
    record = {"speed_range": study.speed_range, "command": study.command, **made, "suites": entries}
    write(folder / f"{name}.npz", Stored(record, arrays))


def load_studies(folder: Path = STUDIES_FOLDER) -> dict[str, Study]:
    """Return the recorded studies, by name, without results in suites that have changed since.

    Raises:
        ValueError: a file is damaged.
    """
    return {file.stem: _load(file) for file in sorted(folder.glob("*.npz"))}


def _load(file: Path) -> Study:
    with reading(file) as stored:
        record = stored.record
        found = {suite: _in_suite(suite, entry, stored.arrays) for suite, entry in record["suites"].items()}
        present = {suite: own for suite, own in found.items() if own.hash == suites.load_suite(suite).hash}
        return Study(record["speed_range"], record["command"], present)


def _in_suite(suite: str, entry: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> InSuite:
    """Return the results in a suite from the JSON values and the arrays of a file."""
    bounds = np.cumsum(entry["lengths"])[:-1]
    errors, failed = (np.split(arrays[f"{suite}/{key}"], bounds, axis=1) for key in ("steady_rmses", "failed"))
    steady_rmses = tuple(each.astype(np.float64) for each in errors)
    return InSuite(entry["hash"], tuple(entry["cells"]), steady_rmses, tuple(failed), np.array(entry["smoothness"]))
