"""What the anchors do in the cells of a frozen suite, kept beside it: the ends of a validation's score.

`python -m research suites yardsticks NAME` measures and writes them.
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

YARDSTICKS_FILE = SUITES_FOLDER / "yardsticks.json"  # of all suites that have been measured


class Yardstick(NamedTuple):
    """Mean capped tail RMSE in a cell [m]; infinite where the anchor of 1 does not know how.

    Validations are of the time before the bound: their 1 is the oracle's.
    """

    expert_m: float
    oracle_m: float


def measured_yardsticks(cell: Cell, brief: bool = False) -> Yardstick:
    """Return what the anchors do in a cell; where it is to be brief the oracle is left out: infinite."""
    one = math.inf if brief else float(np.mean(_capped_tail(BY_ORACLE.one, cell)))
    return Yardstick(float(np.mean(_capped_tail(BY_ORACLE.zero, cell))), one)


def recorded_yardsticks(cell: Cell) -> Yardstick | None:
    """Return what the anchors do in a cell of a frozen suite, as it was measured; None for another cell."""
    return _kept(YARDSTICKS_FILE).get(cell.hash)


def write_yardsticks(suite: Suite, file: Path = YARDSTICKS_FILE) -> None:
    """Measure the cells of a suite and write down what was found, in place of what was known of it.

    Raises:
        OSError: the file cannot be written.
    """
    found = {cell.scenario.name: {"cell": cell.hash, **measured_yardsticks(cell)._asdict()} for cell in suite.cells}
    write_atomically(file, json_text((read_json(file) if file.exists() else {}) | {suite.name: found}))
    _kept.cache_clear()


@cache
def _kept(file: Path) -> dict[str, Yardstick]:
    """Return a file's yardsticks by the hash of their cell."""
    cells = [record for suite in read_json(file).values() for record in suite.values()]
    return {record["cell"]: Yardstick(record["expert_m"], record["oracle_m"]) for record in cells}


def _capped_tail(name: str, cell: Cell) -> Array:
    """Return the capped tails [m] of a policy; infinite where the anchor of 1 does not know how."""
    try:
        measures = rollout(make_policy(name, cell.scenario.vehicle), cell.scenario, cell.episodes, math.inf).measures
    except (PolicyError, ValueError):
        if name == BY_ORACLE.zero:
            raise
        return np.full(len(cell.episodes), math.inf)
    return capped(measures, cap_of(cell.scenario))
