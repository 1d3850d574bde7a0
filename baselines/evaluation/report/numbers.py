"""The report in numbers: results.json and results.csv."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from auv_gym.presets import REGIMES
from baselines.evaluation.metrics import Measures, Spread, Summary, ratio, summarise
from baselines.evaluation.paper.numbers import Reproduction
from baselines.evaluation.request import Request
from baselines.evaluation.runner import Run
from baselines.evaluation.score import EXPERT, ORACLE, Pooled, Score, losses, paired, pooled, regime_of, score
from baselines.tools.files import finite, json_text, versions


@dataclass(frozen=True)
class Result:
    """One row of the table: a run, its averages, and how it compares with the expert in the same scenario."""

    run: Run
    summary: Summary | None  # None: the run failed
    effort_ratio: float
    smoothness_ratio: float
    score: Score | None  # None: expert or oracle are missing


def compare(runs: Sequence[Run]) -> list[Result]:
    """Return a result for each run; ratios are nan where one of the two failed."""
    measures, results = measures_of(runs), []
    for run in runs:
        case = measures[run.scenario.name]
        effort = smoothness = math.nan
        value = None
        if run.measures is not None and EXPERT in case:
            own, expert = paired(run.measures, case[EXPERT])
            effort, smoothness = (
                ratio(float(np.mean(getattr(own, name))), float(np.mean(getattr(expert, name))))
                for name in ("effort", "smoothness")
            )
            if ORACLE in case:
                value = score(*([m.tail] for m in paired(case[EXPERT], run.measures, case[ORACLE])))
        summary = None if run.measures is None else summarise(run.measures)
        results.append(Result(run, summary, effort, smoothness, value))
    return results


def measures_of(runs: Sequence[Run]) -> dict[str, dict[str, Measures]]:
    """Return what was measured, by scenario, then by policy; failed runs are left out."""
    found: dict[str, dict[str, Measures]] = {}
    for run in runs:
        case = found.setdefault(run.scenario.name, {})
        if run.measures is not None:
            case[run.policy] = run.measures
    return found


def pool(runs: Sequence[Run]) -> list[Pooled]:
    """Return the figures of every policy in every regime that it ran in completely."""
    measures = measures_of(runs)
    policies = dict.fromkeys(run.policy for run in runs)
    found = [pooled(policy, regime, measures) for regime in REGIMES for policy in policies]
    return [entry for entry in found if entry is not None]


def to_record(result: Result) -> dict[str, Any]:
    """Return a result as it stands in results.json; a failed one has its reason in `error` and no numbers."""
    s, run = result.summary, result.run
    tail = s.tail_rmse_m if s else None
    regime = regime_of(run.scenario.name)
    return {
        "policy": run.policy,
        "scenario": run.scenario.name,
        "episodes": s.episodes if s else None,
        "rmse_m": s.rmse_m if s else None,
        "tail_rmse_m": _spread(tail) if tail else None,
        "score": asdict(result.score) if result.score else None,
        "settling_s": s.settling_s if s else None,
        "effort_ratio": result.effort_ratio,
        "smoothness_ratio": result.smoothness_ratio,
        "failures": s.failures if s else None,
        "lost": losses(run.measures, regime) / len(run.measures) if run.measures else None,
        "saturation": s.saturation if s else None,
        "return_mean": s.return_mean if s else None,
        "seconds": run.seconds if s else None,
        "decision_ms": 1e3 * run.decision_seconds if s else None,
        "recorded": asdict(run.recorded) if run.recorded else None,
        "error": run.error,
        "warnings": list(run.warnings),
    }


def _spread(tail: Spread) -> dict[str, Any]:
    return {"mean": tail.mean, "ci95": list(tail.ci95), "p95": tail.p95, "cvar95": tail.cvar95}


def recordings(results: Sequence[Result]) -> str:
    """Return which rows were recorded, when and with what version, in words; "" if none was."""
    found: dict[str, list[str]] = {}
    for result in results:
        if result.run.recorded is not None:
            policies = found.setdefault(str(result.run.recorded), [])
            policies += [result.run.policy] if result.run.policy not in policies else []
    return "; ".join(f"{', '.join(policies)} ({when})" for when, policies in found.items())


def results_json(
    request: Request, results: Sequence[Result], scores: Sequence[Pooled], reproduction: Reproduction | None
) -> str:
    """Return the text of results.json: strict JSON, null for what is not a number."""
    record: dict[str, Any] = {
        "suite": request.suite,
        "suite_hash": request.hash,
        "seed": request.seed,
        "versions": versions(),
        "results": [to_record(result) for result in results],
        "pooled": [asdict(entry) for entry in scores],
    }
    if reproduction is not None:
        record["reproduction"] = reproduction.to_dict()
    return json_text(record)


def results_csv(results: Sequence[Result]) -> str:
    """Return the text of results.csv: the results of results.json, one line each, empty where those are null."""
    lines = []
    for result in results:
        record = finite(to_record(result))
        flat = {**_flat("tail_rmse_m", record.pop("tail_rmse_m"), "mean", "p95", "cvar95")}
        flat |= _flat("score", record.pop("score"), "mean")
        when = result.run.recorded
        lines.append({**record, **flat, "recorded": when and when.date, "warnings": " | ".join(record["warnings"])})
    text = io.StringIO()
    writer = csv.DictWriter(text, fieldnames=list(lines[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    return text.getvalue()


def _flat(name: str, record: dict[str, Any] | None, *keys: str) -> dict[str, Any]:
    """Return a nested entry as columns: the first key's has the name itself, the others' and the interval's append."""
    values = record or {}
    low, high = values.get("ci95", (None, None))
    columns = {name if key == "mean" else f"{name}_{key}": values.get(key) for key in keys}
    return columns | {f"{name}_ci95_low": low, f"{name}_ci95_high": high}
