"""Measure the coverage of the confidence intervals of an identification: `python -m research identification-coverage`.

A vehicle is fitted to each of many simulated logs of a minute, which differ in their noise. The coverage is the share
of the intervals that contain the true value. In other logs the vehicle has effects that the model lacks; there the
reported misfits are counted. docs/identify.md shows the results.
"""

from __future__ import annotations

import copy
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
from baselines.identification.model import COEFFICIENTS, CROSS_TERMS, FITTED_PARAMETERS, LIMIT_NAMES
from baselines.identification.model import CURRENT_NAMES as V
from baselines.identification.trials import EXAMPLE_CURRENT, Simulated, Trial, example, recorded
from baselines.tools.command_line import DONE, UsageError, checked_folder, parse
from baselines.tools.files import json_text, read_json, write_atomically
from research import DATA

PROGRAM = "python -m research identification-coverage"
_VEHICLES = {
    "the paper's vehicle": PAPER_VEHICLE,
    "with quadratic drag": replace(PAPER_VEHICLE, X_uu=20.0, Y_vv=60.0, N_rr=25.0),
}
"""The simulated vehicles by name."""
_ARM = 1.0  # [m]
_OUTSIDE = {
    "side force of the rudder": Simulated(PAPER_VEHICLE, EXAMPLE, EXAMPLE_CURRENT, _ARM),
    "rate limits of the actuators": Simulated(
        PAPER_VEHICLE, replace(EXAMPLE, F_u_rate=200.0, F_r_rate=100.0), EXAMPLE_CURRENT
    ),
}
"""Simulated vehicles with effects that the model lacks, by effect."""
_SHOWN = tuple(name for name in FITTED_PARAMETERS if name not in CROSS_TERMS)
"""Names of the counted parameters."""
_FILE = DATA / "identification.json"  # record of the results
_NEAR = 0.05  # largest relative error of a value that counts as near


@dataclass(frozen=True)
class Options:
    """Measure the coverage of the confidence intervals of an identification on simulated logs.

    Exit status: 0 done, 2 wrong usage.
    """

    logs: int = 80
    """Number of logs of each vehicle; half as many of each effect that the model lacks."""
    out: Path = _FILE
    """File for the counts."""


def _counted(name: str, logs: int) -> dict[str, Any]:
    """Return counts, errors and processor time of the identifications of a vehicle from a number of logs."""
    vehicle, sensors = _VEHICLES[name], PRESETS["cruise-noise"].sensors
    truth = {name: getattr(vehicle, name) for name in COEFFICIENTS} | dict(zip(V, EXAMPLE_CURRENT, strict=True))
    truth |= dict(zip(LIMIT_NAMES, (EXAMPLE.F_u_max, EXAMPLE.F_r_max), strict=True)) | {"lag": EXAMPLE_LAG}
    held, near = dict.fromkeys(_SHOWN, 0), dict.fromkeys(_SHOWN, 0)
    errors: dict[str, list[float]] = {n: [] for n in _SHOWN}
    unknown, whole, misfit = dict.fromkeys(_SHOWN, 0), 0, 0
    begin = time.process_time()
    for seed in range(logs):
        found = identify(example(vehicle, EXAMPLE, sensors, seed))
        misfit += found.misfit
        good = []
        for e in map(found.__getitem__, _SHOWN):
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
        for n in _SHOWN
    }
    return {"logs": logs, "processor_s": seconds, "whole": whole, "misfit": misfit, "parameters": rows}


def _misfits(plant: Simulated, logs: int) -> dict[str, int]:
    """Return the number of logs of a simulated vehicle, and of those with a reported misfit."""
    sensors, misfit = PRESETS["cruise-noise"].sensors, 0
    for seed in range(logs):
        rng = np.random.default_rng(seed)
        log = recorded(copy.deepcopy(plant), Trial(EXAMPLE.F_u_max, EXAMPLE.F_r_max), sensors, rng, EXAMPLE_CURRENT)
        misfit += identify(log).misfit
    return {"logs": logs, "misfit": misfit}


def _table(record: Mapping[str, Any]) -> str:
    """Return the counts of a vehicle as a table in Markdown; errors of parameters that are 0 are in SI units."""
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
    records = read_json(_FILE)
    return "\n".join([_of_misfit(records), *(_of_vehicle(name, records[name]) for name in _VEHICLES)])


def _of_misfit(records: Mapping[str, Any]) -> str:
    """Return the table of the reported misfits."""
    lines = ["| logs | misfit reported |", "|---|---|"]
    for name, record in records.items():
        lines.append(f"| {name} | {_share([record['misfit']], record['logs'])} |")
    return "\n".join(lines) + "\n"


def _of_vehicle(name: str, record: Mapping[str, Any]) -> str:
    """Return the results of a vehicle as text with a table."""
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
    """Return a sum of counts as "3 of 10" with the 95 % interval of the share (Clopper and Pearson 1934)."""
    done, of = sum(counts), len(counts) * logs
    low, high = binomtest(done, of).proportion_ci(0.95) if of else (0.0, 1.0)
    return f"{done} of {of} ({100 * low:.1f} to {100 * high:.1f} %)"


def main(arguments: Sequence[str]) -> int:
    """Identify the logs, record the results, and return the exit status.

    Raises:
        UsageError: the arguments are invalid.
    """
    options = parse(Options, arguments, PROGRAM)
    if options.logs < 1:
        raise UsageError(f"--logs is {options.logs}; it must be 1 or more")
    checked_folder(options.out.parent)
    records: dict[str, Any] = {}
    for name in _VEHICLES:
        records[name] = _counted(name, options.logs)
        print(_of_vehicle(name, records[name]), flush=True)
        write_atomically(options.out, json_text(records))
    for name, plant in _OUTSIDE.items():
        records[name] = _misfits(plant, max(options.logs // 2, 1))
        write_atomically(options.out, json_text(records))
    print(_of_misfit(records))
    return DONE
