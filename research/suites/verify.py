"""Compare recorded results of policies with those of a new run, to the last recorded bit."""

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
    """Comparison of the recorded and the new rows of one policy in one cell."""

    scenario: str
    numbers: int  # number of compared values
    differing: int  # number of different values
    largest: float = 0.0  # largest relative difference
    where: str = ""  # measure and episode of the largest difference

    @classmethod
    def of(cls, recorded: Run, again: Run) -> PolicyVerdict:
        """Return the comparison of two runs of the same episodes, as files hold them, see `recorded.stored_measures`.

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
    """Return the recorded episodes of the cells with these names, by default of all cells.

    All recorded episodes of a cell run together: batches of another size differ in the last bits, since matrices are
    multiplied in another order.
    """
    lengths = {run.scenario.name: len(run.measures or ()) for run in recorded}
    chosen = [cell for cell in suite.cells if cell.scenario.name in lengths]
    if names:
        chosen = [cell for cell in chosen if cell.scenario.name in names]
    return [Cell(cell.scenario, cell.episodes[: lengths[cell.scenario.name]]) for cell in chosen]


def verdict_line(policy: str, verdicts: Sequence[PolicyVerdict]) -> str:
    """Return a line about the comparison of a policy in several cells."""
    numbers, differing = (sum(getattr(v, key) for v in verdicts) for key in ("numbers", "differing"))
    if not differing:
        return f"equal      {policy}: {numbers} numbers of {len(verdicts)} cells"
    worst = max(verdicts, key=lambda v: v.largest)
    return (
        f"DIFFERENT  {policy}: {differing} of {numbers} numbers, at most by {worst.largest:.1e} of the value, "
        f"{worst.where} of {worst.scenario}"
    )
