"""The report in numbers: what runs come to, policy by policy, in each scenario and in all those of a regime."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from auv_gym.physics.namespaces import Array
from auv_gym.scenarios.presets import SPEED_RANGES
from baselines.evaluation.metrics import Measures, Summary, ratio, summarise
from baselines.evaluation.runner import Run
from baselines.evaluation.score import (
    EXPERT,
    RIVAL,
    VEHICLE_MARK,
    Anchors,
    Score,
    capped,
    count_failures,
    error_cap,
    in_paper_metres,
    paired,
    score,
    speed_range_of,
    unit_of,
    vehicle_of,
)

_Case = Mapping[str, Measures]
"""What was measured in a scenario, by policy, in metres of the paper's vehicle, see `score.in_paper_metres`."""
_PAPER = "paper"  # names the paper's vehicle where there are others


@dataclass(frozen=True)
class Entry:
    """The figures of a policy in a scenario, or in all those of a regime together.

    Distances are in metres; those of several vehicles together in metres of the paper's, see `score.unit_of`.
    """

    policy: str
    place: str  # the scenario, the regime, or regime@vehicle where there are several
    recorded: bool  # whether its episodes were not run now
    decision_seconds: float  # of the policy for one vehicle and control step
    summary: Summary | None = None  # None: the policy failed
    effort_ratio: float = math.nan  # effort over the expert's; nan if there is no expert
    smoothness_ratio: float = math.nan  # smoothness over the expert's; nan if there is no expert
    score: Score | None = None  # None: one of the anchors is missing
    capped: Score | None = None  # with every tail RMSE at most `score.ERROR_CAPS`
    failed: int = 0  # episodes, see `score.has_failed`
    error_ratio: float = math.nan  # mean capped tail over that of `score.RIVAL`; nan if it is missing


@dataclass(frozen=True)
class Result:
    """A run and its figures."""

    run: Run
    entry: Entry


def compare(runs: Sequence[Run], anchors: Anchors | None = None) -> list[Result]:
    """Return a result for each run; the score's anchors are those of the suite, None for none: `Anchors.among`."""
    cases, ends = measures_of(runs), anchors or Anchors.among({run.policy for run in runs})
    own = [{run.scenario.name: cases[run.scenario.name]} for run in runs]
    return [Result(run, _entry(run.scenario.name, [run], case, ends)) for run, case in zip(runs, own, strict=True)]


def pool(runs: Sequence[Run], anchors: Anchors | None = None) -> list[Entry]:
    """Return the figures of every policy in every regime of which it ran all cases; `anchors` as in `compare`.

    Where a regime has several vehicles, those of each vehicle follow.
    """
    measures, found = measures_of(runs), []
    ends = anchors or Anchors.among({run.policy for run in runs})
    by_policy: dict[str, list[Run]] = {}
    for run in runs:
        by_policy.setdefault(run.policy, []).append(run)
    for place, names in _places(list(measures)).items():
        cases = {name: measures[name] for name in names}
        for policy, every in by_policy.items():
            own = [run for run in every if run.scenario.name in cases]
            if own and all(policy in case for case in cases.values()):
                found.append(_entry(place, own, cases, ends))
    return found


def _places(scenarios: Sequence[str]) -> dict[str, list[str]]:
    """Return what is told together: the scenarios of each regime and, where it has several, of each vehicle."""
    found: dict[str, list[str]] = {}
    for speed_range in SPEED_RANGES:
        own = [name for name in scenarios if speed_range_of(name) == speed_range]
        vehicles = list(dict.fromkeys(map(vehicle_of, own)))
        if own:
            found[speed_range] = own
        for vehicle in vehicles if len(vehicles) > 1 else ():
            found[f"{speed_range}{VEHICLE_MARK}{vehicle or _PAPER}"] = [
                name for name in own if vehicle_of(name) == vehicle
            ]
    return found


def _entry(place: str, runs: Sequence[Run], by_name: Mapping[str, _Case], anchors: Anchors) -> Entry:
    """Return the figures of one policy's runs, all together, in these cases."""
    policy, cases, caps = runs[0].policy, list(by_name.values()), list(map(error_cap, by_name))
    seconds, recorded = float(np.mean([run.decision_seconds for run in runs])), runs[0].recorded is not None
    if any(policy not in case for case in cases):
        return Entry(policy, place, recorded, seconds)
    own = [case[policy] for case in cases]
    effort = smoothness = math.nan
    plain = cut = None
    if all(EXPERT in case for case in cases):
        pairs = [paired(case[policy], case[EXPERT]) for case in cases]
        mine, experts = (Measures.joined(column) for column in zip(*pairs, strict=True))
        effort, smoothness = (
            ratio(float(np.mean(getattr(mine, key))), float(np.mean(getattr(experts, key))))
            for key in ("effort", "smoothness")
        )
    zero, one = anchors
    if all(zero in case and one in case for case in cases):
        three = list(zip(*(paired(c[zero], c[policy], c[one]) for c in cases), strict=True))
        plain = score(*([m.steady_rmse for m in column] for column in three))
        cut = score(*(_capped(column, caps) for column in three))
    error_ratio = math.nan
    if all(RIVAL in case for case in cases):
        columns = zip(*(paired(case[policy], case[RIVAL]) for case in cases), strict=True)
        error_ratio = ratio(*(float(np.concatenate(_capped(column, caps)).mean()) for column in columns))
    plainly = {run.scenario.name: run.measures for run in runs if run.measures is not None}
    shown = [plainly[name] for name in by_name] if len({unit_of(run.scenario) for run in runs}) == 1 else own
    failed, summary = sum(map(count_failures, own, caps)), summarise(Measures.joined(shown), interval=len(own) == 1)
    return Entry(policy, place, recorded, seconds, summary, effort, smoothness, plain, cut, failed, error_ratio)


def _capped(cases: Sequence[Measures], caps: Sequence[float]) -> list[Array]:
    """Return the capped tails [m] in each case."""
    return list(map(capped, cases, caps))


def measures_of(runs: Sequence[Run]) -> dict[str, dict[str, Measures]]:
    """Return what was measured in metres of the paper's vehicle, by scenario, then by policy; without failed runs."""
    found: dict[str, dict[str, Measures]] = {}
    for run in runs:
        case = found.setdefault(run.scenario.name, {})
        if run.measures is not None:
            case[run.policy] = in_paper_metres(run.measures, run.scenario)
    return found


def recordings(results: Sequence[Result]) -> str:
    """Return which rows were recorded, when and with what version, in words; "" if none was."""
    found: dict[str, list[str]] = {}
    for result in results:
        if result.run.recorded is not None:
            policies = found.setdefault(str(result.run.recorded), [])
            policies += [result.run.policy] if result.run.policy not in policies else []
    return "; ".join(f"{', '.join(policies)} ({when})" for when, policies in found.items())
