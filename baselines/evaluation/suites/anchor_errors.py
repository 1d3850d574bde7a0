"""Recorded errors of the anchors in the cells of frozen suites, for the scores of validations.

`python -m research suites anchor-errors NAME` measures and writes them.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from auv_gym.physics.namespaces import Array
from baselines.evaluation.rollout import PolicyError, rollout
from baselines.evaluation.runner import Cell
from baselines.evaluation.score import BY_ORACLE, cap_of, capped
from baselines.evaluation.suites import SUITES_FOLDER, Suite
from baselines.policies import make_policy
from baselines.tools.files import json_text, read_json, write_atomically

ANCHOR_ERRORS_FILE = SUITES_FOLDER / "anchor_errors.json"  # errors of all measured suites


class AnchorErrors(NamedTuple):
    """Mean capped steady-state RMSE in a cell [m]; that of the oracle is infinite if it cannot run.

    Validations are older than the full-information optimum, so their score of 1 is the oracle's.
    """

    expert_m: float
    oracle_m: float


def measured_anchor_errors(cell: Cell, brief: bool = False) -> AnchorErrors:
    """Run the anchors in a cell and return their errors; with `brief` the oracle does not run."""
    one = math.inf if brief else float(np.mean(_capped_rmse(BY_ORACLE.one, cell)))
    return AnchorErrors(float(np.mean(_capped_rmse(BY_ORACLE.zero, cell))), one)


def recorded_anchor_errors(cell: Cell) -> AnchorErrors | None:
    """Return the recorded errors of the anchors in a cell of a frozen suite; None for another cell."""
    return _kept(ANCHOR_ERRORS_FILE).get(cell.hash)


def write_anchor_errors(suite: Suite, file: Path = ANCHOR_ERRORS_FILE) -> None:
    """Measure the errors of the anchors in the cells of a suite, and write them in place of the old ones.

    Raises:
        OSError: the file cannot be written.
    """
    found = {cell.scenario.name: {"cell": cell.hash, **measured_anchor_errors(cell)._asdict()} for cell in suite.cells}
    write_atomically(file, json_text((read_json(file) if file.exists() else {}) | {suite.name: found}))
    _kept.cache_clear()


@cache
def _kept(file: Path) -> dict[str, AnchorErrors]:
    """Return the anchor errors of a file by the hash of their cell."""
    cells = [record for suite in read_json(file).values() for record in suite.values()]
    return {record["cell"]: AnchorErrors(record["expert_m"], record["oracle_m"]) for record in cells}


def _capped_rmse(name: str, cell: Cell) -> Array:
    """Return the capped steady-state RMSE [m] of an anchor in each episode; infinite if the oracle cannot run."""
    try:
        measures = rollout(make_policy(name, cell.scenario.known), cell.scenario, cell.episodes, math.inf).measures
    except (PolicyError, ValueError):
        if name == BY_ORACLE.zero:
            raise
        return np.full(len(cell.episodes), math.inf)
    return capped(measures, cap_of(cell.scenario))
