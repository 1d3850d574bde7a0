"""Whether policies still give the numbers that are recorded of them, to the last bit that is kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from baselines.evaluation.metrics import Measures
from baselines.evaluation.recorded import stored_measures
from baselines.evaluation.runner import Cell, Run
from baselines.evaluation.suites import Suite


@dataclass(frozen=True)
class PolicyVerdict:
    """How the rows of one policy in one cell compare with those of another time."""

    scenario: str
    numbers: int  # that were compared
    differing: int
    largest: float = 0.0  # relative difference
    where: str = ""  # the measure and the episode of the largest

    @classmethod
    def of(cls, recorded: Run, again: Run) -> PolicyVerdict:
        """Compare two runs of the same episodes as files hold them, see `recorded.stored_measures`.

        Raises:
            ValueError: the policy failed.
        """
        name = recorded.scenario.name
        if recorded.measures is None or again.measures is None:
            raise ValueError(f"{again.policy} fails in {name}: {again.error}")
        old, new = (
            stored_measures(run.measures).astype(np.float64) for run in (recorded, again) if run.measures is not None
        )
        differs = ~((old == new) | (np.isnan(old) & np.isnan(new)))
        if not differs.any():
            return cls(name, old.size, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            relative = np.where(differs, np.abs(new - old) / np.maximum(np.abs(old), np.abs(new)), 0.0)
        relative = np.where(np.isnan(relative), np.inf, relative)
        measure, episode = np.unravel_index(int(relative.argmax()), relative.shape)
        where = f"{fields(Measures)[int(measure)].name} of episode {int(episode)}"
        return cls(name, old.size, int(differs.sum()), float(relative.max()), where)


def cells_to_run(suite: Suite, recorded: Sequence[Run], names: Sequence[str]) -> list[Cell]:
    """Return the episodes that rows are recorded of, in the cells of these names or, without any, in all.

    A cell's episodes are run together as they were recorded: a few of them give other last bits, since matrices are
    multiplied in other batches.
    """
    lengths = {run.scenario.name: len(run.measures or ()) for run in recorded}
    chosen = [cell for cell in suite.cells if cell.scenario.name in lengths]
    if names:
        chosen = [cell for cell in chosen if cell.scenario.name in names]
    return [Cell(cell.scenario, cell.episodes[: lengths[cell.scenario.name]]) for cell in chosen]


def verdict_line(policy: str, verdicts: Sequence[PolicyVerdict]) -> str:
    """Return a line about a policy."""
    numbers, differing = (sum(getattr(v, key) for v in verdicts) for key in ("numbers", "differing"))
    if not differing:
        return f"equal      {policy}: {numbers} numbers of {len(verdicts)} cells"
    worst = max(verdicts, key=lambda v: v.largest)
    return (
        f"DIFFERENT  {policy}: {differing} of {numbers} numbers, at most by {worst.largest:.1e} of the value, "
        f"{worst.where} of {worst.scenario}"
    )
