"""Failures and errors with governed plans and with the paths at their own pace: `python -m research governed`.

The episodes are those of the suite governed-v1; each runs twice, with the same disturbances and noise.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import arg

from auv_gym.planning.paths import Retimed
from baselines.evaluation.runner import Cell
from baselines.evaluation.score import vehicle_of
from baselines.evaluation.suites import load_suite
from baselines.tools.command_line import DONE, parse
from baselines.tools.files import read_json
from research import DATA
from research.pages import table
from research.robustness import faults
from research.suites.builder import own_pace

PROGRAM = "python -m research governed"
SUITE = "governed-v1"
GOVERNED_FILE = DATA / "governed.json"  # record of the results
OPTIMUM = "clairvoyant"
POLICIES = ("backstepping", "los-pid", "ekf", "nmpc", "nmpc-adverse", "helm-any", OPTIMUM)
"""The policies of the page."""


@dataclass(frozen=True)
class Options(faults.Options):
    """Run policies on governed plans and on the same paths at their own pace.

    Exit status: 0 done, 2 wrong usage.
    """

    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = POLICIES
    """Names of policies."""
    out: Path = GOVERNED_FILE
    """File to which the results are added."""


def main(arguments: Sequence[str]) -> int:
    """Run the policies, record the results, and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options = parse(Options, arguments, PROGRAM)
    cells = load_suite(SUITE).cells
    faults.record_runs(options.policy, [*map(own_pace, cells), *cells], options)
    return DONE


def context(_: str = "") -> dict[str, Any]:
    """Return the values of the template of the page."""
    record, cells = read_json(GOVERNED_FILE), load_suite(SUITE).cells
    policies = [name for name in POLICIES if name in record]
    names = {cell.scenario.name: own_pace(cell).scenario.name for cell in cells}

    def sides(policy: str, governed: Iterable[str]) -> list[list[dict[str, float]]]:
        """Return the rows of a policy in some cells, at the path's own pace and governed."""
        return [[record[policy][names[n]] for n in governed], [record[policy][n] for n in governed]]

    rows = []
    for cell in cells:
        name = cell.scenario.name
        case = name.removeprefix("cruise-").partition("-")[0]
        rows.append([f"`{vehicle_of(name)}`", case, _paces(cell), *(faults.both(sides(p, [name])) for p in policies)])
    rows.append(["all", "", "", *(faults.both(sides(p, names)) for p in policies)])
    failures = {p: [sum(row["failed"] for row in side) for side in sides(p, names)] for p in policies}
    heads = ["vehicle", "case", "pace", *(f"`{p}`" for p in policies)]
    episodes = record[policies[0]][cells[0].scenario.name]["episodes"]
    return {
        "table": table(heads, rows),
        "cells": len(cells),
        "episodes": episodes,
        "total": episodes * len(cells),
        "failures": failures,
        "optimum": OPTIMUM,
    }


def _paces(cell: Cell) -> str:
    """Return smallest, median and largest mean pace of the episodes of a cell, relative to that of their paths."""
    means = [float(np.mean(e.path.rates)) if isinstance(e.path, Retimed) else 1.0 for e in cell.episodes]
    return " / ".join(f"{x:.2f}" for x in np.quantile(means, (0, 0.5, 1)))
