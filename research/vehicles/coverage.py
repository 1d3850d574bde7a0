"""Measure the coverage of the confidence intervals of an identification: `python -m research identification-coverage`.

A vehicle is fitted to each of many simulated logs of a minute, which differ in their noise. The coverage is the share
of the intervals that contain the true value. In other logs the vehicle has effects that the model lacks; there the
reported misfits are counted. docs/identify.md shows the results.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import binomtest

from auv_gym.physics.vehicle import PAPER_VEHICLE, Vehicle
from auv_gym.scenarios.presets import TYPICAL_NOISE
from baselines.evaluation.fingerprints import code_fingerprint
from baselines.identification import Log, identify
from baselines.identification.model import COEFFICIENTS, CROSS_TERMS, FITTED_PARAMETERS, LIMIT_NAMES
from baselines.identification.model import CURRENT_NAMES as V
from baselines.identification.trials import EXAMPLE_ACTUATORS as EXAMPLE
from baselines.identification.trials import EXAMPLE_CURRENT, Simulated, Trial, example, recorded
from research.pages import table
from research.study import Study


def _from_motion(log: Log) -> Log:
    """Return the part of a log from 20 s on, in the middle of a manoeuvre."""
    rows = log.t >= _CUT
    return Log(log.t[rows], log.measured[rows], log.commands[rows])


def _with_slow_fixes(log: Log) -> Log:
    """Return a log with a position in every fifth row only."""
    seen = np.ones_like(log.measured, dtype=bool)
    seen[np.arange(len(seen)) % 5 > 0, :2] = False
    return replace(log, seen=seen)


_VEHICLES: Mapping[str, tuple[Vehicle, Callable[[Log], Log]]] = {
    "paper": (PAPER_VEHICLE, lambda log: log),
    "quadratic-drag": (replace(PAPER_VEHICLE, X_uu=20.0, Y_vv=60.0, N_rr=25.0), lambda log: log),
    "motion": (PAPER_VEHICLE, _from_motion),
    "fixes": (PAPER_VEHICLE, _with_slow_fixes),
}
"""The simulated vehicles by row, and what is done to their logs."""
_IN_FULL = ("paper", "quadratic-drag")  # rows with a table of all parameters
_CUT = 20.0  # [s]
_ARM = 1.0  # [m]
_OUTSIDE = {
    "rudder": Simulated(PAPER_VEHICLE, EXAMPLE, EXAMPLE_CURRENT, _ARM),
    "rate-limits": Simulated(PAPER_VEHICLE, replace(EXAMPLE, F_u_rate=200.0, F_r_rate=100.0), EXAMPLE_CURRENT),
}
"""Simulated vehicles with effects that the model lacks, by row."""
_LABELS = {
    "paper": "the paper's vehicle",
    "quadratic-drag": "with quadratic drag",
    "motion": "the log begins in motion",
    "fixes": "a position at 2 Hz, all else at 10 Hz",
    "rudder": "side force of the rudder",
    "rate-limits": "rate limits of the actuators",
}
_SHOWN = tuple(name for name in FITTED_PARAMETERS if name not in CROSS_TERMS)
"""Names of the counted parameters."""
_LOGS = 80  # logs of each vehicle; half as many of each effect that the model lacks
_NEAR = 0.05  # largest relative error of a value that counts as near


def _measure(row: str, quick: bool = False) -> dict[str, Any]:
    logs = 2 if quick else _LOGS
    return _counted(row, logs) if row in _VEHICLES else _misfits(_OUTSIDE[row], logs // 2)


def _counted(name: str, logs: int) -> dict[str, Any]:
    """Return counts, errors and processor time of the identifications of a vehicle from a number of logs."""
    (vehicle, change), sensors = _VEHICLES[name], TYPICAL_NOISE["cruise"]
    truth = {name: getattr(vehicle, name) for name in COEFFICIENTS} | dict(zip(V, EXAMPLE_CURRENT, strict=True))
    truth |= dict(zip(LIMIT_NAMES, (EXAMPLE.F_u_max, EXAMPLE.F_r_max), strict=True)) | {"lag": EXAMPLE.lag}
    begin = time.process_time()
    fits = [identify(change(example(vehicle, EXAMPLE, sensors, seed))) for seed in range(logs)]
    seconds, whole, parameters = (time.process_time() - begin) / logs, np.ones(logs, dtype=bool), {}
    for parameter in _SHOWN:
        true, estimates = truth[parameter], [fit[parameter] for fit in fits]
        errors = np.abs([e.value - true for e in estimates])
        held = np.array([e.low <= true <= e.high for e in estimates])
        near = held | (errors <= _NEAR * abs(true))
        whole &= near
        relative = errors / (abs(true) or 1.0)
        parameters[parameter] = {
            "true": true,
            "held": int(held.sum()),
            "near": int(near.sum()),
            "median": float(np.median(relative)),
            "worst": float(relative.max()),
        }
    misfit = sum(fit.misfit for fit in fits)
    counts = {"whole": int(whole.sum()), "misfit": misfit, "parameters": parameters}
    return {"logs": logs, "processor_s": seconds, **counts}


def _misfits(plant: Simulated, logs: int) -> dict[str, int]:
    """Return the number of logs of a simulated vehicle, and of those with a reported misfit."""
    sensors, misfit = TYPICAL_NOISE["cruise"], 0
    for seed in range(logs):
        rng = np.random.default_rng(seed)
        log = recorded(copy.deepcopy(plant), Trial(EXAMPLE.F_u_max, EXAMPLE.F_r_max), sensors, rng, EXAMPLE_CURRENT)
        misfit += identify(log).misfit
    return {"logs": logs, "misfit": misfit}


STUDY = Study(
    "identification-coverage",
    [(row,) for row in _LABELS],
    _measure,
    lambda _: f"{code_fingerprint('identification')} {_LOGS}",
)
main = STUDY.main


def coverage_section() -> str:
    """Return the part of docs/identify.md about the logs of each vehicle."""
    values = STUDY.values()
    rows = [(_LABELS[row], _share([v["misfit"]], v["logs"]), _inside(v)) for (row,), v in values.items()]
    summary = table(("logs", "misfit reported", "true values in their 95 % interval"), rows, right=False)
    return "\n\n".join([summary, *(_of_vehicle(_LABELS[row], values[row,]) for row in _IN_FULL)])


def _inside(record: Mapping[str, Any]) -> str:
    counts = [row["held"] for row in record.get("parameters", {}).values()]
    return _share(counts, record["logs"]) if counts else "-"


def _of_vehicle(name: str, record: Mapping[str, Any]) -> str:
    """Return the results of a vehicle as text with a table; errors of parameters that are 0 are in SI units."""
    logs, rows = record["logs"], []
    for parameter, row in record["parameters"].items():
        form = "{:.2g}" if row["true"] == 0 else "{:.2%}"
        errors = (form.format(row[key]).replace("%", " %") for key in ("median", "worst"))
        rows.append((parameter, f"{row['true']:g}", row["held"], row["near"], *errors))
    counts = record["parameters"].values()
    shares = (f"{100 * sum(row[key] for row in counts) / (logs * len(counts)):.1f} %" for key in ("held", "near"))
    present, absent = ([row["near"] for row in counts if (row["true"] != 0) == there] for there in (True, False))
    heads = ("parameter", "true", "in the 95 % interval", "in it or within 5 %", "median error", f"worst of {logs}")
    return (
        f"**{name[0].upper()}{name[1:]}**, {logs} logs, {record['processor_s']:.1f} s of processor time each. "
        f"Of the parameters that are not 0, {_share(present, logs)} are inside their interval or within 5 %; of those "
        f"that are 0, {_share(absent, logs)}. In {record['whole']} of {logs} logs this holds for all parameters.\n\n"
        f"{table(heads, [*rows, ('all', '', *shares, '', '')], right=False)}"
    )


def _share(counts: Sequence[int], logs: int) -> str:
    """Return a sum of counts as "3 of 10" with the 95 % interval of the share (Clopper and Pearson 1934)."""
    done, of = sum(counts), len(counts) * logs
    low, high = binomtest(done, of).proportion_ci(0.95) if of else (0.0, 1.0)
    return f"{done} of {of} ({100 * low:.1f} to {100 * high:.1f} %)"
