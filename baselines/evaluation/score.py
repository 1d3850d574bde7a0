"""The score of a policy: 0 is the expert, 1 the optimum; computed in paired episodes, with errors pooled over cases.

    score of p = (E_zero - E_p) / (E_zero - E_one),     E: mean over episodes of the steady-state RMSE

E_zero and E_one are the errors of `EXPERT` and of `OPTIMUM_POLICY`.

Errors are pooled before the division. A mean of the ratios of all cases would be dominated by cases in which the
anchors are close together.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from auv_gym.physics.namespaces import Array
from auv_gym.physics.units import Units
from auv_gym.scenarios.scenario import Scenario
from baselines.evaluation.metrics import RESAMPLES, Ended, Measures, resamplings, seed_shares

EXPERT = "backstepping"  # the policy with score 0
SETPOINT_EXPERT = "los-setpoints"  # the same in scenarios whose actions are setpoints
ORACLE = "oracle"  # a regulator with known plant and disturbances
OPTIMUM_POLICY = "clairvoyant"  # the full-information optimum, with score 1
FULL_INFORMATION = (ORACLE, OPTIMUM_POLICY)
"""Reference policies with information that entries may not use."""
RIVAL = "nmpc"  # a policy without learning that others are compared with
ERROR_CAPS: Mapping[str, float] = {"slow": 0.6, "cruise": 2.0, "space": 2.0}
"""Error caps [m] by speed range: the steady-state RMSE from which an episode counts as failed, and beyond which the
capped score does not fall.

They are for the paper's vehicle; for another vehicle they are multiplied by the ratio of the lengths, see `cap_of`."""
VEHICLE_MARK = "@"  # separates preset and vehicle in the name of a scenario for another vehicle


SCALE = "0 the expert, 1 the optimum"  # the meaning of 0 and 1, as text


@dataclass(frozen=True)
class Score:
    """A score with its 95 % interval; nan if the expert is not worse than the optimum."""

    mean: float
    ci95: tuple[float, float]


def interval_text(value: Score | None, digits: int = 3) -> str:
    """Return the interval of a score as text, "-" if there is none."""
    return fixed_ends(value.ci95, digits) if value and math.isfinite(value.ci95[0]) else "-"


def fixed(value: float, digits: int = 3) -> str:
    """Return a number with some decimal places, without any from 100 on, and without a minus before zero."""
    digits = digits if abs(value) < 100 else 0
    return f"{round(value, digits) + 0.0:.{digits}f}"


def fixed_ends(interval: Sequence[float], digits: int = 3) -> str:
    """Return an interval with some decimal places."""
    return " ... ".join(fixed(end, digits) for end in interval)


def paired(*measures: Measures) -> list[Measures]:
    """Return the metrics of the episodes that all policies have run: the first ones, if a policy has run fewer."""
    shortest = min(map(len, measures))
    return [m if len(m) == shortest else m[:shortest] for m in measures]


def expert_of(scenarios: Iterable[Scenario]) -> str:
    """Return the policy with score 0 in some scenarios; in mixed ones it is that for forces."""
    return SETPOINT_EXPERT if all(scenario.takes_setpoints for scenario in scenarios) else EXPERT


def speed_range_of(scenario: str) -> str | None:
    """Return the speed range at the beginning of a scenario's name, None if there is none."""
    return next((speed_range for speed_range in ERROR_CAPS if scenario.startswith(f"{speed_range}-")), None)


def vehicle_of(scenario: str) -> str:
    """Return the vehicle in the name of a scenario, "" for the paper's vehicle."""
    return scenario.partition(VEHICLE_MARK)[2]


def unit_of(scenario: Scenario) -> float:
    """Return the length of a scenario's vehicle divided by that of the paper's vehicle."""
    return Units.of(scenario.vehicle).length


def in_paper_metres(m: Measures, scenario: Scenario) -> Measures:
    """Return metrics of a scenario with distances scaled to the length of the paper's vehicle, see `unit_of`.

    Scaled errors of vehicles of different size can be added, and have the same error cap.
    """
    unit = unit_of(scenario)
    return m if unit == 1 else replace(m, rmse=m.rmse / unit, steady_rmse=m.steady_rmse / unit)


