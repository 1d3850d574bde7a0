"""Computes the results of policies from runs, for each scenario, and pooled over each speed range."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from baselines.evaluation.metrics import Measures, Summary, ratio, summarise
from baselines.evaluation.runner import Run
from baselines.evaluation.score import (
    ERROR_CAPS,
    EXPERT,
    FULL_INFORMATION,
    OPTIMUM_POLICY,
    RIVAL,
    VEHICLE_MARK,
    Score,
    capped,
    count_failures,
    difference,
    error_cap,
    has_failed,
    in_paper_metres,
    paired,
    relative_error,
    score,
    speed_range_of,
    unit_of,
    vehicle_of,
)

_Case = Mapping[str, Measures]
"""Metrics in a scenario by policy, in metres of the paper's vehicle, see `score.in_paper_metres`."""
_PAPER = "paper"  # name of the paper's vehicle in results of several vehicles


@dataclass(frozen=True)
class Entry:
    """The results of a policy in a scenario, or pooled over a speed range.

    Distances are in metres; pooled over several vehicles, they are in metres of the paper's, see `score.unit_of`.
    """

    policy: str
    place: str  # the scenario, the speed range, or SPEED_RANGE@VEHICLE if there are several vehicles
    recorded: bool  # whether its rows are recorded ones
    decision_seconds: float  # of the policy for one vehicle and control step
    summary: Summary | None = None  # None: the policy failed
    effort_ratio: float = math.nan  # effort over the expert's; nan without the expert
    smoothness_ratio: float = math.nan  # smoothness over the expert's; nan without the expert
    score: Score | None = None  # None: the expert or the optimum is missing
    capped: Score | None = None  # the score with steady-state errors of at most the error cap
    failed: int = 0  # number of failed episodes, see `score.has_failed`
    error_ratio: float = math.nan  # mean capped steady-state error over that of `score.RIVAL`; nan without it
    within: tuple[int, int] | None = None  # failed episodes, and all, of those not `Cell.beyond`; None: all are
    to_best: Score | None = None  # [m] steady-state error minus that of the best policy; None if there is one policy


@dataclass(frozen=True)
class Result:
    """A run and its results."""

    run: Run
    entry: Entry


@dataclass(frozen=True)
class Trained:
    """The agents from several training seeds, in the scenarios of a speed range, or in another scenario."""

    policies: tuple[str, ...]  # one for each seed
    place: str
    to_expert: Score  # geometric mean over scenarios of the error over the expert's; interval over seeds and episodes
    middle: float  # interquartile mean of the ratios of the single seeds


def over_seeds(runs: Sequence[Run], trainings: Sequence[tuple[str, ...]]) -> list[Trained]:
    """Return the results of trainings with several seeds; places in which a seed has not run are left out."""
    measures, results = measures_of(runs), []
    places: dict[str, list[str]] = {}
    for name in measures:
        places.setdefault(speed_range_of(name) or name, []).append(name)
    for policies, (place, names) in itertools.product(trainings, places.items()):
        if any(policy not in measures[name] for policy in (EXPERT, *policies) for name in names):
            continue
        every = [paired(*(measures[name][policy] for policy in (EXPERT, *policies))) for name in names]
        errors = [np.array([capped(m, error_cap(n)) for m in row]) for n, row in zip(names, every, strict=True)]
        experts, agents = [rows[0] for rows in errors], [rows[1:] for rows in errors]
        each = [relative_error(experts, [rows[k] for rows in agents]).mean for k in range(len(policies))]
        middle = float(stats.trim_mean(each, 0.25))
        results.append(Trained(policies, place, relative_error(experts, agents), middle))
    return results


def compare(runs: Sequence[Run], beyond: Mapping[str, NDArray[np.bool_]] | None = None) -> list[Result]:
    """Return the result of each run.

    Args:
        runs: the runs.
        beyond: `Cell.beyond` by the name of the scenario; a scenario that is left out has no such episodes.
    """
    cases = measures_of(runs)
    parts = [{run.scenario.name: cases[run.scenario.name]} for run in runs]
    entries = [_entry(run.scenario.name, [run], case) for run, case in zip(runs, parts, strict=True)]
    entries = [_within(entry, case, beyond or {}) for entry, case in zip(entries, parts, strict=True)]
    best = {name: _best([entry for entry in entries if entry.place == name]) for name in cases}
    return [
        Result(run, _to_best(entry, best[entry.place], case, unit_of(run.scenario)))
        for run, case, entry in zip(runs, parts, entries, strict=True)
    ]


def _within(entry: Entry, cases: Mapping[str, _Case], beyond: Mapping[str, NDArray[np.bool_]]) -> Entry:
    """Return an entry of a scenario with the failures among the episodes that are not `beyond`, if others are."""
    mask = beyond.get(entry.place)
    if mask is None or not mask.any() or entry.summary is None:
        return entry
    failed = has_failed(cases[entry.place][entry.policy], error_cap(entry.place))
    return replace(entry, within=(int(failed[~mask].sum()), int((~mask).sum())))


