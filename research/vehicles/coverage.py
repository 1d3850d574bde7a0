"""Count how often the intervals of an identification hold what is true: `python -m research identification-coverage`.

Logs of a minute are simulated with noise, each with another, and a vehicle is fitted to each. docs/identify.md shows
the counts.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from auv_gym.physics.vehicle import PAPER_VEHICLE
from auv_gym.scenarios.presets import PRESETS
from baselines.identification import identify
from baselines.identification.command import EXAMPLE, EXAMPLE_LAG
from baselines.identification.fit import UNKNOWN
from baselines.identification.model import COEFFICIENTS, FITTED_PARAMETERS, LIMIT_NAMES
from baselines.identification.model import CURRENT_NAMES as V
from baselines.identification.trials import EXAMPLE_CURRENT, example
from baselines.tools.command_line import DONE, UsageError, parse
from baselines.tools.files import json_text, read_json, write_atomically
from research import DOCS

PROGRAM = "python -m research identification-coverage"
_VEHICLES = {
    "the paper's vehicle": PAPER_VEHICLE,
    "with quadratic drag": replace(PAPER_VEHICLE, X_uu=20.0, Y_vv=60.0, N_rr=25.0),
}
"""Whose logs are simulated."""
_FILE = "identify.json"  # of what was counted, in docs/
_NEAR = 0.05  # share of the true value within which a fitted one is near


@dataclass(frozen=True)
class Options:
    """Count how often the intervals of an identification hold what is true.

    Exit status: 0 done, 2 wrong usage.
    """

    logs: int = 100
    """Logs of each vehicle."""
    out: Path = DOCS / _FILE
    """File for the counts."""


def _counted(name: str, logs: int) -> dict[str, Any]:
    """Return what so many identifications of a vehicle come to: counts, errors and processor time."""
    vehicle, sensors = _VEHICLES[name], PRESETS["cruise-noise"].sensors
    truth = {name: getattr(vehicle, name) for name in COEFFICIENTS} | dict(zip(V, EXAMPLE_CURRENT, strict=True))
    truth |= dict(zip(LIMIT_NAMES, (EXAMPLE.F_u_max, EXAMPLE.F_r_max), strict=True)) | {"lag": EXAMPLE_LAG}
    held, near = dict.fromkeys(FITTED_PARAMETERS, 0), dict.fromkeys(FITTED_PARAMETERS, 0)
    errors: dict[str, list[float]] = {n: [] for n in FITTED_PARAMETERS}
    unknown, whole = dict.fromkeys(FITTED_PARAMETERS, 0), 0
    begin = time.process_time()
    for seed in range(logs):
        found = identify(example(vehicle, EXAMPLE, sensors, seed)).estimates
        good = []
        for e in found:
            inside, error = e.low <= truth[e.name] <= e.high, abs(e.value - truth[e.name])
            good.append(inside or error <= _NEAR * abs(truth[e.name]))
            held[e.name] += inside
            near[e.name] += good[-1]
            unknown[e.name] += e.verdict == UNKNOWN
            errors[e.name].append(error / (abs(truth[e.name]) or 1.0))
        whole += all(good)
    seconds = (time.process_time() - begin) / logs
    rows = {
        n: {
            "true": truth[n],
            "held": held[n],
            "near": near[n],
            "unknown": unknown[n],
            "median": float(np.median(errors[n])),
            "worst": max(errors[n]),
        }
        for n in FITTED_PARAMETERS
    }
    return {"logs": logs, "processor_s": seconds, "whole": whole, "parameters": rows}


def _table(record: Mapping[str, Any]) -> str:
    """Return the counts of a vehicle as a table in Markdown; errors of what is truly 0 are in SI units."""
    logs = record["logs"]
    lines = [
        f"| parameter | true | in the 95 % interval | in it or within 5 % | median error | worst of {logs} |",
        "|---|---|---|---|---|---|",
    ]
    for name, row in record["parameters"].items():
        size = "{:.2g}" if row["true"] == 0 else "{:.2%}"
        median, worst = (size.format(row[key]).replace("%", " %") for key in ("median", "worst"))
        lines.append(f"| {name} | {row['true']:g} | {row['held']} | {row['near']} | {median} | {worst} |")
    held = sum(row["held"] for row in record["parameters"].values())
    of = logs * len(record["parameters"])
    near = sum(row["near"] for row in record["parameters"].values())
    lines.append(f"| all | | {held / of:.1%} | {near / of:.1%} | | |".replace("%", " %"))
    return "\n".join(lines) + "\n"


def coverage_section() -> str:
    """Return the part of docs/identify.md about the logs of each vehicle."""
    return "\n".join(_of_vehicle(*record) for record in read_json(DOCS / _FILE).items())


def _of_vehicle(name: str, record: Mapping[str, Any]) -> str:
    """Return the part about the logs of one vehicle."""
    logs, rows = record["logs"], record["parameters"].values()
    there = [row["near"] for row in rows if row["true"] != 0]
    not_there = [row["near"] for row in rows if row["true"] == 0]
    says = (
        f"**{name[0].upper()}{name[1:]}**, {logs} logs, {record['processor_s']:.1f} s of processor time each. "
        f"Of the parameters that are not 0, {_share(there, logs)} are inside their interval or within 5 %; of those "
        f"that are 0, {_share(not_there, logs)}. In {record['whole']} of {logs} logs this holds for all parameters."
    )
    return f"{says}\n\n{_table(record)}"


def _share(counts: Sequence[int], logs: int) -> str:
    """Return a count of all numbers in words, with its 95 % interval (Clopper and Pearson 1934)."""
    done, of = sum(counts), len(counts) * logs
    low, high = binomtest(done, of).proportion_ci(0.95) if of else (0.0, 1.0)
    return f"{done} of {of} ({100 * low:.1f} to {100 * high:.1f} %)"


def main(arguments: Sequence[str]) -> int:
    """Count as the arguments say and return the exit status.

    Raises:
        UsageError: the arguments do not make sense.
    """
    options = parse(Options, arguments, PROGRAM)
    if options.logs < 1:
        raise UsageError(f"--logs is {options.logs}; it must be 1 or more")
    records = {}
    for name in _VEHICLES:
        records[name] = _counted(name, options.logs)
        print(_of_vehicle(name, records[name]), flush=True)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(options.out, json_text(records))
    return DONE