def cap_of(scenario: Scenario) -> float:
    """Return the error cap [m] of a scenario, infinite if it has no speed range."""
    return unit_of(scenario) * error_cap(scenario.name)


def error_cap(scenario: str) -> float:
    """Return the error cap in metres of the paper's vehicle, by the name of a scenario; see `in_paper_metres`."""
    speed_range = speed_range_of(scenario)
    return ERROR_CAPS[speed_range] if speed_range else math.inf


def has_failed(ended: Measures | Ended, cap: float) -> NDArray[np.bool_]:
    """Return the mask of failed episodes: ended beyond `lost_distance`, or with a steady-state RMSE from the cap on.

    Args:
        ended: outcome of the episodes.
        cap: error cap [m], see `cap_of`.
    """
    return ended.failed | ~(ended.steady_rmse < cap)


def count_failures(ended: Measures | Ended, cap: float) -> int:
    """Return the number of failed episodes, see `has_failed`."""
    return int(has_failed(ended, cap).sum())


def capped(ended: Measures | Ended, cap: float) -> Array:
    """Return the steady-state RMSE [m] with the cap for failed episodes; unchanged if the cap is infinite."""
    return np.where(has_failed(ended, cap), cap, ended.steady_rmse) if math.isfinite(cap) else ended.steady_rmse


def relative_error(rival: Sequence[Array], own: Sequence[Array]) -> Score:
    """Return the geometric mean over cells of the ratio of own to a rival's mean steady-state error.

    All cells have the same weight, and the choice of the rival does not change the order of policies. The interval is
    a bootstrap over episodes within each cell, paired between both.

    Args:
        rival: steady-state errors of paired episodes, shape (M,) for each cell; a cell may have its own unit.
        own: the same, or errors of agents from S training seeds, shape (S, M); the interval is then over both.
    """
    seeds = [np.atleast_2d(mine) for mine in own]
    logs, shares = np.zeros(RESAMPLES + 1), seed_shares(len(seeds[0]))
    with np.errstate(divide="ignore"):
        for weights, theirs, mine in zip(resamplings(tuple(map(len, rival))), rival, seeds, strict=True):
            logs += np.log(((weights @ mine.T) * shares).sum(axis=1)) - np.log(weights @ theirs)
    values = np.exp(logs / len(rival))
    return _with_interval(values)


def difference(rival: Sequence[Array], own: Sequence[Array]) -> Score:
    """Return the mean of own minus a rival's steady-state errors [m] in paired episodes, an array for each case.

    The interval is a bootstrap over episodes within each case, paired between both; nan for a single episode.
    """
    lengths = tuple(map(len, rival))
    sums = sum(w @ (mine - theirs) for w, theirs, mine in zip(resamplings(lengths), rival, own, strict=True))
    values = np.asarray(sums) / sum(lengths)
    if sum(lengths) < 2:
        return Score(float(values[0]), (math.nan, math.nan))
    return _with_interval(values)


def _with_interval(values: Array) -> Score:
    """Return the first value with the 95 % interval of the others, which are those of bootstrap samples."""
    low, high = np.quantile(values[1:], (0.025, 0.975)).tolist()
    return Score(float(values[0]), (low, high))


def score(zero: Sequence[Array], policy: Sequence[Array], one: Sequence[Array]) -> Score:
    """Return the score from steady-state errors [m] of paired episodes, an array for each case.

    The interval is a bootstrap over episodes within each case, paired between the three policies.
    """
    sums = np.zeros((RESAMPLES + 1, 3))
    for weights, errors in zip(resamplings(tuple(map(len, zero))), zip(zero, policy, one, strict=True), strict=True):
        sums += weights @ np.stack(errors, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        values = (sums[:, 0] - sums[:, 1]) / (sums[:, 0] - sums[:, 2])
    if not sums[0, 0] > sums[0, 2]:
        return Score(math.nan, (math.nan, math.nan))
    if sum(map(len, zero)) < 2:
        return Score(float(values[0]), (math.nan, math.nan))
    return _with_interval(values)
