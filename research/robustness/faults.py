"""Failures and errors with faults of actuators and measurements, with and without a check: `python -m research faults`.

The episodes are those of the suite faults-v1.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import arg

from baselines.agents.names import CHECKED, GUARD
from baselines.evaluation.fingerprints import fingerprint
from baselines.evaluation.progress import run_and_show
from baselines.evaluation.recorded import speed_ranges_of
from baselines.evaluation.request import checked_policies
from baselines.evaluation.runner import Cell
from baselines.evaluation.score import capped, count_failures, error_cap, in_paper_metres, speed_range_of
from baselines.evaluation.suites import load_suite
from baselines.tools.command_line import DONE, UsageError, checked_folder, parse
from baselines.tools.files import json_text, read_json, write_atomically
from baselines.tools.workers import DEFAULT_JOBS, Workers
from research import DATA
from research.pages import table

PROGRAM = "python -m research faults"
SUITE = "faults-v1"
FAULTS_FILE = DATA / "faults.json"  # record of the results
POLICIES = ("backstepping", "nmpc", "nmpc-adverse", "helm", "helm-any", f"helm-any{GUARD}=nmpc-adverse")
"""The policies of the page, without and with the check."""
FINGERPRINT = "fingerprint"  # key next to the cells of a policy in the record
_MENDED = ("heading-frozen", "velocity-frozen", "yaw-rate-frozen", "velocity-missing")
"""The faults of which the page says how many failures are left."""


@dataclass(frozen=True)
class Options:
    """Run policies with faults of actuators and measurements, without and with a check of the measurements.

    Exit status: 0 done, 2 wrong usage.
    """

    policy: Annotated[tuple[str, ...], arg(metavar="P [P ...]", help_behavior_hint="")] = POLICIES
    """Names of policies."""
    episodes: int = 10_000
    """Largest number of episodes of each cell, the first ones."""
    jobs: int = DEFAULT_JOBS
    """Number of parallel processes."""
    out: Path = FAULTS_FILE
    """File to which the results are added."""


def main(arguments: Sequence[str]) -> int:
    """Run the policies, record the results, and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options = parse(Options, arguments, PROGRAM)
    record_runs([name + end for name in options.policy for end in ("", CHECKED)], load_suite(SUITE).cells, options)
    return DONE


def record_runs(policies: Sequence[str], cells: Sequence[Cell], options: Options) -> None:
    """Run policies in the first episodes of cells, and add failures and errors to the file of the options.

    Agents for one speed range run in the cells of that range only.

    Raises:
        UsageError: the options are invalid, or a policy fails with an error.
    """
    if options.episodes < 1:
        raise UsageError(f"--episodes is {options.episodes}; it must be 1 or more")
    own = [Cell(cell.scenario, cell.episodes[: options.episodes]) for cell in cells]
    checked_folder(options.out.parent)
    for policy in checked_policies(policies):
        speed_ranges = speed_ranges_of(policy)
        pairs = [(policy, cell) for cell in own if speed_range_of(cell.scenario.name) in speed_ranges]
        runs = run_and_show(pairs, Workers(options.jobs))
        add_rows(options.out, policy, fingerprint(policy), {run.scenario.name: _row(run) for run in runs})


def add_rows(file: Path, policy: str, digest: str, rows: Mapping[str, Any]) -> None:
    """Add rows of a policy to a file and delete its rows with another fingerprint than `digest`."""
    record = read_json(file) if file.exists() else {}
    own = record.get(policy, {})
    rest = own if own.get(FINGERPRINT) == digest else {}
    record[policy] = {**rest, FINGERPRINT: digest, **rows}
    write_atomically(file, json_text(record))


def _row(run: Any) -> dict[str, float]:
    """Return the number of episodes and failures of a run, and the mean capped error [mm] in the paper's metres."""
    if run.measures is None:
        raise UsageError(f"{run.policy} in {run.scenario.name}: {run.error}")
    measures, cap = in_paper_metres(run.measures, run.scenario), error_cap(run.scenario.name)
    error = 1e3 * float(capped(measures, cap).mean())
    return {"episodes": len(measures), "failed": count_failures(measures, cap), "error_mm": round(error, 2)}


def context(_: str = "") -> dict[str, Any]:
    """Return the values of the template of the page."""
    record = read_json(FAULTS_FILE)
    policies = [name for name in POLICIES if name in record]
    cells = [name for name in record[policies[0]] if name != FINGERPRINT]
    tables = []
    for speed_range in dict.fromkeys(name.partition("-")[0] for name in cells):
        own = [name for name in cells if name.startswith(speed_range)]
        heads = ["fault", *(f"`{policy}`" for policy in policies)]
        rows = [
            [name.partition("-")[2].replace("-", " "), *(_cell(record, p, [name]) for p in policies)] for name in own
        ]
        rows.append(["all", *(_cell(record, policy, own) for policy in policies)])
        tables.append((speed_range, table(heads, rows)))
    mended = [cell for cell in cells if cell.partition("-")[2] in _MENDED]
    failures = [
        sum(record[policy + end][cell]["failed"] for policy in policies for cell in mended) for end in ("", CHECKED)
    ]
    episodes = record[policies[0]][cells[0]]["episodes"]
    total = episodes * len(mended) * len(policies)
    return {"tables": tables, "episodes": episodes, "cells": len(cells), "failures": failures, "total": total}


def _cell(record: Any, policy: str, names: Sequence[str]) -> str:
    return both([[record[name][cell] for cell in names] for name in (policy, policy + CHECKED)])


def both(sides: Sequence[Sequence[Mapping[str, float]]]) -> str:
    """Return failures and mean error [cm] of rows before and after a change; once if it changes nothing."""
    errors = (sum(row["error_mm"] for row in rows) / len(rows) / 10 for rows in sides)
    texts = (f"{sum(row['failed'] for row in rows)}; {e:.3g}" for rows, e in zip(sides, errors, strict=True))
    return " -> ".join(dict.fromkeys(texts))