def pool(runs: Sequence[Run]) -> list[Entry]:
    """Return the pooled results of each policy in each speed range whose cases it ran.

    If a speed range has several vehicles, the results of each vehicle follow.
    """
    measures, all_entries = measures_of(runs), []
    by_policy: dict[str, list[Run]] = {}
    for run in runs:
        by_policy.setdefault(run.policy, []).append(run)
    for place, names in _places(list(measures)).items():
        cases, entries = {name: measures[name] for name in names}, []
        for policy, every in by_policy.items():
            subset = [run for run in every if run.scenario.name in cases]
            if subset and all(policy in case for case in cases.values()):
                entries.append(_entry(place, subset, cases))
        units = {unit_of(run.scenario) for run in runs if run.scenario.name in cases}
        unit, best = units.pop() if len(units) == 1 else 1.0, _best(entries)
        all_entries += [_to_best(entry, best, cases, unit) for entry in entries]
    return all_entries


def _best(entries: Sequence[Entry]) -> Entry | None:
    """Return the entry with the smallest mean steady-state error, without `FULL_INFORMATION` and failed ones."""
    known = [(e.summary.steady_rmse_m.mean, e) for e in entries if e.summary and e.policy not in FULL_INFORMATION]
    return min(known, key=lambda pair: pair[0])[1] if known else None


def _to_best(entry: Entry, best: Entry | None, cases: Mapping[str, _Case], unit: float) -> Entry:
    """Return an entry with the difference to the best entry of its place; `unit` as in `score.unit_of`."""
    if entry.summary is None or best is None or best is entry:
        return entry
    pairs = [paired(case[best.policy], case[entry.policy]) for case in cases.values()]
    theirs, mine = ([unit * m.steady_rmse for m in column] for column in zip(*pairs, strict=True))
    return replace(entry, to_best=difference(theirs, mine))


def _places(scenarios: Sequence[str]) -> dict[str, list[str]]:
    """Return the scenarios of each speed range, and of each vehicle in it if there are several, by place."""
    by_place: dict[str, list[str]] = {}
    for speed_range in ERROR_CAPS:
        names = [name for name in scenarios if speed_range_of(name) == speed_range]
        vehicles = list(dict.fromkeys(map(vehicle_of, names)))
        if names:
            by_place[speed_range] = names
        for vehicle in vehicles if len(vehicles) > 1 else ():
            by_place[f"{speed_range}{VEHICLE_MARK}{vehicle or _PAPER}"] = [
                name for name in names if vehicle_of(name) == vehicle
            ]
    return by_place


def _entry(place: str, runs: Sequence[Run], by_name: Mapping[str, _Case]) -> Entry:
    """Return the results of a policy's runs, pooled over some cases."""
    policy, cases, caps = runs[0].policy, list(by_name.values()), list(map(error_cap, by_name))
    seconds, recorded = float(np.mean([run.decision_seconds for run in runs])), runs[0].recorded is not None
    if any(policy not in case for case in cases):
        return Entry(policy, place, recorded, seconds)
    metrics = [case[policy] for case in cases]
    effort = smoothness = math.nan
    plain = cut = None
    if all(EXPERT in case for case in cases):
        pairs = [paired(case[policy], case[EXPERT]) for case in cases]
        mine, experts = (Measures.joined(column) for column in zip(*pairs, strict=True))
        effort, smoothness = (
            ratio(float(np.mean(getattr(mine, key))), float(np.mean(getattr(experts, key))))
            for key in ("effort", "smoothness")
        )
    if all(EXPERT in case and OPTIMUM_POLICY in case for case in cases):
        three = list(zip(*(paired(c[EXPERT], c[policy], c[OPTIMUM_POLICY]) for c in cases), strict=True))
        plain = score(*([m.steady_rmse for m in column] for column in three))
        cut = score(*(list(map(capped, column, caps)) for column in three))
    error_ratio = math.nan
    if all(RIVAL in case for case in cases):
        columns = zip(*(paired(case[policy], case[RIVAL]) for case in cases), strict=True)
        error_ratio = ratio(*(float(np.concatenate(list(map(capped, column, caps))).mean()) for column in columns))
    plainly = {run.scenario.name: run.measures for run in runs if run.measures is not None}
    shown = [plainly[name] for name in by_name] if len({unit_of(run.scenario) for run in runs}) == 1 else metrics
    failed, summary = sum(map(count_failures, metrics, caps)), summarise(Measures.joined(shown), len(metrics) == 1)
    return Entry(policy, place, recorded, seconds, summary, effort, smoothness, plain, cut, failed, error_ratio)


def measures_of(runs: Sequence[Run]) -> dict[str, dict[str, Measures]]:
    """Return the metrics in metres of the paper's vehicle, by scenario and policy, without failed runs."""
    by_scenario: dict[str, dict[str, Measures]] = {}
    for run in runs:
        case = by_scenario.setdefault(run.scenario.name, {})
        if run.measures is not None:
            case[run.policy] = in_paper_metres(run.measures, run.scenario)
    return by_scenario


def recordings(results: Sequence[Result]) -> str:
    """Return a text with the policies, dates and versions of recorded rows; "" without recorded rows."""
    by_date: dict[str, list[str]] = {}
    for result in results:
        if result.run.recorded is not None:
            policies = by_date.setdefault(str(result.run.recorded), [])
            policies += [result.run.policy] if result.run.policy not in policies else []
    return "; ".join(f"{', '.join(policies)} ({when})" for when, policies in by_date.items())
