"""The report in numbers: results.json and results.csv."""

from __future__ import annotations

import csv
import io
import json
import math
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import scipy

import auv_gym
from baselines.evaluation.metrics import Summary, ratio, summarise
from baselines.evaluation.paper import Reproduction
from baselines.evaluation.request import EXPERT, Request
from baselines.evaluation.runner import Run


@dataclass(frozen=True)
class Result:
    """One row of the table: a run, its averages, and how it compares with the expert in the same scenario."""

    run: Run
    summary: Summary | None  # None: the run failed
    effort_ratio: float
    smoothness_ratio: float


def compare(runs: Sequence[Run]) -> list[Result]:
    """Return a result for each run; ratios are nan where one of the two failed."""
    summaries = [None if run.error else summarise(run.records, run.scenario.steps) for run in runs]
    expert = {run.scenario.name: s for run, s in zip(runs, summaries, strict=True) if run.policy == EXPERT}
    results = []
    for run, summary in zip(runs, summaries, strict=True):
        base = expert.get(run.scenario.name)
        known = summary is not None and base is not None
        effort, smoothness = (
            ratio(getattr(summary, name), getattr(base, name)) if known else math.nan
            for name in ("effort", "smoothness")
        )
        results.append(Result(run, summary, effort, smoothness))
    return results


def to_record(result: Result) -> dict[str, Any]:
    """Return a result as it stands in results.json; a failed one has its reason in `error` and no numbers."""
    s = result.summary
    tail = s.tail_rmse_m if s else None
    return {
        "policy": result.run.policy,
        "scenario": result.run.scenario.name,
        "episodes": s.episodes if s else None,
        "rmse_m": s.rmse_m if s else None,
        "tail_rmse_m": {"mean": tail.mean, "ci95": list(tail.ci95), "p95": tail.p95} if tail else None,
        "effort_ratio": result.effort_ratio,
        "smoothness_ratio": result.smoothness_ratio,
        "failures": s.failures if s else None,
        "saturation": s.saturation if s else None,
        "return_mean": s.return_mean if s else None,
        "seconds": s.seconds if s else None,
        "error": result.run.error,
        "warnings": list(result.run.warnings),
    }


def results_json(request: Request, results: Sequence[Result], reproduction: Reproduction | None) -> str:
    """Return the text of results.json: strict JSON, null for what is not a number."""
    record: dict[str, Any] = {
        "suite": request.suite,
        "suite_hash": request.hash,
        "seed": request.seed,
        "versions": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "scipy": scipy.__version__,
            "gymnasium": gymnasium.__version__,
            "auv_gym": auv_gym.__version__,
        },
        "results": [to_record(result) for result in results],
    }
    if reproduction is not None:
        record["reproduction"] = reproduction.to_dict()
    return json.dumps(_finite(record), indent=2, allow_nan=False) + "\n"


def _finite(value: Any) -> Any:
    """Return the value with None for every number in it that is not finite."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def results_csv(results: Sequence[Result]) -> str:
    """Return the text of results.csv: the results of results.json, one line each, empty where those are null."""
    lines = []
    for result in results:
        record = _finite(to_record(result))
        tail = record.pop("tail_rmse_m") or {"mean": None, "ci95": (None, None), "p95": None}
        low, high = tail["ci95"]
        flat = {
            "tail_rmse_m": tail["mean"],
            "tail_ci95_low_m": low,
            "tail_ci95_high_m": high,
            "tail_p95_m": tail["p95"],
        }
        lines.append({**record, **flat, "warnings": " | ".join(record["warnings"])})
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(lines[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return text.getvalue()


def write_atomically(file: Path, content: str | bytes) -> None:
    """Write a file so that no reader ever sees half of it."""
    temporary = file.with_name(f".{file.name}.{os.getpid()}.tmp")
    try:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)
        temporary.replace(file)
    finally:
        temporary.unlink(missing_ok=True)
