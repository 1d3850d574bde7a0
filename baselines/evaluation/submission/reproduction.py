"""Whether a policy still does what was submitted of it: a random share of the episodes, run again."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.evaluation.runner import Cell, Run
from baselines.evaluation.submission.files import SUBMITTED, Submission

REPRODUCED_SHARE = 0.05
"""Share of each cell's episodes that is run again, unless another one is asked for."""
RELATIVE = 1e-3
"""Difference of a measure, as a share of it, up to which it counts as the same."""
ABSOLUTE = {"steady_rmse": 1e-5, "effort": 1e-5, "smoothness": 1e-5, "failed": 0.0}
"""Difference up to which a measure counts as the same, however small it is; of the tail in m."""

ChosenEpisodes = dict[str, NDArray[np.int64]]
"""Numbers of the episodes to run again, by scenario."""


@dataclass(frozen=True)
class Mismatch:
    """A number that does not repeat."""

    scenario: str
    episode: int  # its number in the cell
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
        submission: what is to be reproduced.
        share: in (0, 1].
        seed: the same seed, the same episodes.
    """
    rng, lengths = np.random.default_rng(seed), {r.scenario.name: len(r.measures or ()) for r in submission.runs}
    return {name: np.sort(rng.permutation(n)[: max(1, math.ceil(share * n - 1e-9))]) for name, n in lengths.items()}


def chosen_cells(submission: Submission, episodes: ChosenEpisodes) -> list[Cell]:
    """Return the cells of these episodes."""
    by_name = {cell.scenario.name: cell for cell in submission.suite.cells}
    return [Cell(by_name[n].scenario, tuple(by_name[n].episodes[i] for i in own)) for n, own in episodes.items()]


def mismatches(submission: Submission, episodes: ChosenEpisodes, again: Sequence[Run]) -> list[Mismatch]:
    """Return what does not repeat, the episodes in the order of the suite.

    Args:
        submission: what is to be reproduced.
        episodes: that ran again, see `chosen`.
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


def smallest_caught(episodes: int) -> float:
    """Return the share of forged episodes that a look at this many at random finds with 95 % certainty."""
    return float(1 - 0.05 ** (1 / episodes))
