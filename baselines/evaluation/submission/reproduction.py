"""Checks if a policy reproduces a submission, in a random share of the episodes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.evaluation.runner import Cell, Run
from baselines.evaluation.submission.files import SUBMITTED, Submission

REPRODUCED_SHARE = 0.05
"""Default share of each cell's episodes that is run again."""
RELATIVE = 1e-3
"""Relative tolerance of a metric."""
ABSOLUTE = {"steady_rmse": 1e-5, "effort": 1e-5, "smoothness": 1e-5, "failed": 0.0}
"""Absolute tolerance of a metric; that of `steady_rmse` is in m."""

ChosenEpisodes = dict[str, NDArray[np.int64]]
"""Indices of the episodes to run again, by scenario."""


@dataclass(frozen=True)
class Mismatch:
    """A result that is not reproduced."""

    scenario: str
    episode: int  # its index in the cell
    measure: str
    submitted: float
    found: float

    def __str__(self) -> str:
        unit = " m" if self.measure == "steady_rmse" else ""
        where = f"episode {self.episode} of {self.scenario}: {self.measure}"
        return f"{where} {self.submitted:.6g}{unit} submitted, {self.found:.6g}{unit} found"


def chosen(submission: Submission, share: float, seed: int) -> ChosenEpisodes:
    """Return a random share of each cell's episodes, at least one, in ascending order.

    Args:
        submission: the submission.
        share: in (0, 1].
        seed: seed of the choice.
    """
    rng, lengths = np.random.default_rng(seed), {r.scenario.name: len(r.measures or ()) for r in submission.runs}
    return {name: np.sort(rng.permutation(n)[: max(1, math.ceil(share * n - 1e-9))]) for name, n in lengths.items()}


def chosen_cells(submission: Submission, episodes: ChosenEpisodes) -> list[Cell]:
    """Return cells with these episodes only."""
    by_name = {cell.scenario.name: cell for cell in submission.suite.cells}
    return [Cell(by_name[n].scenario, tuple(by_name[n].episodes[i] for i in own)) for n, own in episodes.items()]


def mismatches(submission: Submission, episodes: ChosenEpisodes, again: Sequence[Run]) -> list[Mismatch]:
    """Return the results that are not reproduced, in the order of the suite.

    Args:
        submission: the submission.
        episodes: the repeated episodes, see `chosen`.
        again: their runs, one for each cell.

    Raises:
        ValueError: the policy failed.
    """
    found, runs = [], {run.scenario.name: run for run in again}
    for old in submission.runs:
        name = old.scenario.name
        if (new := runs[name]).measures is None:
            raise ValueError(f"{new.policy} fails in {name}: {new.error}")
        for measure in SUBMITTED:
            was = getattr(old.measures, measure)[episodes[name]].astype(np.float64)
            now = getattr(new.measures, measure).astype(np.float64)
            differs = ~(np.abs(now - was) <= ABSOLUTE[measure] + RELATIVE * np.abs(was) * (measure != "failed"))
            at = differs.nonzero()[0].tolist()
            found += [Mismatch(name, int(episodes[name][i]), measure, float(was[i]), float(now[i])) for i in at]
    return found


def detectable_share(episodes: int) -> float:
    """Return the share of forged episodes that a random sample of this size detects with 95 % probability."""
    return float(1 - 0.05 ** (1 / episodes))
